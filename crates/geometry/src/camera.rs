//! The pinhole camera with radial-tangential distortion.

use nalgebra::{Matrix2, Matrix2x3, Point2, Point3, Vector2, Vector3};

use crate::Image;

/// A camera description that cannot be one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// Focal lengths must be positive and finite, the principal point finite.
    #[error("intrinsics fx {fx}, fy {fy}, cx {cx}, cy {cy} are not those of a camera: is the camera calibrated?")]
    Intrinsics {
        /// Focal length in x, pixels.
        fx: f64,
        /// Focal length in y, pixels.
        fy: f64,
        /// Principal point, column.
        cx: f64,
        /// Principal point, row.
        cy: f64,
    },
    /// Distortion coefficients must be finite.
    #[error("distortion coefficients {0:?} are not finite numbers")]
    Distortion([f64; 5]),
    /// The image must have pixels, and no more than [`Camera::MAX_SIDE`] a side.
    #[error("an image of {width}x{height} pixels is not supported (1 to {} a side)", Camera::MAX_SIDE)]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
}

/// Coefficients `k1 k2 p1 p2 k3` of the radial-tangential ("plumb bob") model, in the order of OpenCV and of
/// `sensor_msgs/CameraInfo`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion(pub [f64; 5]);

impl Distortion {
    /// Whether the lens does not distort.
    pub fn is_zero(&self) -> bool {
        self.0.iter().all(|&c| c == 0.0)
    }

    /// Ideal normalised image coordinates to distorted ones (Brown 1971; OpenCV's camera model).
    fn distort(&self, p: Vector2<f64>) -> Vector2<f64> {
        let [k1, k2, p1, p2, k3] = self.0;
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// Derivative of [`Self::distort`].
    fn jacobian(&self, p: Vector2<f64>) -> Matrix2<f64> {
        let [k1, k2, p1, p2, k3] = self.0;
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        // Derivative of `radial` with respect to r².
        let slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);
        let cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        )
    }

    /// Distorted normalised coordinates to ideal ones, by Newton's method.
    ///
    /// Where the model is not invertible (far outside the calibrated field of view) the best iterate is returned.
    fn undistort(&self, distorted: Vector2<f64>) -> Vector2<f64> {
        if self.is_zero() {
            return distorted;
        }
        const MAX_ITERATIONS: usize = 10;
        const TOLERANCE: f64 = 1e-12;
        let mut best = distorted;
        let mut best_error = f64::INFINITY;
        let mut p = distorted;
        for _ in 0..MAX_ITERATIONS {
            let error = self.distort(p) - distorted;
            if error.norm_squared() < best_error {
                (best, best_error) = (p, error.norm_squared());
            }
            let Some(inverse) = self.jacobian(p).try_inverse() else { break };
            if best_error < TOLERANCE * TOLERANCE {
                break;
            }
            p -= inverse * error;
        }
        best
    }
}

/// A calibrated camera: size in pixels, intrinsics in pixels, distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length in x, pixels.
    pub fx: f64,
    /// Focal length in y, pixels.
    pub fy: f64,
    /// Principal point, column.
    pub cx: f64,
    /// Principal point, row.
    pub cy: f64,
    /// Lens distortion.
    pub distortion: Distortion,
}

impl Camera {
    /// Largest supported image side in pixels; whatever claims more is refused before anything is allocated.
    pub const MAX_SIDE: usize = 8192;

    /// Points closer to the image plane than this (metres) are not projected.
    const MIN_PROJECTION_DEPTH: f64 = 1e-6;

    /// A camera, checked.
    ///
    /// # Errors
    /// [`CameraError`] when a number is not finite, a focal length not positive, or the size unsupported.
    pub fn new(
        (width, height): (usize, usize),
        [fx, fy, cx, cy]: [f64; 4],
        distortion: Distortion,
    ) -> Result<Self, CameraError> {
        if !(1..=Self::MAX_SIDE).contains(&width) || !(1..=Self::MAX_SIDE).contains(&height) {
            return Err(CameraError::Size { width, height });
        }
        let finite = [fx, fy, cx, cy].iter().all(|x| x.is_finite());
        if !finite || fx <= 0.0 || fy <= 0.0 {
            return Err(CameraError::Intrinsics { fx, fy, cx, cy });
        }
        if !distortion.0.iter().all(|x| x.is_finite()) {
            return Err(CameraError::Distortion(distortion.0));
        }
        Ok(Self { width, height, fx, fy, cx, cy, distortion })
    }

    /// Pixel of a point in the camera frame; `None` behind the camera. The pixel may lie outside the image.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        if point.z < Self::MIN_PROJECTION_DEPTH {
            return None;
        }
        let ideal = Vector2::new(point.x / point.z, point.y / point.z);
        let p = self.distortion.distort(ideal);
        Some(Point2::new(self.fx * p.x + self.cx, self.fy * p.y + self.cy))
    }

    /// Pixel of a point and the derivative of the pixel by the point (2×3, pixels per metre).
    pub fn project_with_jacobian(&self, point: &Point3<f64>) -> Option<(Point2<f64>, Matrix2x3<f64>)> {
        let pixel = self.project(point)?;
        let inverse_z = 1.0 / point.z;
        let ideal = Vector2::new(point.x * inverse_z, point.y * inverse_z);
        let perspective = Matrix2x3::new(inverse_z, 0.0, -ideal.x * inverse_z, 0.0, inverse_z, -ideal.y * inverse_z);
        let mut jacobian = self.distortion.jacobian(ideal) * perspective;
        jacobian.row_mut(0).scale_mut(self.fx);
        jacobian.row_mut(1).scale_mut(self.fy);
        Some((pixel, jacobian))
    }

    /// The viewing ray of a pixel as `(x, y, 1)` in the camera frame, distortion removed.
    pub fn ray(&self, pixel: &Point2<f64>) -> Vector3<f64> {
        let distorted = Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        let p = self.distortion.undistort(distorted);
        Vector3::new(p.x, p.y, 1.0)
    }

    /// The point in the camera frame seen at `pixel` with z coordinate `depth` (metres).
    pub fn unproject(&self, pixel: &Point2<f64>, depth: f64) -> Point3<f64> {
        Point3::from(self.ray(pixel) * depth)
    }

    /// `x` and `y` of [`Self::ray`] for every pixel.
    pub fn ray_table(&self) -> Image<[f32; 2]> {
        let mut table = Image::filled(self.width, self.height, [0.0; 2]);
        for v in 0..self.height {
            for u in 0..self.width {
                let ray = self.ray(&Point2::new(u as f64, v as f64));
                table[(u, v)] = [ray.x as f32, ray.y as f32];
            }
        }
        table
    }

    /// Whether `pixel` lies inside the image, at least `border` pixels from its edge.
    pub fn contains(&self, pixel: &Point2<f64>, border: f64) -> bool {
        pixel.x >= border
            && pixel.y >= border
            && pixel.x < self.width as f64 - border
            && pixel.y < self.height as f64 - border
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// freiburg1 of the TUM RGB-D benchmark: strong distortion.
    fn freiburg1() -> Camera {
        let distortion = Distortion([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]);
        Camera::new((640, 480), [517.3, 516.5, 318.6, 255.3], distortion).unwrap()
    }

    #[test]
    fn refuses_what_is_no_camera() {
        let zero = Distortion::default();
        assert!(matches!(Camera::new((0, 480), [1.0; 4], zero), Err(CameraError::Size { .. })));
        assert!(matches!(Camera::new((640, 480), [0.0, 1.0, 1.0, 1.0], zero), Err(CameraError::Intrinsics { .. })));
        assert!(matches!(Camera::new((640, 480), [f64::NAN; 4], zero), Err(CameraError::Intrinsics { .. })));
        let nan = Distortion([f64::NAN; 5]);
        assert!(matches!(Camera::new((640, 480), [1.0; 4], nan), Err(CameraError::Distortion(_))));
    }

    #[test]
    fn points_behind_the_camera_have_no_pixel() {
        assert_eq!(freiburg1().project(&Point3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(freiburg1().project(&Point3::new(0.0, 0.0, 0.0)), None);
    }

    #[test]
    fn every_ray_projects_to_its_pixel() {
        let camera = freiburg1();
        for v in (0..480).step_by(8) {
            for u in (0..640).step_by(8) {
                let pixel = Point2::new(f64::from(u), f64::from(v));
                let back = camera.project(&camera.unproject(&pixel, 2.0)).unwrap();
                assert!((back - pixel).norm() < 1e-6, "{pixel} came back as {back}");
            }
        }
    }

    proptest! {
        #[test]
        fn jacobian_equals_that_of_dual_numbers(
            x in -0.8..0.8_f64, y in -0.6..0.6_f64, z in 0.4..6.0_f64,
        ) {
            use num_dual::{DualNum, DualVec64, jacobian};
            let camera = freiburg1();
            let point = Point3::new(x * z, y * z, z);
            let (_, analytic) = camera.project_with_jacobian(&point).unwrap();
            let dual = |p: nalgebra::SVector<DualVec64<nalgebra::U3>, 3>| {
                let [k1, k2, p1, p2, k3] = camera.distortion.0;
                let (x, y) = (p[0] / p[2], p[1] / p[2]);
                let (xx, yy, xy) = (x.powi(2), y.powi(2), x * y);
                let r2 = xx + yy;
                let radial = r2.powi(3) * k3 + r2.powi(2) * k2 + r2 * k1 + 1.0;
                nalgebra::SVector::from([
                    (x * radial + xy * (2.0 * p1) + (r2 + xx * 2.0) * p2) * camera.fx + camera.cx,
                    (y * radial + (r2 + yy * 2.0) * p1 + xy * (2.0 * p2)) * camera.fy + camera.cy,
                ])
            };
            let (_, expected) = jacobian(dual, &nalgebra::SVector::from([point.x, point.y, point.z]));
            prop_assert!((analytic - expected).norm() < 1e-9 * expected.norm().max(1.0));
        }
    }
}
