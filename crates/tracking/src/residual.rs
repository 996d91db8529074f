//! The measurement model: a map point seen as a corner with depth.
//!
//! A residual has three rows, normalised by their standard deviations: column, row (pixels), depth (metres). Without depth
//! the third row is zero, in residual and Jacobian alike.

use nalgebra::{Matrix3, Matrix3x6, Point2, Point3, Vector3};
use pfd_geometry::{Camera, Pose, pose};

/// A corner with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// Where it is in the image, pixels.
    pub pixel: Point2<f64>,
    /// Standard deviation of the position, pixels.
    pub sigma: f64,
    /// Depth and its standard deviation, metres.
    pub depth: Option<(f64, f64)>,
}

impl Measurement {
    /// Squared normalised residuals above this are outliers: 95 % quantile of χ² with 2 or 3 degrees of freedom.
    pub fn chi2_threshold(&self) -> f64 {
        if self.depth.is_some() { 7.815 } else { 5.991 }
    }

    /// Width of the Huber kernel that matches [`Self::chi2_threshold`].
    pub fn huber_width(&self) -> f64 {
        self.chi2_threshold().sqrt()
    }
}

/// A linearised residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearized {
    /// Prediction minus measurement, normalised.
    pub residual: Vector3<f64>,
    /// Derivative by a left perturbation of `T_camera_world` (`exp(ξ) · T`, translation first).
    pub by_pose: Matrix3x6<f64>,
    /// Derivative by the point in the world.
    pub by_point: Matrix3<f64>,
}

/// The normalised residual; `None` when the point is behind the camera.
#[allow(non_snake_case)]
pub fn residual(
    camera: &Camera,
    T_camera_world: &Pose,
    point: &Point3<f64>,
    measured: &Measurement,
) -> Option<Vector3<f64>> {
    let in_camera = T_camera_world * point;
    let pixel = camera.project(&in_camera)?;
    Some(normalize(&(pixel - measured.pixel), in_camera.z, measured))
}

/// The residual with its derivatives; `None` when the point is behind the camera.
#[allow(non_snake_case)]
pub fn linearize(
    camera: &Camera,
    T_camera_world: &Pose,
    point: &Point3<f64>,
    measured: &Measurement,
) -> Option<Linearized> {
    let in_camera = T_camera_world * point;
    let (pixel, projection) = camera.project_with_jacobian(&in_camera)?;
    let mut by_camera_point = Matrix3::zeros();
    by_camera_point.fixed_rows_mut::<2>(0).copy_from(&(projection / measured.sigma));
    if let Some((_, sigma)) = measured.depth {
        by_camera_point[(2, 2)] = 1.0 / sigma;
    }
    let mut motion = Matrix3x6::zeros();
    motion.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
    motion.fixed_columns_mut::<3>(3).copy_from(&-pose::skew(&in_camera.coords));
    Some(Linearized {
        residual: normalize(&(pixel - measured.pixel), in_camera.z, measured),
        by_pose: by_camera_point * motion,
        by_point: by_camera_point * T_camera_world.rotation.to_rotation_matrix().matrix(),
    })
}

fn normalize(pixel_error: &nalgebra::Vector2<f64>, z: f64, measured: &Measurement) -> Vector3<f64> {
    let depth_error = measured.depth.map_or(0.0, |(depth, sigma)| (z - depth) / sigma);
    Vector3::new(pixel_error.x / measured.sigma, pixel_error.y / measured.sigma, depth_error)
}

#[cfg(test)]
// num-dual asks for functions that take their argument by value.
#[allow(clippy::large_types_passed_by_value)]
mod tests {
    use super::*;
    use nalgebra::{SVector, U9, Vector6};
    use num_dual::{DualNum, DualVec64, jacobian};
    use pfd_geometry::Distortion;
    use proptest::prelude::*;

    type Dual = DualVec64<U9>;

    /// `exp(ξ)·p` to first order in ξ, which is exact for its derivative at ξ = 0.
    fn moved(xi: &[Dual], p: [Dual; 3]) -> [Dual; 3] {
        let [x, y, z] = p;
        [x + xi[0] + xi[4] * z - xi[5] * y, y + xi[1] + xi[5] * x - xi[3] * z, z + xi[2] + xi[3] * y - xi[4] * x]
    }

    proptest! {
        #[test]
        fn jacobians_equal_those_of_dual_numbers(
            twist in prop::array::uniform6(-0.3..0.3_f64),
            (x, y, z) in (-0.4..0.4_f64, -0.3..0.3_f64, 1.0..4.0_f64),
        ) {
            let camera = Camera::new((640, 480), [520.0, 510.0, 320.0, 240.0], Distortion::default()).unwrap();
            let pose = pose::exp(&Vector6::from(twist));
            let point = pose.inverse() * Point3::new(x * z, y * z, z);
            let measured = Measurement { pixel: Point2::new(300.0, 200.0), sigma: 1.3, depth: Some((2.0, 0.02)) };
            let analytic = linearize(&camera, &pose, &point, &measured).unwrap();
            let rotation = pose.rotation.to_rotation_matrix();
            let evaluate = |parameters: SVector<Dual, 9>| {
                let (xi, p) = parameters.as_slice().split_at(6);
                let turned: [Dual; 3] = std::array::from_fn(|i| {
                    p[0] * rotation[(i, 0)] + p[1] * rotation[(i, 1)] + p[2] * rotation[(i, 2)]
                        + pose.translation.vector[i]
                });
                let [x, y, z] = moved(xi, turned);
                let inverse = z.recip();
                SVector::from([
                    (x * inverse * camera.fx + camera.cx - 300.0) / 1.3,
                    (y * inverse * camera.fy + camera.cy - 200.0) / 1.3,
                    (z - 2.0) / 0.02,
                ])
            };
            let mut at = SVector::<f64, 9>::zeros();
            at.fixed_rows_mut::<3>(6).copy_from(&point.coords);
            let (value, expected) = jacobian(evaluate, &at);
            prop_assert!((analytic.residual - value).norm() < 1e-9 * value.norm().max(1.0));
            prop_assert!((analytic.by_pose - expected.fixed_columns::<6>(0)).norm() < 1e-9 * expected.norm());
            prop_assert!((analytic.by_point - expected.fixed_columns::<3>(6)).norm() < 1e-9 * expected.norm());
        }
    }

    #[test]
    fn without_depth_the_third_row_is_zero() {
        let camera = Camera::new((640, 480), [520.0, 510.0, 320.0, 240.0], Distortion::default()).unwrap();
        let measured = Measurement { pixel: Point2::new(300.0, 200.0), sigma: 1.0, depth: None };
        let linear = linearize(&camera, &Pose::identity(), &Point3::new(0.1, 0.1, 2.0), &measured).unwrap();
        let third = [linear.residual.z, linear.by_pose.row(2).norm(), linear.by_point.row(2).norm()];
        assert!(third.iter().all(|x| x.abs() < f64::MIN_POSITIVE), "{third:?}");
    }
}
