//! Rigid motions: SE(3) with its exponential and logarithm.

use nalgebra::{Isometry3, Matrix3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};

use crate::Stamp;

/// A rigid motion; as `T_a_b` it maps coordinates in frame `b` to frame `a`.
pub type Pose = Isometry3<f64>;

/// A pose with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// When.
    pub stamp: Stamp,
    /// `T_world_camera`: camera coordinates to world coordinates.
    pub pose: Pose,
}

/// Below this angle (rad) the closed forms lose digits and their Taylor series are exact to machine precision.
const SMALL_ANGLE: f64 = 1e-4;

/// The skew-symmetric matrix with `skew(a) * b == a.cross(&b)`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Exponential of SE(3); `xi = [rho; phi]`, translation part first (Barfoot, "State Estimation for Robotics", eq. 7.33).
pub fn exp(xi: &Vector6<f64>) -> Pose {
    let rho = Vector3::new(xi[0], xi[1], xi[2]);
    let phi = Vector3::new(xi[3], xi[4], xi[5]);
    Isometry3::from_parts(Translation3::from(left_jacobian(&phi) * rho), UnitQuaternion::from_scaled_axis(phi))
}

/// Logarithm of SE(3), the inverse of [`exp`] for rotations below π.
pub fn log(pose: &Pose) -> Vector6<f64> {
    let phi = pose.rotation.scaled_axis();
    let rho = inverse_left_jacobian(&phi) * pose.translation.vector;
    Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
}

/// Adjoint of SE(3): `pose * exp(xi) * pose⁻¹ == exp(adjoint(pose) * xi)` (Barfoot, eq. 7.45, translation part first).
pub fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let rotation = pose.rotation.to_rotation_matrix();
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&(skew(&pose.translation.vector) * rotation.matrix()));
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation.matrix());
    matrix
}

/// Adjoint of the Lie algebra: `lie_bracket(a) * b == [a, b]` (Barfoot, eq. 7.16, translation part first).
pub fn lie_bracket(xi: &Vector6<f64>) -> Matrix6<f64> {
    let (rho, phi) = (skew(&Vector3::new(xi[0], xi[1], xi[2])), skew(&Vector3::new(xi[3], xi[4], xi[5])));
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&phi);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&rho);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(&phi);
    matrix
}

/// Left Jacobian of SO(3) (Barfoot, eq. 7.37).
fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let angle = phi.norm();
    let (a, b) = if angle < SMALL_ANGLE {
        (0.5 - angle * angle / 24.0, 1.0 / 6.0 - angle * angle / 120.0)
    } else {
        let square = angle * angle;
        ((1.0 - angle.cos()) / square, (angle - angle.sin()) / (square * angle))
    };
    let s = skew(phi);
    Matrix3::identity() + s * a + s * s * b
}

/// Inverse of the left Jacobian of SO(3) (Barfoot, eq. 7.37).
fn inverse_left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let angle = phi.norm();
    let b = if angle < SMALL_ANGLE {
        1.0 / 12.0 + angle * angle / 720.0
    } else {
        let half = 0.5 * angle;
        (1.0 - half / half.tan()) / (angle * angle)
    };
    let s = skew(phi);
    Matrix3::identity() - s * 0.5 + s * s * b
}

/// The pose with a rotation of length one. Quaternions are inverted by conjugation, so a product with inverses takes over the errors of
/// all its factors: where a pose follows from itself by way of others, as that of a camera from its keyframe's, rounding errors grow
/// exponentially unless each is brought back to length one.
pub fn renormalized(mut pose: Pose) -> Pose {
    pose.rotation.renormalize();
    pose
}

/// Whether every number of the pose is finite.
pub fn is_finite(pose: &Pose) -> bool {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn twist() -> impl Strategy<Value = Vector6<f64>> {
        (prop::array::uniform3(-5.0..5.0_f64), prop::array::uniform3(-1.0..1.0_f64), 0.0..3.1_f64).prop_map(
            |(rho, axis, angle)| {
                let phi = Vector3::from(axis).try_normalize(1e-9).unwrap_or_else(Vector3::x) * angle;
                Vector6::new(rho[0], rho[1], rho[2], phi.x, phi.y, phi.z)
            },
        )
    }

    #[test]
    fn a_pose_that_follows_from_itself_keeps_its_length() {
        let step = exp(&Vector6::new(0.1, 0.0, 0.02, 0.01, 0.3, -0.02));
        let follow = |mend: fn(Pose) -> Pose| {
            // A camera that moves with its keyframe, and a keyframe that is where the camera was.
            let (mut camera, mut keyframe) = (step, step);
            for _ in 0..60 {
                let corrected = mend(step * keyframe);
                camera = mend(camera * keyframe.inverse() * corrected);
                keyframe = camera;
            }
            (camera.rotation.norm() - 1.0).abs()
        };
        assert!(follow(renormalized) < 1e-12);
        assert!(follow(|pose| pose) > 1e-3, "what the function is for");
    }

    proptest! {
        #[test]
        fn log_inverts_exp(xi in twist()) {
            prop_assert!((log(&exp(&xi)) - xi).norm() < 1e-8);
        }

        #[test]
        fn small_twists_keep_their_digits(xi in twist(), scale in 1e-12..1e-3_f64) {
            let small = xi * scale;
            prop_assert!((log(&exp(&small)) - small).norm() < 1e-12 + 1e-9 * small.norm());
        }

        #[test]
        fn exp_of_negative_is_inverse(xi in twist()) {
            let identity = exp(&xi) * exp(&-xi);
            prop_assert!(log(&identity).norm() < 1e-9);
        }

        #[test]
        fn adjoint_moves_a_twist_through_a_pose(xi in twist(), eta in twist()) {
            let pose = exp(&eta);
            let moved = pose * exp(&(xi * 0.1)) * pose.inverse();
            prop_assert!((log(&moved) - adjoint(&pose) * xi * 0.1).norm() < 1e-8);
        }

        #[test]
        fn lie_bracket_is_the_derivative_of_the_adjoint(xi in twist()) {
            let step = 1e-6;
            let numeric = (adjoint(&exp(&(xi * step))) - adjoint(&exp(&(xi * -step)))) / (2.0 * step);
            prop_assert!((numeric - lie_bracket(&xi)).norm() < 1e-6);
        }

        #[test]
        fn exp_is_a_one_parameter_group(xi in twist(), s in 0.0..0.5_f64, t in 0.0..0.5_f64) {
            let difference = (exp(&(xi * s)) * exp(&(xi * t))).inverse() * exp(&(xi * (s + t)));
            prop_assert!(log(&difference).norm() < 1e-9);
        }
    }
}
