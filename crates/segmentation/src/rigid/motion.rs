//! Camera motion since the previous frame, and which corners do not follow it.

use nalgebra::{Matrix3, Vector6};
use pfd_geometry::{DepthNoise, Image, Pose, pose};
use pfd_vision::VisionError;
use pfd_vision::two_view::homography;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::corners::{CornerTracker, Correspondence, with_depth};
use super::ego_motion::{self, EgoMotion, INLIER_CHI2};
use super::reference::FrameMotion;
use super::rematch;
use super::view::{Motion, Pinhole, ViewFrame};
use super::witness;
use crate::config::{Compensation, PfdConfig};
use crate::result::FailOpenReason;

/// A corner in two frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CornerMove {
    /// Pixel index in the previous frame.
    pub(crate) from: usize,
    /// Pixel index in the current frame.
    pub(crate) to: usize,
    /// Movement, pixels.
    pub(crate) displacement: [f32; 2],
    /// Movement beyond that of the camera, pixels; zero without depth.
    pub(crate) residual: [f32; 2],
    /// By how much a depth edge beside it may have taken it along, pixels.
    pub(crate) slide: f32,
    /// Squared normalised residual under the camera motion; `None` without depth.
    pub(crate) chi2: Option<f32>,
}

/// Camera motion and corners.
#[derive(Debug)]
pub(crate) struct MotionEstimate {
    pub(crate) motion: FrameMotion,
    pub(crate) corners: Vec<CornerMove>,
    /// Median image motion that the camera causes, pixels.
    pub(crate) flow: f32,
}

impl MotionEstimate {
    /// Share of the corners with depth that follow the camera, of those that `count`.
    pub(crate) fn agreement(&self, count: impl Fn(&CornerMove) -> bool) -> f32 {
        let judged = || self.corners.iter().filter(|c| count(c)).filter_map(|c| c.chi2);
        judged().filter(|chi2| *chi2 < INLIER_CHI2).count() as f32 / judged().count().max(1) as f32
    }
}

/// Estimates motion from frame to frame.
#[derive(Debug)]
pub(crate) struct MotionEstimator {
    corners: CornerTracker,
    noise: DepthNoise,
    compensation: Compensation,
    min_inliers: usize,
    /// Whether there is no estimate where the motion is uncertain; else the prediction stands in for it.
    fail_open: bool,
    /// Camera velocity (twist per second): current from previous.
    velocity: Vector6<f64>,
    rng: Pcg64Mcg,
}

/// Half as many corners as are needed otherwise suffice if more than this share of all surfaces is seen where their motion puts it.
const MOST: f32 = 0.5;
/// Share of image cells that must hold agreeing corners: two of sixteen.
const MIN_SPREAD: f64 = 0.12;
/// A motion is predicted over no more than this, seconds: nobody turns a camera in the same way for longer.
const MAX_PREDICTION: f64 = 0.1;
/// A depth edge so near takes a corner along, working pixels: a part of the window by which corners are followed.
const EDGE_RADIUS: usize = 3;
/// Reprojection threshold of the homography, working pixels.
const HOMOGRAPHY_THRESHOLD: f64 = 1.0;

impl MotionEstimator {
    pub(crate) fn new(config: &PfdConfig, noise: DepthNoise, seed: u64) -> Self {
        Self {
            corners: CornerTracker::new(),
            noise,
            compensation: config.compensation,
            min_inliers: config.min_inliers,
            fail_open: config.fail_open,
            velocity: Vector6::zeros(),
            rng: Pcg64Mcg::seed_from_u64(seed),
        }
    }

    /// Loads the current frame.
    pub(crate) fn load(&mut self, frame: &ViewFrame) -> Result<(), VisionError> {
        self.corners.load(frame)
    }

    /// Corners of the previous frame that can be followed.
    pub(crate) fn corners(&self) -> usize {
        self.corners.count()
    }

    /// Makes the current frame the previous one.
    pub(crate) fn advance(&mut self, frame: &ViewFrame) -> Result<(), VisionError> {
        self.corners.advance(frame)
    }

    /// Motion in `dt` seconds; `trust` weighs pixels of the previous frame, 0 for known movers.
    #[allow(non_snake_case)]
    pub(crate) fn estimate(
        &mut self,
        camera: &Pinhole,
        (previous, current): (&ViewFrame, &ViewFrame),
        trust: impl Fn(usize) -> f32,
        dt: f64,
    ) -> Result<Result<MotionEstimate, FailOpenReason>, VisionError> {
        let prediction = pose::exp(&(self.velocity * dt.min(MAX_PREDICTION)));
        let mut solved = self.follow(camera, (previous, current), &prediction, &trust)?;
        if solved.is_err() {
            // A camera that turned may have stopped.
            solved = self.follow(camera, (previous, current), &Pose::identity(), &trust)?;
        }
        if solved.is_err() {
            let guess = rematch::guess(camera, &self.noise, (previous, current), &trust, &mut self.rng)?;
            if let Some(guess) = guess {
                solved = self.follow(camera, (previous, current), &guess, &trust)?;
            }
        }
        let (T_current_previous, found) = match solved {
            Ok((ego, found)) => (ego.T_current_previous, found),
            Err(reason) if self.fail_open => return Ok(Err(reason)),
            Err(_) => (prediction, Vec::new()),
        };
        self.velocity = pose::log(&T_current_previous) / dt;
        let motion =
            FrameMotion { T_earlier_current: T_current_previous.inverse(), homography: self.homography(&found)? };
        let corners = self.judge(camera, (previous, current), &found, &T_current_previous);
        let flow = camera_flow(&corners);
        Ok(Ok(MotionEstimate { motion, corners, flow }))
    }

    /// Follows the corners from where `guess` leads them, and solves for the motion.
    fn follow(
        &mut self,
        camera: &Pinhole,
        frames: (&ViewFrame, &ViewFrame),
        guess: &Pose,
        trust: impl Fn(usize) -> f32,
    ) -> Result<Result<(EgoMotion, Vec<Correspondence>), FailOpenReason>, VisionError> {
        let found = self.corners.follow(camera, &frames.0.depth, guess)?;
        let known = |i: usize| trust(i) > 0.0;
        let ego = self
            .solve(camera, frames, &found, guess, &trust, known)
            .or_else(|_| self.solve(camera, frames, &found, guess, |_| 1.0, known));
        Ok(ego.map(|ego| (ego, found)))
    }

    /// Solves for the motion of the corners that count by `trust`, of which few suffice if what is `known` is seen again.
    fn solve(
        &mut self,
        camera: &Pinhole,
        (previous, current): (&ViewFrame, &ViewFrame),
        found: &[Correspondence],
        guess: &Pose,
        trust: impl Fn(usize) -> f32,
        known: impl Fn(usize) -> bool,
    ) -> Result<EgoMotion, FailOpenReason> {
        let tracks = with_depth(camera, found, &previous.depth, &current.depth, trust);
        let tracks: Vec<_> = tracks.into_iter().map(|(_, track)| track).collect();
        let needed = self.min_inliers;
        let few = FailOpenReason::FewInliers { inliers: 0, needed };
        let ego = ego_motion::estimate(camera, &self.noise, &tracks, guess, &mut self.rng).ok_or(few)?;
        let motion = Motion::from(&ego.T_current_previous);
        let share = || witness::seen_again(camera, &self.noise, (previous, current), &motion, known);
        let enough = ego.inliers >= needed || (2 * ego.inliers >= needed && share() > MOST);
        if !enough {
            return Err(FailOpenReason::FewInliers { inliers: ego.inliers, needed });
        }
        if ego.spread < MIN_SPREAD {
            return Err(FailOpenReason::NarrowSupport { share: ego.spread });
        }
        Ok(ego)
    }

    fn homography(&self, found: &[Correspondence]) -> Result<Option<Matrix3<f64>>, VisionError> {
        if self.compensation == Compensation::Se3 {
            return Ok(None);
        }
        let (to, from): (Vec<_>, Vec<_>) = found.iter().map(|c| (c.to, c.from)).unzip();
        let relation = homography(&to, &from, HOMOGRAPHY_THRESHOLD)?;
        Ok(Some(relation.map_or_else(Matrix3::identity, |r| r.matrix)))
    }

    #[allow(non_snake_case)]
    fn judge(
        &self,
        camera: &Pinhole,
        (previous, current): (&ViewFrame, &ViewFrame),
        found: &[Correspondence],
        T_current_previous: &Pose,
    ) -> Vec<CornerMove> {
        let motion = Motion::from(T_current_previous);
        let mut corners: Vec<CornerMove> = found
            .iter()
            .filter_map(|c| {
                let displacement = [c.to[0] - c.from[0], c.to[1] - c.from[1]];
                let (from, to) = (camera.nearest(c.from)?, camera.nearest(c.to)?);
                Some(CornerMove { from, to, displacement, residual: [0.0; 2], slide: 0.0, chi2: None })
            })
            .collect();
        let tracks = with_depth(camera, found, &previous.depth, &current.depth, |_| 1.0);
        for (k, track) in tracks {
            if let Some(corner) = corners.get_mut(k) {
                let expected = camera.project(motion.apply(track.point));
                corner.residual = [track.pixel[0] - expected[0], track.pixel[1] - expected[1]];
                corner.slide = slide(camera, &previous.depth, &motion, corner.from);
                corner.chi2 = Some(ego_motion::squared_residual(camera, &self.noise, &motion, &track));
            }
        }
        corners
    }
}

/// By how much a corner may slide along a depth edge, pixels: where the outlines of two surfaces cross, it moves in between them. Half the
/// difference of the image motions that the camera causes of the nearest and of the farthest surface around it.
fn slide(camera: &Pinhole, depth: &Image<f32>, motion: &Motion, corner: usize) -> f32 {
    let (u, v) = (corner % camera.width, corner / camera.width);
    let around = |at: usize, size: usize| at.saturating_sub(EDGE_RADIUS)..(at + EDGE_RADIUS + 1).min(size);
    let rows = around(v, camera.height).map(|y| &depth.pixels()[y * camera.width..][around(u, camera.width)]);
    let measured = rows.flatten().copied().filter(|z| *z > 0.0);
    let (near, far) = measured.fold((f32::INFINITY, 0.0_f32), |(near, far), z| (near.min(z), far.max(z)));
    if near >= far {
        return 0.0;
    }
    let moved = |z: f32| camera.project(motion.apply(camera.unproject(u as f32, v as f32, z)));
    let ([a, b], [c, d]) = (moved(near), moved(far));
    0.5 * (a - c).hypot(b - d)
}

/// Median image motion that the camera causes, pixels; that of all corners where none has depth.
fn camera_flow(corners: &[CornerMove]) -> f32 {
    let length = |[x, y]: [f32; 2]| x.hypot(y);
    let caused = |c: &CornerMove| length([c.displacement[0] - c.residual[0], c.displacement[1] - c.residual[1]]);
    let mut lengths: Vec<f32> = corners.iter().filter(|c| c.chi2.is_some()).map(caused).collect();
    if lengths.is_empty() {
        lengths = corners.iter().map(|c| length(c.displacement)).collect();
    }
    super::objects::median(&mut lengths).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_motion_is_that_of_the_camera_even_where_most_corners_are_on_a_mover() {
        let corner =
            |displacement, residual, chi2| CornerMove { from: 0, to: 0, displacement, residual, slide: 0.0, chi2 };
        let still = corner([1.0, 0.0], [0.0, 0.0], Some(1.0));
        let mover = corner([9.0, 0.0], [8.0, 0.0], Some(1e4));
        let without_depth = corner([5.0, 0.0], [0.0; 2], None);
        assert_eq!(camera_flow(&[still, mover, mover, without_depth]), 1.0);
        assert_eq!(camera_flow(&[without_depth]), 5.0);
        assert_eq!(camera_flow(&[]), 0.0);
    }

    #[test]
    fn a_corner_beside_a_depth_edge_slides_with_the_parallax() {
        let camera = Pinhole { width: 40, height: 30, fx: 30.0, fy: 30.0, cx: 19.5, cy: 14.5 };
        let mut depth = Image::filled(40, 30, 2.0);
        (0..30).for_each(|v| depth[(10, v)] = 1.0);
        let slide_at = |u: usize, x: f64| {
            let motion = Motion::from(&Pose::translation(x, 0.0, 0.0));
            slide(&camera, &depth, &motion, 15 * camera.width + u)
        };
        // 30 pixels · 0.1 m / 1 m or 2 m: 3 and 1.5 pixels.
        assert!((slide_at(13, 0.1) - 0.75).abs() < 1e-4, "{}", slide_at(13, 0.1));
        assert_eq!(slide_at(14, 0.1), 0.0, "no edge within reach");
        assert!(slide_at(13, 0.0) < 1e-5, "a camera at rest");
    }

    #[test]
    fn corners_agree_that_follow_the_camera_and_count() {
        let corner =
            |from, chi2| CornerMove { from, to: from, displacement: [0.0; 2], residual: [0.0; 2], slide: 0.0, chi2 };
        let corners = vec![corner(0, Some(1.0)), corner(1, Some(100.0)), corner(2, None), corner(3, Some(2.0))];
        let estimate = MotionEstimate { motion: FrameMotion::none(false), corners, flow: 0.0 };
        assert_eq!(estimate.agreement(|_| true), 2.0 / 3.0, "a corner without depth has no say");
        assert_eq!(estimate.agreement(|c| c.from != 1), 1.0, "nor has one on a known mover");
        assert_eq!(estimate.agreement(|_| false), 0.0);
    }
}
