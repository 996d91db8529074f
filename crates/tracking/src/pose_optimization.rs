//! The camera pose from map points: Gauss–Newton with re-classified outliers.

use nalgebra::{Matrix6, Point3, Vector6};
use pfd_geometry::{Camera, Pose, pose};
use pfd_optimization::RobustKernel;

use crate::residual::{Measurement, linearize, residual};

/// A map point and the corner that shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseObservation {
    /// Position in the world, metres.
    pub point: Point3<f64>,
    /// Where it was seen.
    pub measured: Measurement,
    /// How much it counts beside the others: only the ratio of the weights matters, which are positive.
    pub weight: f64,
}

/// What is known of a pose without the observations.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(non_snake_case)]
pub struct PosePrior {
    /// World to camera.
    pub T_camera_world: Pose,
    /// Inverse covariance of a perturbation in the camera frame (tx ty tz rx ry rz), on the scale of the observations' standard deviations.
    pub information: Matrix6<f64>,
}

/// An estimated pose.
#[derive(Clone, Debug, PartialEq)]
#[allow(non_snake_case)]
pub struct PoseEstimate {
    /// World to camera.
    pub T_camera_world: Pose,
    /// For each observation, whether it agrees with the pose.
    pub inliers: Vec<bool>,
    /// Covariance of a perturbation in the camera frame (tx ty tz rx ry rz).
    pub covariance: Matrix6<f64>,
}

impl PoseEstimate {
    /// Number of observations that agree.
    pub fn inlier_count(&self) -> usize {
        self.inliers.iter().filter(|&&inlier| inlier).count()
    }
}

/// Classifications of the observations into inliers and outliers.
const ROUNDS: usize = 4;
/// Gauss–Newton iterations in each round.
const ITERATIONS: usize = 6;
/// The robust kernel guards the first rounds; later ones are plain least squares over the inliers.
const ROBUST_ROUNDS: usize = 2;
/// A pose has six parameters; fewer than three points do not determine it.
const MIN_OBSERVATIONS: usize = 3;
/// A direction about which the observations say this share of what they say about the best determined one is open: rounding leaves so
/// much (metres and radians are alike here, as depths are of the order of a metre).
const OPEN: f64 = 1e-10;
/// A step smaller than this (metres and radians) ends the iteration.
const STEP_TOLERANCE: f64 = 1e-7;

/// Estimates the pose from `observations`, starting at `initial`, and from a `prior` if there is one.
///
/// `None` when the observations do not determine a pose (too few, degenerate, or no agreement).
pub fn optimize_pose(
    camera: &Camera,
    observations: &[PoseObservation],
    initial: &Pose,
    prior: Option<&PosePrior>,
) -> Option<PoseEstimate> {
    let mut estimate = *initial;
    let mut inliers = vec![true; observations.len()];
    for round in 0..ROUNDS {
        if inliers.iter().filter(|&&inlier| inlier).count() < MIN_OBSERVATIONS {
            return None;
        }
        let robust = round < ROBUST_ROUNDS;
        for _ in 0..ITERATIONS {
            let (mut hessian, mut gradient) = normal_equations(camera, observations, &inliers, &estimate, robust);
            if let Some(prior) = prior {
                hessian += prior.information;
                gradient += prior.information * pose::log(&(estimate * prior.T_camera_world.inverse()));
            }
            let step = hessian.cholesky()?.solve(&-gradient);
            estimate = pose::exp(&step) * estimate;
            if step.norm() < STEP_TOLERANCE {
                break;
            }
        }
        for (inlier, observation) in inliers.iter_mut().zip(observations) {
            *inlier = is_inlier(camera, observation, &estimate);
        }
    }
    let (information, spread) = information(camera, observations, &inliers, &estimate);
    let eigenvalues = information.symmetric_eigenvalues();
    if eigenvalues.min() <= OPEN * eigenvalues.max() {
        return None;
    }
    let gain = information.try_inverse()?;
    let covariance = gain * spread * gain;
    pose::is_finite(&estimate).then_some(PoseEstimate { T_camera_world: estimate, inliers, covariance })
}

/// Whether the observation agrees with the pose at the 95 % level.
#[allow(non_snake_case)]
pub fn is_inlier(camera: &Camera, observation: &PoseObservation, T_camera_world: &Pose) -> bool {
    residual(camera, T_camera_world, &observation.point, &observation.measured)
        .is_some_and(|r| r.norm_squared() <= observation.measured.chi2_threshold())
}

#[allow(non_snake_case)]
fn normal_equations(
    camera: &Camera,
    observations: &[PoseObservation],
    inliers: &[bool],
    T_camera_world: &Pose,
    robust: bool,
) -> (Matrix6<f64>, Vector6<f64>) {
    let mut hessian = Matrix6::zeros();
    let mut gradient = Vector6::zeros();
    for (observation, _) in observations.iter().zip(inliers).filter(|(_, inlier)| **inlier) {
        let Some(linear) = linearize(camera, T_camera_world, &observation.point, &observation.measured) else {
            continue;
        };
        let kernel =
            if robust { RobustKernel::Huber(observation.measured.huber_width()) } else { RobustKernel::Quadratic };
        let weight = observation.weight * kernel.weight(linear.residual.norm_squared());
        let weighted = linear.by_pose.transpose() * weight;
        hessian += weighted * linear.by_pose;
        gradient += weighted * linear.residual;
    }
    (hessian, gradient)
}

/// What the inliers say of the pose by their weights, `Σ w JᵀJ`, and the covariance of what they say, `Σ w² JᵀJ`: noise does not know of
/// weights.
#[allow(non_snake_case)]
fn information(
    camera: &Camera,
    observations: &[PoseObservation],
    inliers: &[bool],
    T_camera_world: &Pose,
) -> (Matrix6<f64>, Matrix6<f64>) {
    let agreeing = observations.iter().zip(inliers).filter_map(|(o, &inlier)| inlier.then_some(o));
    agreeing.fold((Matrix6::zeros(), Matrix6::zeros()), |(information, spread), o| {
        let linear = linearize(camera, T_camera_world, &o.point, &o.measured);
        let own = linear.map_or_else(Matrix6::zeros, |l| l.by_pose.transpose() * l.by_pose);
        (information + own * o.weight, spread + own * o.weight.powi(2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;
    use pfd_geometry::Distortion;
    use rand::{RngExt, SeedableRng};

    fn camera() -> Camera {
        Camera::new((640, 480), [520.0, 520.0, 320.0, 240.0], Distortion::default()).unwrap()
    }

    /// Exact observations of `count` points; the first `outliers` of them point somewhere else.
    fn scene(count: usize, outliers: usize, truth: &Pose, with_depth: bool) -> Vec<PoseObservation> {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(3);
        (0..count)
            .map(|i| {
                let pixel = Point2::new(rng.random_range(20.0..620.0), rng.random_range(20.0..460.0));
                let z = rng.random_range(1.0..4.0);
                let point = truth.inverse() * camera().unproject(&pixel, z);
                let shift = if i < outliers { 40.0 } else { 0.0 };
                let measured = Measurement {
                    pixel: Point2::new(pixel.x + shift, pixel.y),
                    sigma: 1.0,
                    depth: with_depth.then_some((z, 0.01)),
                };
                PoseObservation { point, measured, weight: 1.0 }
            })
            .collect()
    }

    #[test]
    fn recovers_the_pose_despite_outliers() {
        let truth = pose::exp(&Vector6::new(0.05, -0.02, 0.1, 0.02, -0.03, 0.05));
        for with_depth in [true, false] {
            let estimate =
                optimize_pose(&camera(), &scene(100, 25, &truth, with_depth), &Pose::identity(), None).unwrap();
            assert!(pose::log(&(estimate.T_camera_world * truth.inverse())).norm() < 1e-6);
            assert_eq!(estimate.inlier_count(), 75);
            assert!(estimate.covariance.cholesky().is_some(), "a covariance is positive definite");
        }
    }

    #[test]
    fn what_is_known_for_long_outweighs_more_that_is_new() {
        let truth = pose::exp(&Vector6::new(0.05, -0.02, 0.1, 0.02, -0.03, 0.05));
        let still = scene(60, 0, &truth, true);
        // Somebody whose points came in a moment ago, and who takes a step of 4 cm.
        let step = pose::exp(&Vector6::new(0.04, 0.0, 0.0, 0.0, 0.0, 0.0));
        let moved =
            |o: PoseObservation| PoseObservation { point: truth.inverse() * step.inverse() * truth * o.point, ..o };
        let error_with = |weight: f64| {
            let walker = scene(120, 0, &truth, true).into_iter().skip(30);
            let walker = walker.map(|o| PoseObservation { weight, ..moved(o) });
            let all: Vec<_> = still.iter().copied().chain(walker).collect();
            let found = optimize_pose(&camera(), &all, &truth, None).unwrap();
            (pose::log(&(found.T_camera_world * truth.inverse())).norm(), found)
        };
        let (equal, _) = error_with(1.0);
        let (light, found) = error_with(0.05);
        assert!(equal > 0.035, "more of what moves than of what stands takes the camera along: {equal}");
        assert!(light < 1e-6, "{light}");
        assert_eq!(found.inlier_count(), 60);
    }

    #[test]
    fn a_prior_counts_by_its_information() {
        let truth = pose::exp(&Vector6::new(0.05, -0.02, 0.1, 0.02, -0.03, 0.05));
        let observations = scene(100, 0, &truth, true);
        let off = pose::exp(&Vector6::new(0.01, 0.0, 0.0, 0.0, 0.0, 0.0));
        let error_with = |information: f64| {
            let information = Matrix6::identity() * information;
            let prior = PosePrior { T_camera_world: off * truth, information };
            let found = optimize_pose(&camera(), &observations, &truth, Some(&prior)).unwrap();
            pose::log(&(found.T_camera_world * truth.inverse())).norm()
        };
        let [nothing, something, everything] = [0.0, 1e6, 1e12].map(error_with);
        assert!(nothing < 1e-9, "{nothing}");
        assert!((0.0005..0.0095).contains(&something), "{something}");
        assert!((everything - 0.01).abs() < 1e-5, "{everything}");
    }

    #[test]
    fn only_the_ratio_of_weights_matters() {
        let truth = pose::exp(&Vector6::new(0.05, -0.02, 0.1, 0.02, -0.03, 0.05));
        let with = |weight: f64| {
            let observations = scene(50, 5, &truth, true).into_iter().map(|o| PoseObservation { weight, ..o });
            optimize_pose(&camera(), &observations.collect::<Vec<_>>(), &Pose::identity(), None).unwrap()
        };
        let (one, tenth) = (with(1.0), with(0.1));
        assert!((one.covariance - tenth.covariance).norm() < 1e-9 * one.covariance.norm());
    }

    #[test]
    fn the_covariance_is_that_of_the_errors_whatever_the_weights() {
        const TRIALS: usize = 400;
        let truth = pose::exp(&Vector6::new(0.05, -0.02, 0.1, 0.02, -0.03, 0.05));
        let mut rng = rand_pcg::Pcg32::seed_from_u64(8);
        // The sum of twelve uniform numbers has variance 1.
        let mut normal = || (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0;
        let exact = scene(160, 0, &truth, true);
        let (mut stated, mut squares) = (Matrix6::zeros(), Vector6::zeros());
        for _ in 0..TRIALS {
            let disturb = |(i, o): (usize, &PoseObservation)| {
                let Measurement { pixel, sigma, depth } = o.measured;
                let pixel = Point2::new(pixel.x + sigma * normal(), pixel.y + sigma * normal());
                let depth = depth.map(|(z, sigma)| (z + sigma * normal(), sigma));
                let weight = if i % 4 == 0 { 1.0 } else { 0.1 };
                PoseObservation { measured: Measurement { pixel, sigma, depth }, weight, ..*o }
            };
            let observations: Vec<_> = exact.iter().enumerate().map(disturb).collect();
            let found = optimize_pose(&camera(), &observations, &truth, None).unwrap();
            stated += found.covariance / TRIALS as f64;
            squares += pose::log(&(found.T_camera_world * truth.inverse())).map(|e| e * e) / TRIALS as f64;
        }
        for k in 0..6 {
            let ratio = squares[k] / stated[(k, k)];
            // 400 trials leave 7 % open; what is more than two standard deviations off is left out by the estimate, and makes it surer.
            assert!((0.75..1.25).contains(&ratio), "{k}: {ratio}");
        }
    }

    /// Exact observations of points on the wall z = 2 m, at these pixels of the camera at the origin.
    fn wall(pixels: &[(f64, f64)], truth: &Pose, with_depth: bool) -> Vec<PoseObservation> {
        let observe = |&(x, y): &(f64, f64)| {
            let point = camera().unproject(&Point2::new(x, y), 2.0);
            let seen = truth * point;
            let depth = with_depth.then_some((seen.z, 0.01));
            PoseObservation {
                point,
                measured: Measurement { pixel: camera().project(&seen).unwrap(), sigma: 1.0, depth },
                weight: 1.0,
            }
        };
        pixels.iter().map(observe).collect()
    }

    #[test]
    fn a_plane_and_three_points_determine_a_pose_and_a_line_does_not() {
        let truth = pose::exp(&Vector6::new(0.03, -0.02, 0.05, 0.02, -0.03, 0.04));
        let grid: Vec<_> =
            (0..25).map(|i| (120.0 + 100.0 * f64::from(i % 5), 80.0 + 80.0 * f64::from(i / 5))).collect();
        let three = [(150.0, 100.0), (500.0, 150.0), (300.0, 400.0)];
        for observations in [wall(&grid, &truth, true), wall(&grid, &truth, false), wall(&three, &truth, true)] {
            let found = optimize_pose(&camera(), &observations, &Pose::identity(), None).unwrap();
            assert!(pose::log(&(found.T_camera_world * truth.inverse())).norm() < 1e-6);
        }
        // Seen from where they were made, the points of a line leave the rotation about it open.
        for row in [17.0, 100.0, 240.0, 333.3] {
            let line: Vec<_> = (0..20).map(|i| (100.0 + 20.0 * f64::from(i), row)).collect();
            assert_eq!(optimize_pose(&camera(), &wall(&line, &Pose::identity(), true), &Pose::identity(), None), None);
        }
    }

    #[test]
    fn degenerate_observations_have_no_pose() {
        let truth = Pose::identity();
        assert_eq!(optimize_pose(&camera(), &scene(2, 0, &truth, true), &truth, None), None);
        let same = vec![scene(1, 0, &truth, false)[0]; 50];
        assert_eq!(optimize_pose(&camera(), &same, &truth, None), None, "one point seen fifty times");
        let mut behind = scene(50, 0, &truth, true);
        for observation in &mut behind {
            observation.point.z = -1.0;
        }
        assert_eq!(optimize_pose(&camera(), &behind, &truth, None), None);
    }
}
