//! Constant-velocity prediction, and the continuous odometry frame.

use nalgebra::{Matrix6, Vector6};
use pfd_geometry::{Pose, Stamp, pose};

use crate::motion_filter::{MotionFilter, UncertainPose};
use crate::pose_optimization::PosePrior;

/// A gap longer than this (seconds) says nothing about the velocity.
const MAX_EXTRAPOLATION: f64 = 0.5;

/// A frame that comes after less than this share of the usual time does so because of its stamp.
const SHORTENED: f64 = 0.5;
/// Growth of the usual interval per frame at most: a camera that has become slower is believed within a second.
const LENGTHENED: f64 = 1.2;

/// The last pose and the velocity.
#[derive(Clone, Debug)]
#[allow(non_snake_case)]
pub(crate) struct Motion {
    stamp: Stamp,
    T_camera_world: Pose,
    T_odom_camera: Pose,
    /// Twist of the camera per second between the last two poses, `interval` seconds apart; zero where there is only one.
    velocity: Vector6<f64>,
    interval: f64,
    /// The shortest interval of late, seconds: that of the camera, where frames are dropped now and then.
    usual_interval: f64,
    filter: MotionFilter,
}

#[allow(non_snake_case)]
impl Motion {
    /// At rest, at a pose that is taken as exact: it says where the world is.
    pub(crate) fn start(stamp: Stamp, T_camera_world: Pose, T_odom_camera: Pose) -> Self {
        let filter = MotionFilter::start(&Matrix6::zeros());
        Self {
            stamp,
            T_camera_world,
            T_odom_camera,
            velocity: Vector6::zeros(),
            interval: 0.0,
            usual_interval: 0.0,
            filter,
        }
    }

    /// The pose at `stamp` by what was found there and by the motion so far. [`Self::update`] then records it.
    pub(crate) fn smooth(&mut self, stamp: Stamp, found: &UncertainPose) -> UncertainPose {
        let elapsed = stamp.seconds_since(self.stamp);
        if elapsed > MAX_EXTRAPOLATION {
            self.filter = MotionFilter::start(&found.covariance);
            return *found;
        }
        self.filter.update(&self.T_camera_world, elapsed, found)
    }

    /// Whether the pose that was found at `stamp` is one that the motion so far hardly leads to.
    pub(crate) fn is_unlikely(&self, stamp: Stamp, found: &UncertainPose) -> bool {
        let elapsed = stamp.seconds_since(self.stamp);
        elapsed <= MAX_EXTRAPOLATION && self.filter.is_unlikely(&self.T_camera_world, elapsed, found)
    }

    /// What the motion so far says of the pose at `stamp`.
    pub(crate) fn prior(&self, stamp: Stamp) -> Option<PosePrior> {
        self.filter.prior(&self.T_camera_world, stamp.seconds_since(self.stamp))
    }

    /// Whether the motion so far says where the camera is at `stamp`.
    pub(crate) fn reaches(&self, stamp: Stamp) -> bool {
        (0.0..=MAX_EXTRAPOLATION).contains(&stamp.seconds_since(self.stamp))
    }

    /// Whether so much time lies between the last pose and `stamp` that everything may have changed; not where frames always come so
    /// rarely.
    pub(crate) fn is_interrupted_by(&self, stamp: Stamp) -> bool {
        stamp.seconds_since(self.stamp) > MAX_EXTRAPOLATION && self.interval <= MAX_EXTRAPOLATION
    }

    /// Velocity of the camera in its own frame, and its covariance.
    pub(crate) fn twist(&self) -> (Vector6<f64>, Matrix6<f64>) {
        self.filter.twist()
    }

    /// The pose at `stamp` if the velocity, by all frames so far, stays the same.
    pub(crate) fn predict(&self, stamp: Stamp) -> Pose {
        let elapsed = stamp.seconds_since(self.stamp);
        if elapsed > MAX_EXTRAPOLATION {
            return self.T_camera_world;
        }
        self.filter.predict(&self.T_camera_world, elapsed)
    }

    /// Twist of the camera per second in its own frame (`exp(ξ·t) · T_camera_world`) between the last two poses.
    pub(crate) fn velocity(&self) -> Vector6<f64> {
        self.velocity
    }

    /// Whether a pose comes so soon after the last that its stamp rather says something of the driver: a velocity over that time would be
    /// many times too large.
    fn is_jitter(&self, elapsed: f64) -> bool {
        elapsed < SHORTENED * self.usual_interval
    }

    /// The same at `stamp`, when the camera is at `T_camera_world`; zero after a gap. The mean over the last interval is that of
    /// its middle; the change since the interval before makes it that of its end.
    pub(crate) fn velocity_at(&self, stamp: Stamp, T_camera_world: &Pose) -> Vector6<f64> {
        let elapsed = stamp.seconds_since(self.stamp);
        if elapsed <= 0.0 || elapsed > MAX_EXTRAPOLATION {
            return Vector6::zeros();
        }
        if self.is_jitter(elapsed) {
            return self.velocity;
        }
        let mean = pose::log(&(T_camera_world * self.T_camera_world.inverse())) / elapsed;
        if self.interval <= 0.0 {
            return mean;
        }
        mean + (mean - self.velocity()) * (elapsed / (elapsed + self.interval))
    }

    /// The velocity at the last pose, when the camera came to be at `T_camera_world` at `stamp` after it: by both intervals.
    pub(crate) fn velocity_between(&self, stamp: Stamp, T_camera_world: &Pose) -> Vector6<f64> {
        let elapsed = stamp.seconds_since(self.stamp);
        if elapsed <= 0.0 || elapsed > MAX_EXTRAPOLATION || self.is_jitter(elapsed) {
            return self.velocity();
        }
        let after = pose::log(&(T_camera_world * self.T_camera_world.inverse())) / elapsed;
        if self.interval <= 0.0 {
            return after;
        }
        (self.velocity() * elapsed + after * self.interval) / (elapsed + self.interval)
    }

    /// Records the pose at `stamp`.
    pub(crate) fn update(&mut self, stamp: Stamp, T_camera_world: Pose) {
        let moved = T_camera_world * self.T_camera_world.inverse();
        let elapsed = stamp.seconds_since(self.stamp);
        if self.is_jitter(elapsed) {
            // A camera that has become faster is believed after a few frames.
            self.usual_interval = elapsed.max(SHORTENED * self.usual_interval);
        } else {
            self.velocity = if elapsed > 0.0 { pose::log(&moved) / elapsed } else { Vector6::zeros() };
            self.interval = elapsed;
            let longest = if self.usual_interval > 0.0 { LENGTHENED * self.usual_interval } else { elapsed };
            self.usual_interval = elapsed.min(longest);
        }
        self.T_odom_camera *= moved.inverse();
        self.T_odom_camera.rotation.renormalize();
        self.T_camera_world = pose::renormalized(T_camera_world);
        self.stamp = stamp;
    }

    /// The map moved under the camera: the pose changes, neither velocity nor odometry do.
    pub(crate) fn correct(&mut self, T_camera_world: Pose) {
        self.T_camera_world = pose::renormalized(T_camera_world);
    }

    /// The last two poses were estimated anew, in a map that begins with the last; odometry goes on from where it is.
    pub(crate) fn revise(&mut self, T_before_world: &Pose, T_camera_world: Pose) {
        let moved = T_camera_world * T_before_world.inverse();
        self.velocity = if self.interval > 0.0 { pose::log(&moved) / self.interval } else { Vector6::zeros() };
        self.filter = MotionFilter::start(&Matrix6::zeros()).moving(self.velocity);
        self.T_camera_world = pose::renormalized(T_camera_world);
    }

    /// The camera was found again at `stamp`: a new pose, at rest, without a jump in the odometry.
    pub(crate) fn restart(&mut self, stamp: Stamp, found: &UncertainPose) {
        let filter = MotionFilter::start(&found.covariance);
        *self = Self { filter, ..Self::start(stamp, found.T_camera_world, self.T_odom_camera) };
    }

    /// Of the last pose.
    pub(crate) fn stamp(&self) -> Stamp {
        self.stamp
    }

    pub(crate) fn T_camera_world(&self) -> &Pose {
        &self.T_camera_world
    }

    pub(crate) fn T_odom_camera(&self) -> &Pose {
        &self.T_odom_camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocity_at_the_end_of_an_interval_counts_acceleration() {
        let at = |ms: i64| Stamp::from_nanos(ms * 1_000_000);
        // Along x with 2 m/s².
        let pose = |t: f64| pose::exp(&Vector6::new(t * t, 0.0, 0.0, 0.0, 0.0, 0.0));
        let mut motion = Motion::start(at(0), pose(0.0), Pose::identity());
        motion.update(at(30), pose(0.03));
        assert!((motion.velocity().x - 0.03).abs() < 1e-9);
        assert!((motion.velocity_at(at(70), &pose(0.07)).x - 0.14).abs() < 1e-9);
        assert_eq!(motion.velocity_at(at(5000), &pose(0.07)), Vector6::zeros());
        assert!((motion.velocity_between(at(70), &pose(0.07)).x - 0.06).abs() < 1e-9);
    }

    #[test]
    fn a_stamp_that_jitters_makes_no_velocity() {
        let at = |ms: f64| Stamp::from_nanos((ms * 1e6) as i64);
        let pose = |frame: f64| pose::exp(&Vector6::new(0.01 * frame, 0.0, 0.0, 0.0, 0.0, 0.0));
        let mut motion = Motion::start(at(0.0), pose(0.0), Pose::identity());
        (1..5).for_each(|k| motion.update(at(33.0 * f64::from(k)), pose(f64::from(k))));
        let before = motion.velocity();
        assert_eq!(motion.velocity_at(at(133.0), &pose(5.0)), before, "one millisecond for the way of 33");
        motion.update(at(133.0), pose(5.0));
        assert_eq!(motion.velocity(), before);
        motion.update(at(233.0), pose(8.0));
        assert!((motion.velocity() - before).norm() < 0.01, "two frames were dropped");
        motion.update(at(266.0), pose(9.0));
        assert!((motion.velocity() - before).norm() < 0.01);
        (1..9).for_each(|k| motion.update(at(266.0 + 10.0 * f64::from(k)), pose(9.0 + f64::from(k))));
        assert!((motion.velocity().x - 1.0).abs() < 1e-6, "a camera of 100 Hz: {}", motion.velocity());
    }

    #[test]
    #[allow(non_snake_case)]
    fn revised_poses_make_the_velocity() {
        let at = |ms: i64| Stamp::from_nanos(ms * 1_000_000);
        let along_x = |x: f64| pose::exp(&Vector6::new(x, 0.0, 0.0, 0.0, 0.0, 0.0));
        let found = |T_camera_world| UncertainPose { T_camera_world, covariance: Matrix6::identity() * 1e-12 };
        let mut motion = Motion::start(at(0), Pose::identity(), Pose::identity());
        for frame in 1..6 {
            // With somebody who walks.
            let smoothed = motion.smooth(at(33 * frame), &found(along_x(0.03 * frame as f64)));
            motion.update(at(33 * frame), smoothed.T_camera_world);
        }
        let odometry = *motion.T_odom_camera();
        motion.revise(&along_x(0.02), along_x(0.01));
        let predicted = motion.predict(at(198));
        assert!(pose::log(&predicted).norm() < 1e-3, "a step back from 0.01: {predicted}");
        assert!((motion.twist().0.x - 0.01 / 0.033).abs() < 0.01, "{}", motion.twist().0);
        assert_eq!(*motion.T_odom_camera(), odometry);
    }

    #[test]
    fn a_gap_is_an_interruption_and_a_low_rate_is_none() {
        let at = |ms: i64| Stamp::from_nanos(ms * 1_000_000);
        let mut motion = Motion::start(at(0), Pose::identity(), Pose::identity());
        motion.update(at(33), Pose::identity());
        assert!(!motion.is_interrupted_by(at(400)) && motion.is_interrupted_by(at(1033)));
        motion.update(at(1033), Pose::identity());
        assert!(!motion.is_interrupted_by(at(2033)), "at 1 Hz no frame would follow without interruption");
    }

    #[test]
    fn constant_velocity_is_extrapolated_in_proportion_to_time() {
        let step = pose::exp(&Vector6::new(0.01, 0.0, 0.02, 0.0, 0.01, 0.0));
        let at = |ms: i64| Stamp::from_nanos(ms * 1_000_000);
        let mut motion = Motion::start(at(0), Pose::identity(), Pose::identity());
        assert_eq!(motion.predict(at(33)), Pose::identity());
        let exact = UncertainPose { T_camera_world: step, covariance: Matrix6::identity() * 1e-12 };
        let found = motion.smooth(at(33), &exact);
        motion.update(at(33), found.T_camera_world);
        let off = |ms: i64, expected: Pose| pose::log(&(motion.predict(at(ms)) * expected.inverse())).norm();
        assert!(off(66, step * step) < 1e-3 && off(99, step * step * step) < 1e-3);
        assert!(off(5000, step) < 1e-6, "no extrapolation over seconds");
        assert!(pose::log(&(motion.T_odom_camera() * step)).norm() < 1e-6);
    }
}
