//! Rolling shutter: the rows of an image are exposed one after the other, while the camera moves.
//!
//! At a hand-held 0.3 m/s, 1 m from a desk, a readout of 20 ms stretches or skews an image by three pixels, many times the noise of
//! a corner. The measurements are referred to the time of the middle row by the velocity of the camera. The readout time, which no
//! driver states, is estimated from what the poses leave unexplained (on the effect in RGB-D SLAM: Kerl, Stückler and Cremers,
//! ICCV 2015; in bundle adjustment: Hedborg et al., CVPR 2012).

use nalgebra::{Matrix6, Point3, Vector6};
use pfd_geometry::{Camera, Pose};

use crate::image_features::ImageFeatures;
use crate::residual::{Measurement, linearize};

/// How the camera moved while it read out an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shutter {
    /// Twist per second in the camera frame, translation first: points move by `exp(ξ·t)`.
    pub velocity: Vector6<f64>,
    /// Seconds from the first row to the last; 0 for a global shutter, negative when the image is upside down.
    pub readout: f64,
}

impl Shutter {
    /// What `raw` would have been at the time of the middle row. `depth` (metres) stands in where it has none.
    pub fn at_middle_row(&self, camera: &Camera, raw: &Measurement, depth: f64) -> Measurement {
        let time = row_time(camera, raw.pixel.y) * self.readout;
        let then = camera.unproject(&raw.pixel, raw.depth.map_or(depth, |(z, _)| z));
        let (linear, angular) = (self.velocity.fixed_rows::<3>(0), self.velocity.fixed_rows::<3>(3));
        let middle = then - (linear + angular.cross(&then.coords)) * time;
        match camera.project(&middle) {
            Some(pixel) => Measurement { pixel, depth: raw.depth.map(|(_, sigma)| (middle.z, sigma)), ..*raw },
            None => *raw,
        }
    }
}

/// When the row at `v` pixels was exposed, in readouts after the middle row.
fn row_time(camera: &Camera, v: f64) -> f64 {
    (v + 0.5) / camera.height as f64 - 0.5
}

/// Standard deviation of the readout time before anything was seen, seconds.
const PRIOR_SIGMA: f64 = 0.01;
/// Error of the estimate from one frame that is not noise: velocity that changes, points that were placed by another estimate.
const FRAME_SIGMA: f64 = 0.008;
/// Error that the estimate gains per frame, so that what the first map got wrong is forgotten: old frames count for one twentieth
/// of a new one's error each.
const DRIFT_SIGMA: f64 = 0.05 * FRAME_SIGMA;
/// Longest readout: that of a camera with 20 frames per second, seconds.
const MAX_READOUT: f64 = 0.05;

/// The estimate of the readout time: a Kalman filter of one number.
#[derive(Clone, Copy, Debug)]
pub struct Readout {
    seconds: f64,
    variance: f64,
}

impl Readout {
    /// What is known before anything was seen, seconds.
    pub fn new(seconds: f64) -> Self {
        Self { seconds, variance: PRIOR_SIGMA * PRIOR_SIGMA }
    }

    /// Seconds from the first row to the last.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Learns from a frame: points in the world with the features that show them, whose shutter has the present readout time.
    #[allow(non_snake_case)]
    pub fn observe(
        &mut self,
        camera: &Camera,
        T_camera_world: &Pose,
        features: &ImageFeatures,
        seen: impl Iterator<Item = (Point3<f64>, usize)>,
    ) {
        let Some((error, information)) = measure(camera, T_camera_world, features, seen) else { return };
        let systematic = FRAME_SIGMA * FRAME_SIGMA;
        let frame_variance = systematic + 1.0 / information;
        // A frame that says little (the camera rests) lets nothing be forgotten either.
        let before = self.variance + DRIFT_SIGMA * DRIFT_SIGMA * systematic / frame_variance;
        let gain = before / (before + frame_variance);
        self.seconds = (self.seconds + gain * error.clamp(-MAX_READOUT, MAX_READOUT)).clamp(-MAX_READOUT, MAX_READOUT);
        self.variance = (1.0 - gain) * before;
    }
}

/// What the readout time lacks (seconds) by the residuals of one frame, and the information of that, with the pose free to follow.
/// `None` when the frame says nothing.
#[allow(non_snake_case)]
fn measure(
    camera: &Camera,
    T_camera_world: &Pose,
    features: &ImageFeatures,
    seen: impl Iterator<Item = (Point3<f64>, usize)>,
) -> Option<(f64, f64)> {
    let velocity = features.shutter().velocity;
    let (mut by_pose, mut mixed, mut by_readout) = (Matrix6::<f64>::zeros(), Vector6::zeros(), 0.0);
    let (mut pose_gradient, mut readout_gradient) = (Vector6::zeros(), 0.0);
    for (point, feature) in seen {
        let Some(linear) = linearize(camera, T_camera_world, &point, features.measurement(feature)) else { continue };
        let change = linear.by_pose * velocity * row_time(camera, features.raw(feature).pixel.y);
        by_pose += linear.by_pose.transpose() * linear.by_pose;
        mixed += linear.by_pose.transpose() * change;
        by_readout += change.norm_squared();
        pose_gradient += linear.by_pose.transpose() * linear.residual;
        readout_gradient += change.dot(&linear.residual);
    }
    // The Schur complement of the pose.
    let eliminated = by_pose.cholesky()?.solve(&mixed);
    let information = by_readout - mixed.dot(&eliminated);
    let gradient = readout_gradient - pose_gradient.dot(&eliminated);
    (information > f64::EPSILON * by_readout && information > 0.0).then(|| (-gradient / information, information))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;
    use pfd_geometry::{Distortion, pose};
    use pfd_vision::features::{Descriptor, Feature};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg32;

    use crate::pose_optimization::{PoseObservation, optimize_pose};

    fn camera() -> Camera {
        Camera::new((640, 480), [525.0, 525.0, 319.5, 239.5], Distortion::default()).unwrap()
    }

    /// What a camera at the origin that moves with `velocity` sees of `point`.
    fn expose(point: &Point3<f64>, velocity: &Vector6<f64>, readout: f64) -> Measurement {
        let mut time = 0.0;
        let mut there = *point;
        // The row depends on the time and the time on the row.
        for _ in 0..10 {
            there = pose::exp(&(velocity * time)) * point;
            time = row_time(&camera(), camera().project(&there).unwrap().y) * readout;
        }
        Measurement { pixel: camera().project(&there).unwrap(), sigma: 0.35, depth: Some((there.z, 0.02)) }
    }

    fn points(rng: &mut Pcg32) -> Vec<Point3<f64>> {
        let pixel = |rng: &mut Pcg32| Point2::new(rng.random_range(20.0..620.0), rng.random_range(20.0..460.0));
        (0..200).map(|_| camera().unproject(&pixel(rng), rng.random_range(0.8..2.5))).collect()
    }

    fn features(measurements: Vec<Measurement>) -> ImageFeatures {
        let feature =
            Feature { u: 0.0, v: 0.0, angle: 0.0, level: 0, response: 1.0, descriptor: Descriptor::default() };
        let count = measurements.len();
        ImageFeatures::from_parts((640, 480), vec![feature; count], measurements, vec![[0; 3]; count])
    }

    #[test]
    fn measurements_return_to_the_middle_row() {
        let mut rng = Pcg32::seed_from_u64(1);
        let velocity = Vector6::new(0.3, -0.4, 0.2, 0.5, 0.3, -0.4);
        let shutter = Shutter { velocity, readout: 0.025 };
        for point in points(&mut rng) {
            let raw = expose(&point, &velocity, shutter.readout);
            let middle = shutter.at_middle_row(&camera(), &raw, 1.0);
            let expected = camera().project(&point).unwrap();
            assert!((middle.pixel - expected).norm() < 0.05, "{} pixels", (middle.pixel - expected).norm());
            assert!((middle.depth.unwrap().0 - point.z).abs() < 1e-3);
        }
    }

    /// The estimate after 60 frames of hand-held motion over a known map.
    fn learn(true_readout: f64, rests: bool) -> f64 {
        let mut rng = Pcg32::seed_from_u64(7);
        let mut readout = Readout::new(0.0);
        for _ in 0..60 {
            let speed = if rests { 0.0 } else { 1.0 };
            let velocity = Vector6::from_fn(|_, _| speed * rng.random_range(-0.4..0.4));
            let world = points(&mut rng);
            let mut seen = features(world.iter().map(|p| expose(p, &velocity, true_readout)).collect());
            seen.set_shutter(&camera(), Shutter { velocity, readout: readout.seconds() });
            let observe = |(i, p): (usize, &Point3<f64>)| PoseObservation { point: *p, measured: *seen.measurement(i) };
            let observations: Vec<_> = world.iter().enumerate().map(observe).collect();
            let found = optimize_pose(&camera(), &observations, &Pose::identity()).unwrap().T_camera_world;
            readout.observe(&camera(), &found, &seen, world.iter().copied().enumerate().map(|(i, p)| (p, i)));
        }
        readout.seconds()
    }

    #[test]
    fn the_readout_time_is_learnt() {
        for truth in [0.0, 0.01, 0.022, -0.015] {
            let learnt = learn(truth, false);
            assert!((learnt - truth).abs() < 1e-3, "{learnt} instead of {truth}");
        }
        assert!(learn(0.022, true).abs() < 1e-9, "a camera at rest tells nothing");
    }

    #[test]
    fn no_points_tell_nothing() {
        let mut readout = Readout::new(0.01);
        readout.observe(&camera(), &Pose::identity(), &features(Vec::new()), std::iter::empty());
        assert!((readout.seconds() - 0.01).abs() < f64::EPSILON);
    }
}
