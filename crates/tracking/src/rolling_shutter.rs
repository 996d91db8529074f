//! Rolling shutter: the rows of an image are exposed one after the other, while the camera moves.
//!
//! At a hand-held 0.3 m/s, 1 m from a desk, a readout of 20 ms stretches or skews an image by three pixels, many times the noise of
//! a corner. The measurements are referred to the time of the middle row by the velocity of the camera. The readout time, which no
//! driver states, is estimated from what the poses leave unexplained (on the effect in RGB-D SLAM: Kerl, Stückler and Cremers,
//! ICCV 2015; in bundle adjustment: Hedborg et al., CVPR 2012).

use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use pfd_geometry::{Camera, Pose};

use crate::image_features::ImageFeatures;
use crate::map::{Map, MapPoint};
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
        let middle = then - self.motion_of(&then) * time;
        match camera.project(&middle) {
            Some(pixel) => Measurement { pixel, depth: raw.depth.map(|(_, sigma)| (middle.z, sigma)), ..*raw },
            None => *raw,
        }
    }

    /// Velocity of a static point in the camera frame, metres per second.
    fn motion_of(&self, point: &Point3<f64>) -> Vector3<f64> {
        self.velocity.fixed_rows::<3>(0) + self.velocity.fixed_rows::<3>(3).cross(&point.coords)
    }
}

/// A map point and the feature that shows it.
#[derive(Clone, Copy, Debug)]
pub struct Sighting {
    /// Position in the world, metres.
    pub point: Point3<f64>,
    /// Index of the feature.
    pub feature: usize,
    /// How the position depends on the readout time.
    pub placement: Placement,
}

/// How the position of a map point depends on the readout time for which its views were corrected.
#[derive(Clone, Copy, Debug, Default)]
pub struct Placement {
    /// Change of the position in the world, metres per second of readout.
    by_readout: Vector3<f64>,
    /// The readout time by which it was placed, seconds.
    readout: f64,
}

impl Placement {
    /// The mean over the keyframes that see `point`.
    #[allow(non_snake_case)]
    pub fn of(map: &Map, camera: &Camera, point: &MapPoint) -> Self {
        let (mut sum, mut count) = (Self::default(), 0.0);
        for seen in point.observations() {
            let Some(keyframe) = map.keyframe(seen.keyframe) else { continue };
            let shutter = keyframe.features.shutter();
            let there = keyframe.T_camera_world * point.position;
            let time = row_time(camera, keyframe.features.raw(seen.feature).pixel.y);
            sum.by_readout -= keyframe.T_camera_world.rotation.inverse() * shutter.motion_of(&there) * time;
            sum.readout += shutter.readout;
            count += 1.0;
        }
        let count = f64::max(count, 1.0);
        Self { by_readout: sum.by_readout / count, readout: sum.readout / count }
    }
}

/// When the row at `v` pixels was exposed, in readouts after the middle row.
fn row_time(camera: &Camera, v: f64) -> f64 {
    (v + 0.5) / camera.height as f64 - 0.5
}

/// Standard deviation of the readout time before anything was seen, seconds.
const PRIOR_SIGMA: f64 = 0.01;
/// Error of the estimate from one frame that is not noise: velocity that changes, points that were placed by another estimate.
const FRAME_SIGMA: f64 = 0.005;
/// Error that the estimate gains per frame, so that what the first map got wrong is forgotten: a new frame keeps a weight of one
/// twentieth for good.
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

    /// Learns from a frame with the present readout time.
    #[allow(non_snake_case)]
    pub fn observe(
        &mut self,
        camera: &Camera,
        T_camera_world: &Pose,
        features: &ImageFeatures,
        seen: impl Iterator<Item = Sighting>,
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
    seen: impl Iterator<Item = Sighting>,
) -> Option<(f64, f64)> {
    let Shutter { velocity, readout } = *features.shutter();
    let (mut by_pose, mut mixed, mut by_readout) = (Matrix6::<f64>::zeros(), Vector6::zeros(), 0.0);
    let (mut pose_gradient, mut readout_gradient) = (Vector6::zeros(), 0.0);
    for Sighting { point, feature, placement } in seen {
        let Some(linear) = linearize(camera, T_camera_world, &point, features.measurement(feature)) else { continue };
        let in_map = linear.by_point * placement.by_readout;
        let change = linear.by_pose * velocity * row_time(camera, features.raw(feature).pixel.y) + in_map;
        // What it would be if the map knew as much as the frame.
        let residual = linear.residual + in_map * (readout - placement.readout);
        by_pose += linear.by_pose.transpose() * linear.by_pose;
        mixed += linear.by_pose.transpose() * change;
        by_readout += change.norm_squared();
        pose_gradient += linear.by_pose.transpose() * residual;
        readout_gradient += change.dot(&residual);
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
    use pfd_geometry::{Distortion, Stamp, pose};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg32;

    use crate::map::{Keyframe, Observation};
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
        ImageFeatures::from_measurements((640, 480), measurements)
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
            let observe = |(i, p): (usize, &Point3<f64>)| PoseObservation {
                point: *p,
                measured: *seen.measurement(i),
                weight: 1.0,
            };
            let observations: Vec<_> = world.iter().enumerate().map(observe).collect();
            let found = optimize_pose(&camera(), &observations, &Pose::identity(), None).unwrap().T_camera_world;
            let sighting = |(feature, point)| Sighting { point, feature, placement: Placement::default() };
            readout.observe(&camera(), &found, &seen, world.iter().copied().enumerate().map(sighting));
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
    fn the_map_depends_on_the_readout_time_as_its_placement_says() {
        let velocity = Vector6::new(0.3, -0.4, 0.2, 0.2, 0.3, -0.4);
        let world = points(&mut Pcg32::seed_from_u64(3));
        let seen = features(world.iter().map(|p| expose(p, &velocity, 0.02)).collect());
        let mut keyframe = Keyframe::new(Stamp::default(), 0, pose::exp(&Vector6::from_element(0.2)), seen);
        let mut place = |readout: f64, feature: usize| {
            keyframe.features.set_shutter(&camera(), Shutter { velocity, readout });
            keyframe.T_camera_world.inverse() * keyframe.features.point_in_camera(feature, &camera()).unwrap()
        };
        let (step, readout) = (1e-3, 0.02);
        let differences: Vec<_> = (0..20).map(|i| (place(readout + step, i) - place(readout, i)) / step).collect();
        let mut map = Map::default();
        let id = map.add_keyframe(keyframe);
        for (feature, difference) in differences.iter().enumerate() {
            let view = map.keyframe(id).unwrap();
            let position = view.T_camera_world.inverse() * view.features.point_in_camera(feature, &camera()).unwrap();
            let point = map.add_point(position, Observation { keyframe: id, feature }).unwrap();
            let placement = Placement::of(&map, &camera(), map.point(point).unwrap());
            assert!((placement.by_readout - difference).norm() < 0.02 * difference.norm() + 1e-3, "feature {feature}");
            assert!((placement.readout - readout).abs() < 1e-12);
        }
    }

    #[test]
    fn no_points_tell_nothing() {
        let mut readout = Readout::new(0.01);
        readout.observe(&camera(), &Pose::identity(), &features(Vec::new()), std::iter::empty());
        assert!((readout.seconds() - 0.01).abs() < f64::EPSILON);
    }
}
