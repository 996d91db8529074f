//! Poses, transforms, covariances, odometry.

use nalgebra::{Matrix6, Quaternion, Translation3, UnitQuaternion, Vector3, Vector6};
use pfd_geometry::Pose;
use pfd_geometry::pose::adjoint;

use crate::messages::geometry::{self, Transform};

/// `geometry_msgs/Pose`
pub fn pose_to_message(pose: &Pose) -> geometry::Pose {
    geometry::Pose { position: vector(&pose.translation.vector), orientation: quaternion(&pose.rotation) }
}

/// `geometry_msgs/Transform`
pub fn pose_to_transform(pose: &Pose) -> Transform {
    Transform { translation: vector(&pose.translation.vector), rotation: quaternion(&pose.rotation) }
}

/// The pose of a transform; `None` when a number is not finite or the quaternion has no direction.
pub fn pose_from_transform(transform: &Transform) -> Option<Pose> {
    /// Shorter quaternions (they should have length 1) mean nothing.
    const MIN_NORM: f64 = 1e-3;
    let (t, q) = (&transform.translation, &transform.rotation);
    let rotation = UnitQuaternion::try_new(Quaternion::new(q.w, q.x, q.y, q.z), MIN_NORM)?;
    let pose = Pose::from_parts(Translation3::new(t.x, t.y, t.z), rotation);
    pfd_geometry::pose::is_finite(&pose).then_some(pose)
}

/// `geometry_msgs/Vector3` or `Point`
pub fn vector(v: &Vector3<f64>) -> geometry::Vector3 {
    geometry::Vector3 { x: v.x, y: v.y, z: v.z }
}

fn quaternion(q: &UnitQuaternion<f64>) -> geometry::Quaternion {
    geometry::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }
}

/// Covariance by rows, as messages want it.
pub fn covariance_to_message(covariance: &Matrix6<f64>) -> [[f64; 6]; 6] {
    std::array::from_fn(|row| std::array::from_fn(|column| covariance[(row, column)]))
}

/// A covariance given in a frame `camera` (perturbation on the right), seen from `base` with `T_base_camera`
/// (Barfoot, "State Estimation for Robotics", eq. 7.140: the adjoint carries perturbations from frame to frame).
#[allow(non_snake_case)]
pub fn move_covariance(covariance: &Matrix6<f64>, T_base_camera: &Pose) -> Matrix6<f64> {
    let carried = adjoint(T_base_camera);
    carried * covariance * carried.transpose()
}

/// Rotates the translation part of a right perturbation's covariance into the reference frame: what `nav_msgs/Odometry` wants,
/// whose pose covariance is about the axes of the header's frame.
pub fn align_covariance(covariance: &Matrix6<f64>, pose: &Pose) -> Matrix6<f64> {
    let r = pose.rotation.to_rotation_matrix();
    let mut blocks = Matrix6::zeros();
    blocks.fixed_view_mut::<3, 3>(0, 0).copy_from(r.matrix());
    blocks.fixed_view_mut::<3, 3>(3, 3).copy_from(r.matrix());
    blocks * covariance * blocks.transpose()
}

/// A twist of the rigid body in its frame `camera` (linear part first), seen from its frame `base` with `T_base_camera`.
#[allow(non_snake_case)]
pub fn move_twist(twist: &Vector6<f64>, T_base_camera: &Pose) -> Vector6<f64> {
    adjoint(T_base_camera) * twist
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::pose;

    fn example() -> Pose {
        pose::exp(&Vector6::new(0.3, -0.2, 1.0, 0.4, -0.5, 0.6))
    }

    #[test]
    fn transforms_go_there_and_back() {
        let back = pose_from_transform(&pose_to_transform(&example())).unwrap();
        assert!(pose::log(&(back.inverse() * example())).norm() < 1e-12);
        let zero =
            Transform { rotation: geometry::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 }, ..Transform::default() };
        assert_eq!(pose_from_transform(&zero), None);
        let nan = Transform { translation: geometry::Vector3 { x: f64::NAN, y: 0.0, z: 0.0 }, ..Transform::default() };
        assert_eq!(pose_from_transform(&nan), None);
    }

    #[test]
    fn a_perturbation_moves_by_the_adjoint() {
        let (offset, xi) = (example(), Vector6::new(1e-5, 2e-5, -1e-5, 3e-5, -2e-5, 1e-5));
        let moved = pose::log(&(offset * pose::exp(&xi) * offset.inverse()));
        let outer = move_covariance(&(xi * xi.transpose()), &offset);
        assert!((outer - moved * moved.transpose()).norm() < 1e-6 * outer.norm());
    }

    #[test]
    fn a_camera_ahead_of_the_base_swings_when_the_base_turns() {
        // The base turns to the left by 1 rad/s; the camera, 2 m ahead, goes left by 2 m/s as it turns.
        let of_camera = Vector6::new(0.0, 2.0, 0.0, 0.0, 0.0, 1.0);
        let of_base = move_twist(&of_camera, &Pose::translation(2.0, 0.0, 0.0));
        assert!((of_base - Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)).norm() < 1e-12);
    }
}
