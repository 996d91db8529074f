//! Aligns the static model with a frame.
//!
//! Motions from frame to frame add up their errors: what the model remembers behind a mover, or beside the view, no longer lies where it
//! was. So the motion is corrected by what the model knows: depth (projective, with the slope of the surface: Newcombe et al.,
//! "KinectFusion", ISMAR 2011) and luma (Steinbrücker et al., ICCV Workshops 2011) of its points against those of the frame.

use nalgebra::{SMatrix, SVector, Vector6};
use pfd_geometry::{DepthNoise, Pose, pose};

use super::evidence::MAX_SLOPE;
use super::regions::neighbours;
use super::static_model::ModelPoint;
use super::view::{Motion, Pinhole, ViewFrame};

/// About so many points are compared.
const SAMPLE: usize = 1600;
/// Gauss-Newton steps.
const STEPS: usize = 2;
/// Six of the motion, and the change of exposure.
const UNKNOWNS: usize = 7;
/// Standard deviations of what frame to frame motion leaves open: metres, …
const TRANSLATION_SIGMA: f64 = 0.006;
/// … and radians.
const ROTATION_SIGMA: f64 = 0.004;
/// Standard deviation of the change of exposure, grey levels.
const EXPOSURE_SIGMA: f64 = 10.0;
/// So many points count as one: their errors, of calibration, shutter and texture, are those of their neighbours as well.
const ALIKE: f64 = 10.0;
/// Noise of luma, grey levels.
const LUMA_SIGMA: f32 = 6.0;
/// Squared normalised residual at which a point has a quarter of its weight (Geman-McClure): the 99 % quantile.
const SCALE: f32 = 6.6;
/// Depth difference, relative to depth, from which a pixel shows another surface.
const OTHER_SURFACE: f32 = 0.05;
/// Points nearer than this, metres, are not compared.
const MIN_Z: f32 = 0.1;

/// What is compared.
pub(crate) struct Alignment<'a> {
    pub(crate) camera: &'a Pinhole,
    pub(crate) noise: &'a DepthNoise,
    pub(crate) frame: &'a ViewFrame,
    /// The model in the view of the frame before.
    pub(crate) points: &'a [ModelPoint],
    /// Uncertainty of a point's place in the frame, working pixels.
    pub(crate) pixel_sigma: f32,
    /// Pixels by which depth may be displaced against colour.
    pub(crate) shift: f32,
}

/// Where the frame should show a point.
struct Place {
    /// In the frame's camera frame, metres.
    point: [f32; 3],
    /// The nearest pixel, …
    pixel: usize,
    /// … how far from it, pixels, …
    offset: [f32; 2],
    /// … and those left, right, above and below.
    around: [usize; 4],
}

impl Place {
    /// Value there of an image, and its slope per pixel.
    fn interpolate(&self, image: impl Fn(usize) -> f32) -> (f32, [f32; 2]) {
        let [left, right, above, below] = self.around.map(&image);
        let slope = [(right - left) / 2.0, (below - above) / 2.0];
        (image(self.pixel) + slope[0] * self.offset[0] + slope[1] * self.offset[1], slope)
    }
}

/// Left and right side of the normal equations.
type Normal = (SMatrix<f64, UNKNOWNS, UNKNOWNS>, SVector<f64, UNKNOWNS>);

impl Alignment<'_> {
    /// The motion from the frame before to this one, corrected by the model. Pixels of this frame for which `moves` holds are known movers.
    #[allow(non_snake_case)]
    pub(crate) fn correct(&self, T_current_previous: &Pose, moves: impl Fn(usize) -> bool) -> Pose {
        // An odd step: not the same columns of each row.
        let sampled = self.points.iter().step_by((self.points.len() / SAMPLE) | 1);
        let sample: Vec<&ModelPoint> = sampled.filter(|p| p.is_believed()).collect();
        let (mut corrected, mut exposure) = (*T_current_previous, 0.0);
        for _ in 0..STEPS {
            let departure = pose::log(&(corrected * T_current_previous.inverse()));
            let (hessian, gradient) = self.equations(&sample, (&corrected, exposure), &departure, &moves);
            let Some(delta) = hessian.cholesky().map(|c| -c.solve(&gradient)) else { return *T_current_previous };
            corrected = pose::exp(&Vector6::from(delta.fixed_rows::<6>(0))) * corrected;
            exposure += delta[6];
        }
        if pose::is_finite(&corrected) { corrected } else { *T_current_previous }
    }

    fn equations(
        &self,
        sample: &[&ModelPoint],
        (pose, exposure): (&Pose, f64),
        departure: &Vector6<f64>,
        moves: &impl Fn(usize) -> bool,
    ) -> Normal {
        let motion = Motion::from(pose);
        let mut normal = (SMatrix::zeros(), SVector::zeros());
        for point in sample {
            let q = motion.apply(point.position);
            if q[2] < MIN_Z {
                continue;
            }
            let place = self.place(q).filter(|p| !moves(p.pixel) && self.shows(p.pixel, q[2]));
            if let Some(place) = place {
                self.add_depth(&mut normal, &place);
                self.add_luma(&mut normal, &place, point.gray + exposure as f32);
            }
        }
        let (hessian, gradient) = &mut normal;
        *hessian /= ALIKE;
        *gradient /= ALIKE;
        for k in 0..6 {
            let information = (if k < 3 { TRANSLATION_SIGMA } else { ROTATION_SIGMA }).powi(-2);
            hessian[(k, k)] += information;
            gradient[k] += information * departure[k];
        }
        hessian[(6, 6)] += EXPOSURE_SIGMA.powi(-2);
        gradient[6] += EXPOSURE_SIGMA.powi(-2) * exposure;
        normal
    }

    /// Whether pixel `i` may show a point at depth `z`, and not something before or behind it.
    fn shows(&self, i: usize, z: f32) -> bool {
        let measured = self.frame.depth.pixels()[i];
        measured <= 0.0 || (measured - z).abs() < OTHER_SURFACE * z
    }

    fn add_depth(&self, normal: &mut Normal, place: &Place) {
        let depth = self.frame.depth.pixels();
        let limit = MAX_SLOPE * depth[place.pixel];
        if place.around.iter().any(|&j| depth[j] <= 0.0 || (depth[j] - depth[place.pixel]).abs() > limit) {
            return;
        }
        let (value, slope) = place.interpolate(|j| depth[j]);
        let z = place.point[2];
        let sigma = self.noise.difference_sigma(z) + (self.pixel_sigma + self.shift) * length(slope);
        let by_motion = self.derivative(slope, [0.0, 0.0, -1.0], place.point);
        add(normal, (value - z) / sigma, by_motion.map(|d| d / sigma), 0.0);
    }

    fn add_luma(&self, normal: &mut Normal, place: &Place, expected: f32) {
        let gray = self.frame.gray.pixels();
        let (value, slope) = place.interpolate(|j| f32::from(gray[j]));
        let sigma = length([LUMA_SIGMA, self.pixel_sigma * length(slope)]);
        let by_motion = self.derivative(slope, [0.0; 3], place.point);
        add(normal, (value - expected) / sigma, by_motion.map(|d| d / sigma), -1.0 / sigma);
    }

    /// Where the frame should show a point in its camera frame, unless that is at the border.
    fn place(&self, point: [f32; 3]) -> Option<Place> {
        let Pinhole { width, height, .. } = *self.camera;
        let [x, y] = self.camera.project(point);
        let pixel = self.camera.nearest([x, y])?;
        let [Some(left), Some(right), Some(above), Some(below)] = neighbours((width, height), pixel) else {
            return None;
        };
        let offset = [x - (pixel % width) as f32, y - (pixel / width) as f32];
        Some(Place { point, pixel, offset, around: [left, right, above, below] })
    }

    /// Derivative of an image value at the projection of `q`, plus `along` · `q`, by a left perturbation (translation first) of the
    /// motion; `slope` is that of the image per pixel.
    fn derivative(&self, slope: [f32; 2], along: [f32; 3], [x, y, z]: [f32; 3]) -> [f32; 6] {
        let (a, b) = (slope[0] * self.camera.fx / z, slope[1] * self.camera.fy / z);
        let g = [along[0] + a, along[1] + b, along[2] - (a * x + b * y) / z];
        [g[0], g[1], g[2], y * g[2] - z * g[1], z * g[0] - x * g[2], x * g[1] - y * g[0]]
    }
}

/// `f32::hypot` without its care for overflow: a fraction of the time.
fn length([x, y]: [f32; 2]) -> f32 {
    (x * x + y * y).sqrt()
}

/// Adds a normalised residual with its derivatives by the motion and by exposure.
fn add((hessian, gradient): &mut Normal, residual: f32, by_motion: [f32; 6], by_exposure: f32) {
    let share = SCALE / (SCALE + residual * residual);
    let weight = f64::from(share * share);
    let [a, b, c, d, e, f] = by_motion.map(f64::from);
    let j = SVector::<f64, UNKNOWNS>::from([a, b, c, d, e, f, f64::from(by_exposure)]);
    hessian.ger(weight, &j, &j, 1.0);
    gradient.axpy(weight * f64::from(residual), &j, 1.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 131.0, fy: 131.0, cx: 79.5, cy: 59.5 };

    /// A wall that leans to the right behind a box, both with texture, from a camera at `T_camera_world`: depth and luma of the pixel whose
    /// ray is given.
    #[allow(non_snake_case)]
    fn look(T_world_camera: &Pose, [x, y]: [f32; 2]) -> (f32, f32) {
        let centre = T_world_camera.translation.vector;
        let ray = T_world_camera.rotation * nalgebra::Vector3::new(f64::from(x), f64::from(y), 1.0);
        let wall = (2.0 + 0.3 * centre.x - centre.z) / (ray.z - 0.3 * ray.x);
        let front = (1.4 - centre.z) / ray.z;
        let on_box = centre + ray * front;
        let z = if on_box.x.abs() < 0.3 && on_box.y.abs() < 0.25 { front } else { wall };
        let p = centre + ray * z;
        let luma = 120.0 + 40.0 * (9.0 * p.x).sin() * (7.0 * p.y + 2.0 * p.x).cos() + 20.0 * (17.0 * p.y).sin();
        (z as f32, luma as f32)
    }

    #[allow(non_snake_case)]
    fn view(T_world_camera: &Pose, brighter: f32) -> ViewFrame {
        let seen: Vec<_> = (0..CAMERA.pixels()).map(|i| look(T_world_camera, CAMERA.ray(i))).collect();
        let (mut gray, mut depth) = (Image::filled(160, 120, 0_u8), Image::filled(160, 120, 0.0_f32));
        for ((g, d), (z, luma)) in gray.pixels_mut().iter_mut().zip(depth.pixels_mut()).zip(seen) {
            (*g, *d) = ((luma + brighter).round() as u8, z);
        }
        ViewFrame { gray, depth }
    }

    fn model(frame: &ViewFrame) -> Vec<ModelPoint> {
        let point = |i: usize| {
            let z = frame.depth.pixels()[i];
            let position = CAMERA.unproject((i % CAMERA.width) as f32, (i / CAMERA.width) as f32, z);
            ModelPoint { position, gray: f32::from(frame.gray.pixels()[i]), hits: 20.0 }
        };
        (0..CAMERA.pixels()).map(point).collect()
    }

    /// Error of the corrected motion beside that of the given one, which is off by `error`.
    fn remaining(error: &Vector6<f64>, change: impl Fn(&mut ViewFrame), moves: impl Fn(usize) -> bool) -> f64 {
        let truth = pose::exp(&Vector6::new(0.01, -0.02, 0.015, 0.01, -0.008, 0.02));
        let points = model(&view(&Pose::identity(), 0.0));
        let mut frame = view(&truth.inverse(), 12.0);
        change(&mut frame);
        let alignment = Alignment {
            camera: &CAMERA,
            noise: &DepthNoise::default(),
            frame: &frame,
            points: &points,
            pixel_sigma: 0.35,
            shift: 0.0,
        };
        let corrected = alignment.correct(&(pose::exp(error) * truth), moves);
        pose::log(&(corrected * truth.inverse())).norm() / error.norm()
    }

    #[test]
    fn depth_and_luma_correct_more_than_half_in_one_frame() {
        for error in [
            Vector6::new(0.004, 0.0, 0.0, 0.0, 0.0, 0.0),
            Vector6::new(0.0, 0.003, -0.005, 0.0, 0.0, 0.0),
            Vector6::new(0.0, 0.0, 0.0, 0.002, -0.003, 0.004),
            Vector6::new(-0.003, 0.002, 0.003, 0.001, 0.002, -0.002),
        ] {
            let left = remaining(&error, |_| {}, |_| false);
            assert!(left < 0.5, "{left} of {error}");
        }
    }

    #[test]
    fn what_moves_does_not_take_it_along() {
        let error = Vector6::new(0.003, -0.002, 0.002, 0.001, 0.001, 0.0);
        // Somebody comes in before a third of the view.
        let come_in = |frame: &mut ViewFrame| {
            for i in (0..CAMERA.pixels()).filter(|i| i % CAMERA.width < 50) {
                frame.depth.pixels_mut()[i] = 1.1;
                frame.gray.pixels_mut()[i] = (60 + (i % 7) * 20) as u8;
            }
        };
        let unknown = remaining(&error, come_in, |_| false);
        assert!(unknown < 0.5, "nobody knows it yet: {unknown}");
        assert!(remaining(&error, come_in, |i| i % CAMERA.width < 50) < 0.5);
    }

    #[test]
    fn where_nothing_can_be_compared_the_motion_stays() {
        let error = Vector6::new(0.003, 0.0, 0.0, 0.0, 0.0, 0.001);
        let blind = |frame: &mut ViewFrame| {
            frame.depth.pixels_mut().fill(0.0);
            frame.gray.pixels_mut().fill(100);
        };
        assert!((remaining(&error, blind, |_| false) - 1.0).abs() < 1e-6);
        assert!((remaining(&error, |_| {}, |_| true) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn derivatives_are_those_of_projection() {
        let frame = ViewFrame::default();
        let alignment = Alignment {
            camera: &CAMERA,
            noise: &DepthNoise::default(),
            frame: &frame,
            points: &[],
            pixel_sigma: 0.35,
            shift: 0.0,
        };
        let (slope, along, q) = ([3.0_f32, -2.0], [0.1_f32, 0.2, -1.0], [0.2_f32, -0.3, 1.5]);
        let value = |q: [f32; 3]| {
            let p = CAMERA.project(q);
            let image = slope[0] * p[0] + slope[1] * p[1];
            f64::from(image) + q.iter().zip(along).map(|(x, a)| f64::from(x * a)).sum::<f64>()
        };
        let found = alignment.derivative(slope, along, q);
        for (k, by) in found.into_iter().enumerate() {
            let moved = |step: f64| {
                let mut twist = Vector6::zeros();
                twist[k] = step;
                value(Motion::from(&pose::exp(&twist)).apply(q))
            };
            let numeric = (moved(1e-3) - moved(-1e-3)) / 2e-3;
            assert!((numeric - f64::from(by)).abs() < 0.5, "{k}: {numeric} and {by}");
        }
    }
}
