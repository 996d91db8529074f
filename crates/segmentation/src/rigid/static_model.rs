//! A model of the static scene, kept in the current camera's view.
//!
//! Each working pixel holds at most one surface point (its exact position, so that repeated warping does not blur it), its luma
//! and how often it was confirmed. What stands in front of the model has come in; what the model holds in front of the
//! measurement is gone.

use pfd_geometry::Image;

use super::view::{Motion, Pinhole};

/// One surface point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ModelPoint {
    /// Position in the camera frame, metres; z = 0 where the model is empty.
    pub(crate) position: [f32; 3],
    /// Luma when last seen.
    pub(crate) gray: f32,
    /// Times confirmed, at most [`MAX_HITS`].
    pub(crate) hits: f32,
}

impl ModelPoint {
    /// Whether a surface is known here.
    pub(crate) fn is_known(&self) -> bool {
        self.position[2] > 0.0
    }
}

/// Confirmations counted at most: about a second, after which old and new measurements weigh 1 : 30.
pub(crate) const MAX_HITS: f32 = 30.0;
/// Weight of a new luma value: follows exposure drift within a few frames.
const GRAY_RATE: f32 = 0.3;
/// Points that come closer than this (metres) leave the model.
const MIN_Z: f32 = 0.1;

/// The model and its spare buffer.
#[derive(Debug, Default)]
pub(crate) struct StaticModel {
    points: Image<ModelPoint>,
    spare: Image<ModelPoint>,
}

impl StaticModel {
    /// An empty model for a view.
    pub(crate) fn new(camera: &Pinhole) -> Self {
        let empty = Image::filled(camera.width, camera.height, ModelPoint::default());
        Self { points: empty.clone(), spare: empty }
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.points.pixels_mut().fill(ModelPoint::default());
    }

    /// The points, one per working pixel.
    pub(crate) fn points(&self) -> &[ModelPoint] {
        self.points.pixels()
    }

    /// Carries the model into the next camera frame; of two points on one pixel the nearer survives.
    pub(crate) fn advance(&mut self, camera: &Pinhole, motion: &Motion) {
        let target = self.spare.pixels_mut();
        target.fill(ModelPoint::default());
        for point in self.points.pixels().iter().filter(|p| p.is_known()) {
            let position = motion.apply(point.position);
            if position[2] < MIN_Z {
                continue;
            }
            let Some(index) = camera.nearest(camera.project(position)) else { continue };
            let occupied = target[index].position[2];
            if occupied == 0.0 || position[2] < occupied {
                target[index] = ModelPoint { position, ..*point };
            }
        }
        std::mem::swap(&mut self.points, &mut self.spare);
    }

    /// Confirms pixel `index` at `position` with `gray`.
    pub(crate) fn confirm(&mut self, index: usize, position: [f32; 3], gray: f32) {
        let point = &mut self.points.pixels_mut()[index];
        let share = 1.0 / (point.hits + 1.0);
        for (p, q) in point.position.iter_mut().zip(position) {
            *p += (q - *p) * share;
        }
        point.gray += (gray - point.gray) * GRAY_RATE.max(share);
        point.hits = (point.hits + 1.0).min(MAX_HITS);
    }

    /// Replaces what is known at pixel `index` by one measurement.
    pub(crate) fn replace(&mut self, index: usize, position: [f32; 3], gray: f32) {
        self.points.pixels_mut()[index] = ModelPoint { position, gray, hits: 1.0 };
    }

    /// Forgets pixel `index`.
    pub(crate) fn erase(&mut self, index: usize) {
        self.points.pixels_mut()[index] = ModelPoint::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use pfd_geometry::pose;

    const CAMERA: Pinhole = Pinhole { width: 32, height: 24, fx: 26.0, fy: 26.0, cx: 15.5, cy: 11.5 };

    #[test]
    fn warping_there_and_back_changes_no_position() {
        let mut model = StaticModel::new(&CAMERA);
        let position = CAMERA.unproject(10.3, 8.4, 2.0);
        model.replace(CAMERA.nearest([10.3, 8.4]).unwrap(), position, 90.0);
        let motion = pose::exp(&Vector6::new(0.1, 0.05, -0.1, 0.02, 0.01, 0.05));
        model.advance(&CAMERA, &Motion::from(&motion));
        model.advance(&CAMERA, &Motion::from(&motion.inverse()));
        let found = model.points()[CAMERA.nearest([10.3, 8.4]).unwrap()];
        assert!(found.position.iter().zip(position).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn the_nearer_point_hides_the_farther() {
        let mut model = StaticModel::new(&CAMERA);
        model.replace(0, CAMERA.unproject(12.0, 8.0, 3.0), 1.0);
        model.replace(1, CAMERA.unproject(12.0, 8.0, 1.0), 2.0);
        model.advance(&CAMERA, &Motion::from(&pfd_geometry::Pose::identity()));
        assert_eq!(model.points()[CAMERA.nearest([12.0, 8.0]).unwrap()].gray, 2.0);
    }

    #[test]
    fn confirming_averages() {
        let mut model = StaticModel::new(&CAMERA);
        model.replace(5, [0.0, 0.0, 1.0], 100.0);
        model.confirm(5, [0.0, 0.0, 1.2], 100.0);
        assert!((model.points()[5].position[2] - 1.1).abs() < 1e-6);
    }
}
