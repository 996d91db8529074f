//! Pose and velocity of the camera over time, from poses that were found frame by frame.

use nalgebra::{Matrix6, SMatrix, Vector6};
use pfd_geometry::{Pose, pose};

use crate::pose_optimization::PosePrior;

type Matrix12 = SMatrix<f64, 12, 12>;

/// Errors of poses in standard deviations as normal equations state them: those take the map as exact and corners as independent. Beside
/// ground truth it is 1.5 to 3 on rendered sequences, 7 to 9 on those of a Kinect.
const UNDERSTATED: f64 = 6.0;
/// Acceleration of a camera in a hand or on a robot that changes from frame to frame: metres per second squared, …
const ACCELERATION: f64 = 5.0;
/// … and radians per second squared.
const ANGULAR_ACCELERATION: f64 = 20.0;
/// Velocity of a camera of which nothing is known: metres per second, …
const SPEED: f64 = 1.0;
/// … and radians per second.
const ANGULAR_SPEED: f64 = 2.0;
/// Squared normalised distance (6 degrees of freedom) between prediction and pose beyond which the camera was jolted, or moved as it
/// seldom does: the prediction then counts in proportion less.
const JOLT: f64 = 30.0;
/// The same from which a pose is worth a second look: the 98 % quantile. As covariances are generous, one frame of a thousand is beyond it.
const UNLIKELY: f64 = 15.0;

/// A pose and the covariance of a perturbation in the camera frame (tx ty tz rx ry rz, metres and radians).
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(non_snake_case)]
pub(crate) struct UncertainPose {
    /// World to camera.
    pub(crate) T_camera_world: Pose,
    pub(crate) covariance: Matrix6<f64>,
}

impl UncertainPose {
    /// With the covariance that errors beside ground truth suggest, from that of the normal equations.
    #[allow(non_snake_case)]
    pub(crate) fn found(T_camera_world: Pose, stated: &Matrix6<f64>) -> Self {
        Self { T_camera_world, covariance: stated * UNDERSTATED.powi(2) }
    }
}

/// A Kalman filter with constant velocity and random acceleration (Bar-Shalom et al., Estimation with Applications to Tracking and
/// Navigation, 2001, section 6.3.2). What one frame leaves open, such as sideways translation before a far wall, the frames before
/// say.
#[derive(Clone, Debug)]
pub(crate) struct MotionFilter {
    /// Twist of the camera in its own frame, per second (`exp(ξ·t) · T_camera_world`).
    velocity: Vector6<f64>,
    /// Of pose and velocity.
    covariance: Matrix12,
}

#[allow(non_snake_case)]
impl MotionFilter {
    /// At a pose of this covariance, with unknown velocity.
    pub(crate) fn start(covariance: &Matrix6<f64>) -> Self {
        let mut both = Matrix12::zeros();
        both.fixed_view_mut::<6, 6>(0, 0).copy_from(covariance);
        both.fixed_view_mut::<6, 6>(6, 6).copy_from(&variances(SPEED, ANGULAR_SPEED));
        Self { velocity: Vector6::zeros(), covariance: both }
    }

    /// The same with a first guess of the velocity.
    pub(crate) fn moving(self, velocity: Vector6<f64>) -> Self {
        Self { velocity, ..self }
    }

    /// Where the camera is `dt` seconds after it was at `last`.
    pub(crate) fn predict(&self, last: &Pose, dt: f64) -> Pose {
        pose::exp(&(self.velocity * dt)) * last
    }

    /// What is known of the pose `dt` seconds after the camera was at `last`, as certain beside what is seen as normal equations state that.
    pub(crate) fn prior(&self, last: &Pose, dt: f64) -> Option<PosePrior> {
        let covariance = self.covariance_after(dt).fixed_view::<6, 6>(0, 0).into_owned();
        let information = covariance.try_inverse()? * UNDERSTATED.powi(2);
        Some(PosePrior { T_camera_world: self.predict(last, dt), information })
    }

    /// Takes in the pose that was found `dt` seconds after the camera was at `last`. Returns the pose by all that is known; the
    /// found one, and the filter starts anew, where the covariances leave that open.
    pub(crate) fn update(&mut self, last: &Pose, dt: f64, found: &UncertainPose) -> UncertainPose {
        let predicted = self.predict(last, dt);
        let innovation = pose::log(&(found.T_camera_world * predicted.inverse()));
        let mut prior = self.covariance_after(dt);
        prior *= (squared_distance(&innovation, &prior, found) / JOLT).max(1.0);
        let Some(weight) = (prior.fixed_view::<6, 6>(0, 0) + found.covariance).cholesky() else {
            *self = Self::start(&found.covariance);
            return *found;
        };
        // The gain is the transpose of this.
        let gain = weight.solve(&prior.fixed_rows::<6>(0).into_owned());
        let correction = gain.transpose() * innovation;
        self.velocity += correction.fixed_rows::<6>(6);
        let posterior = prior - gain.transpose() * prior.fixed_rows::<6>(0);
        self.covariance = (posterior + posterior.transpose()) / 2.0;
        UncertainPose {
            T_camera_world: pose::renormalized(pose::exp(&correction.fixed_rows::<6>(0).into_owned()) * predicted),
            covariance: self.covariance.fixed_view::<6, 6>(0, 0).into_owned(),
        }
    }

    /// Whether the motion so far hardly leads to the pose that was found `dt` seconds after the camera was at `last`.
    pub(crate) fn is_unlikely(&self, last: &Pose, dt: f64, found: &UncertainPose) -> bool {
        let innovation = pose::log(&(found.T_camera_world * self.predict(last, dt).inverse()));
        squared_distance(&innovation, &self.covariance_after(dt), found) > UNLIKELY
    }

    /// Velocity of the camera in its own frame, and its covariance. The filter holds the twist that moves `T_camera_world`, from the
    /// left; that of the camera is its opposite.
    pub(crate) fn twist(&self) -> (Vector6<f64>, Matrix6<f64>) {
        (-self.velocity, self.covariance.fixed_view::<6, 6>(6, 6).into_owned())
    }

    /// Covariance of the prediction over `dt` seconds.
    fn covariance_after(&self, dt: f64) -> Matrix12 {
        let mut ahead = Matrix12::identity();
        ahead.fixed_view_mut::<6, 6>(0, 6).fill_diagonal(dt);
        ahead * self.covariance * ahead.transpose() + of_random_acceleration(dt)
    }
}

/// Squared normalised distance of a found pose from a prediction of covariance `prior`; zero where the covariances leave everything open.
fn squared_distance(innovation: &Vector6<f64>, prior: &Matrix12, found: &UncertainPose) -> f64 {
    let weight = (prior.fixed_view::<6, 6>(0, 0) + found.covariance).cholesky();
    weight.map_or(0.0, |weight| innovation.dot(&weight.solve(innovation)))
}

fn variances(linear: f64, angular: f64) -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::new(linear, linear, linear, angular, angular, angular).map(|s| s * s))
}

/// Covariance of pose and velocity after `dt` seconds with one random acceleration.
fn of_random_acceleration(dt: f64) -> Matrix12 {
    let variances = variances(ACCELERATION, ANGULAR_ACCELERATION);
    // What a unit acceleration adds to position and velocity.
    let effect = [dt * dt / 2.0, dt];
    let mut both = Matrix12::zeros();
    for (i, a) in effect.into_iter().enumerate() {
        for (j, b) in effect.into_iter().enumerate() {
            both.fixed_view_mut::<6, 6>(6 * i, 6 * j).copy_from(&(variances * (a * b)));
        }
    }
    both
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    const DT: f64 = 1.0 / 30.0;

    #[allow(non_snake_case)]
    fn uncertain(T_camera_world: Pose, sigma: f64) -> UncertainPose {
        UncertainPose { T_camera_world, covariance: Matrix6::identity() * sigma * sigma }
    }

    fn distance(a: &Pose, b: &Pose) -> f64 {
        pose::log(&(a * b.inverse())).norm()
    }

    /// RMS error of what is found with this noise, and of what the filter makes of it, over `frames` of a camera on a circle.
    fn errors(sigma: f64, frames: usize) -> [f64; 2] {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(5);
        let truth = |i: usize| {
            let angle = 1.5 * DT * i as f64;
            pose::exp(&Vector6::new(0.3 * angle.sin(), 0.1, 0.3 * angle.cos(), 0.0, 0.2 * angle.sin(), 0.0))
        };
        let mut last = truth(0);
        let mut filter = MotionFilter::start(&(Matrix6::identity() * sigma * sigma));
        let mut sums = [0.0; 2];
        for i in 1..frames {
            // The sum of twelve uniform numbers has variance 1.
            let noise =
                Vector6::from_fn(|_, _| sigma * ((0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0));
            let found = uncertain(pose::exp(&noise) * truth(i), sigma);
            let filtered = filter.update(&last, DT, &found);
            last = filtered.T_camera_world;
            sums[0] += distance(&found.T_camera_world, &truth(i)).powi(2);
            sums[1] += distance(&last, &truth(i)).powi(2);
        }
        sums.map(|sum| (sum / frames as f64).sqrt())
    }

    #[test]
    fn noise_is_smoothed_and_exact_poses_stay_exact() {
        let [found, filtered] = errors(0.01, 300);
        assert!(filtered < 0.9 * found, "{filtered} of {found}");
        let [found, filtered] = errors(1e-5, 300);
        assert!(filtered < 1.05 * found, "{filtered} of {found}");
    }

    #[test]
    fn the_filtered_pose_lies_between_prediction_and_measurement_and_is_more_certain() {
        let step = pose::exp(&Vector6::new(0.01, 0.0, 0.0, 0.0, 0.0, 0.0));
        let mut filter = MotionFilter::start(&(Matrix6::identity() * 1e-6));
        let mut last = Pose::identity();
        for _ in 0..30 {
            last = filter.update(&last, DT, &uncertain(step * last, 1e-3)).T_camera_world;
        }
        let aside = pose::exp(&Vector6::new(0.01, 0.01, 0.0, 0.0, 0.0, 0.0)) * last;
        let filtered = filter.update(&last, DT, &uncertain(aside, 0.01));
        let y = (filtered.T_camera_world * last.inverse()).translation.vector.y;
        assert!((0.001..0.009).contains(&y), "{y}");
        assert!(filtered.covariance[(1, 1)] < 1e-4);
        assert!(filtered.covariance.cholesky().is_some(), "a covariance is positive definite");
        let (twist, covariance) = filter.twist();
        assert!((twist.x + 0.01 / DT).abs() < 0.02, "the camera moves against the points: {twist}");
        assert!(covariance.cholesky().is_some() && covariance[(0, 0)] < SPEED * SPEED);
    }

    #[test]
    fn a_jolt_is_followed() {
        let mut filter = MotionFilter::start(&(Matrix6::identity() * 1e-6));
        let mut last = Pose::identity();
        for _ in 0..10 {
            last = filter.update(&last, DT, &uncertain(Pose::identity(), 1e-3)).T_camera_world;
        }
        let jolted = pose::exp(&Vector6::new(0.2, 0.0, 0.0, 0.3, 0.0, 0.0));
        let filtered = filter.update(&last, DT, &uncertain(jolted, 1e-3));
        assert!(distance(&filtered.T_camera_world, &jolted) < 0.002);
    }

    #[test]
    fn a_leap_is_unlikely_unless_the_pose_is_as_uncertain() {
        let step = pose::exp(&Vector6::new(0.01, 0.0, 0.0, 0.0, 0.01, 0.0));
        let mut filter = MotionFilter::start(&(Matrix6::identity() * 1e-6));
        let mut last = Pose::identity();
        for _ in 0..10 {
            last = filter.update(&last, DT, &uncertain(step * last, 1e-3)).T_camera_world;
        }
        let leap = pose::exp(&Vector6::new(0.12, 0.0, 0.0, 0.0, -0.03, 0.0));
        let is_unlikely = |motion: Pose, sigma| filter.is_unlikely(&last, DT, &uncertain(motion * step * last, sigma));
        assert!(is_unlikely(leap, 0.01));
        assert!(!is_unlikely(leap, 0.1));
        assert!(!is_unlikely(pose::exp(&Vector6::new(0.01, 0.0, 0.0, 0.0, 0.01, 0.0)), 0.01), "twice as fast");
    }

    #[test]
    fn what_is_known_before_a_frame_is_the_prediction_and_less_with_time() {
        let mut filter = MotionFilter::start(&(Matrix6::identity() * 1e-6));
        let mut last = Pose::identity();
        let step = pose::exp(&Vector6::new(0.01, 0.0, 0.0, 0.0, 0.01, 0.0));
        for _ in 0..10 {
            last = filter.update(&last, DT, &uncertain(step * last, 1e-3)).T_camera_world;
        }
        let [soon, late] = [DT, 5.0 * DT].map(|dt| filter.prior(&last, dt).unwrap());
        assert_eq!(soon.T_camera_world, filter.predict(&last, DT));
        assert!(soon.information.cholesky().is_some(), "an information matrix is positive definite");
        assert!((0..6).all(|k| soon.information[(k, k)] > 4.0 * late.information[(k, k)]));
    }

    #[test]
    fn covariances_that_leave_everything_open_start_it_anew() {
        let mut filter = MotionFilter::start(&Matrix6::zeros());
        let found = UncertainPose { T_camera_world: Pose::identity(), covariance: Matrix6::identity() * f64::NAN };
        assert_eq!(filter.update(&Pose::identity(), DT, &found).T_camera_world, Pose::identity());
        let found = uncertain(pose::exp(&Vector6::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.0)), 0.01);
        let next = filter.update(&Pose::identity(), DT, &found);
        assert!(pose::is_finite(&next.T_camera_world));
    }
}
