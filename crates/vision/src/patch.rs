//! Small windows around corners, and their alignment to a fraction of a pixel (Lucas and Kanade, IJCAI 1981, in the inverse
//! compositional form of Baker and Matthews, IJCV 2004; for corners: Forster et al., T-RO 2017, section V).

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Side of a patch, pixels of its pyramid level: the compared window, turned or a third larger, and a search around it.
const SIDE: usize = 17;
/// Side of the window that is compared.
const WINDOW: usize = 8;
/// The window with a border for its gradients.
const BORDERED: usize = WINDOW + 2;
/// Iterations at most; most windows need three.
const ITERATIONS: usize = 10;
/// A step smaller than this (pixels) ends the iteration.
const STEP_TOLERANCE: f32 = 0.02;
/// What lies further from the start than this (pixels) is another corner.
const MAX_SHIFT: f32 = 2.5;

/// The grey levels around a corner, on the pyramid level on which it was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Patch {
    pixels: [u8; SIDE * SIDE],
    /// Column and row of the central pixel on its level.
    centre: [i32; 2],
}

/// Where a window was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Position on the level of the patch, pixels.
    pub position: Vector2<f32>,
    /// Correlation of the two windows, -1 to 1.
    pub correlation: f32,
}

impl Patch {
    /// The patch around `centre` of an image with rows of `stride` pixels; `None` where it does not fit in.
    pub fn cut(pixels: &[u8], stride: usize, centre: [i32; 2]) -> Option<Self> {
        let half = (SIDE / 2) as i32;
        let (left, top) = (usize::try_from(centre[0] - half).ok()?, usize::try_from(centre[1] - half).ok()?);
        if left + SIDE > stride || (top + SIDE) * stride > pixels.len() {
            return None;
        }
        let mut patch = Self { pixels: [0; SIDE * SIDE], centre };
        for (row, out) in patch.pixels.chunks_exact_mut(SIDE).enumerate() {
            let start = (top + row) * stride + left;
            out.copy_from_slice(&pixels[start..start + SIDE]);
        }
        Some(patch)
    }

    /// A patch from its parts, as [`Self::centre`] and [`Self::pixels`] give them; `None` when there are too few or too many pixels.
    pub fn from_parts(centre: [i32; 2], pixels: &[u8]) -> Option<Self> {
        Some(Self { pixels: pixels.try_into().ok()?, centre })
    }

    /// Column and row of the central pixel on its level.
    pub fn centre(&self) -> [i32; 2] {
        self.centre
    }

    /// The grey levels, row by row.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Finds the surroundings of `at` in `reference`, deformed by `warp` (pixels of `reference` per pixel here), near `start`.
    /// Positions are in pixels of the patches' levels. `None` where there is no texture, or no agreement nearby.
    pub fn align(
        &self,
        start: Vector2<f32>,
        reference: &Self,
        at: Vector2<f32>,
        warp: &Matrix2<f32>,
    ) -> Option<Alignment> {
        let template = Template::new(reference, at, warp)?;
        let (mut position, mut offset) = (start, 0.0_f32);
        for _ in 0..ITERATIONS {
            let window = self.upright_window(position)?;
            let step = template.step(&window, offset);
            position += step.xy();
            offset += step.z;
            if (position - start).norm() > MAX_SHIFT {
                return None;
            }
            if step.xy().norm() < STEP_TOLERANCE {
                let window = self.upright_window(position)?;
                return Some(Alignment { position, correlation: template.correlation(&window) });
            }
        }
        None
    }

    /// Grey levels of a square of `N`² pixels around `at`, row by row; `None` where it leaves the patch.
    fn window<const N: usize>(&self, at: Vector2<f32>, warp: &Matrix2<f32>) -> Option<[[f32; N]; N]> {
        let origin =
            at - Vector2::new(self.centre[0] as f32, self.centre[1] as f32) + Vector2::from_element((SIDE / 2) as f32);
        let middle = (N as f32 - 1.0) / 2.0;
        let mut out = [[0.0; N]; N];
        for (y, row) in out.iter_mut().enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                *value = self.sample(origin + warp * Vector2::new(x as f32 - middle, y as f32 - middle))?;
            }
        }
        Some(out)
    }

    /// The same for a window that is neither turned nor scaled: all of it lies equally between the pixels.
    fn upright_window(&self, at: Vector2<f32>) -> Option<[[f32; WINDOW]; WINDOW]> {
        // Column and row, in the patch, of the first pixel of a window around its centre.
        const CORNER: f32 = (SIDE / 2) as f32 - (WINDOW as f32 - 1.0) / 2.0;
        const LAST: f32 = (SIDE - WINDOW) as f32;
        let (x, y) = (at.x - self.centre[0] as f32 + CORNER, at.y - self.centre[1] as f32 + CORNER);
        let inside = x >= 0.0 && y >= 0.0 && x < LAST && y < LAST;
        if !inside {
            return None;
        }
        let (u, v) = (x as usize, y as usize);
        let (a, b) = (x - u as f32, y - v as f32);
        let between_columns = |row: usize| -> [f32; WINDOW] {
            let pixels = &self.pixels[row * SIDE + u..][..=WINDOW];
            std::array::from_fn(|i| {
                let [left, right] = [pixels[i], pixels[i + 1]].map(f32::from);
                left + (right - left) * a
            })
        };
        let mut upper = between_columns(v);
        let mut out = [[0.0; WINDOW]; WINDOW];
        for (y, row) in out.iter_mut().enumerate() {
            let lower = between_columns(v + y + 1);
            *row = std::array::from_fn(|i| upper[i] + (lower[i] - upper[i]) * b);
            upper = lower;
        }
        Some(out)
    }

    /// Between four pixels.
    #[inline]
    fn sample(&self, at: Vector2<f32>) -> Option<f32> {
        const LAST: f32 = (SIDE - 1) as f32;
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < LAST && at.y < LAST;
        if !inside {
            return None;
        }
        let (u, v) = (at.x as usize, at.y as usize);
        let (a, b) = (at.x - u as f32, at.y - v as f32);
        let value = |i: usize| f32::from(self.pixels[i]);
        let i = v * SIDE + u;
        let upper = value(i) + (value(i + 1) - value(i)) * a;
        let lower = value(i + SIDE) + (value(i + SIDE + 1) - value(i + SIDE)) * a;
        Some(upper + (lower - upper) * b)
    }
}

/// What is looked for.
struct Template {
    values: [[f32; BORDERED]; BORDERED],
    /// Inverse of the normal matrix of position and brightness.
    inverse: Matrix3<f32>,
}

impl Template {
    fn new(reference: &Patch, at: Vector2<f32>, warp: &Matrix2<f32>) -> Option<Self> {
        let values = reference.window::<BORDERED>(at, warp)?;
        let mut template = Self { values, inverse: Matrix3::zeros() };
        let mut hessian = Matrix3::zeros();
        for y in 0..WINDOW {
            for x in 0..WINDOW {
                let j = template.jacobian(x, y);
                hessian += j * j.transpose();
            }
        }
        template.inverse = hessian.try_inverse()?;
        Some(template)
    }

    /// Derivative of a pixel of the window by position and brightness.
    #[inline]
    fn jacobian(&self, x: usize, y: usize) -> Vector3<f32> {
        let v = &self.values;
        Vector3::new(0.5 * (v[y + 1][x + 2] - v[y + 1][x]), 0.5 * (v[y + 2][x + 1] - v[y][x + 1]), 1.0)
    }

    /// Correction of position and brightness.
    fn step(&self, window: &[[f32; WINDOW]; WINDOW], offset: f32) -> Vector3<f32> {
        let mut gradient = Vector3::zeros();
        for (y, row) in window.iter().enumerate() {
            for (x, value) in row.iter().enumerate() {
                gradient -= self.jacobian(x, y) * (value - self.values[y + 1][x + 1] + offset);
            }
        }
        self.inverse * gradient
    }

    /// Correlation of the window with the inner part of the template.
    fn correlation(&self, window: &[[f32; WINDOW]; WINDOW]) -> f32 {
        let count = (WINDOW * WINDOW) as f32;
        let (mut a, mut b, mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (y, row) in window.iter().enumerate() {
            for (x, &value) in row.iter().enumerate() {
                let expected = self.values[y + 1][x + 1];
                a += value;
                b += expected;
                aa += value * value;
                bb += expected * expected;
                ab += value * expected;
            }
        }
        let spread = (aa - a * a / count) * (bb - b * b / count);
        (ab - a * b / count) / spread.max(f32::EPSILON).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRIDE: usize = 60;

    /// A smooth texture, shifted, turned and brightened.
    fn image(shift: Vector2<f32>, angle: f32, brightness: f32) -> Vec<u8> {
        let rotation = nalgebra::Rotation2::new(angle);
        let value = |u: usize, v: usize| {
            let centre = Vector2::from_element(30.0);
            let p = rotation.inverse() * (Vector2::new(u as f32, v as f32) - centre - shift);
            90.0 + brightness + 40.0 * (p.x * 0.55).sin() + 35.0 * (p.y * 0.45 + p.x * 0.2).cos()
        };
        (0..STRIDE * STRIDE).map(|i| value(i % STRIDE, i / STRIDE).round() as u8).collect()
    }

    fn patch(pixels: &[u8]) -> Patch {
        Patch::cut(pixels, STRIDE, [30, 30]).unwrap()
    }

    #[test]
    fn a_shift_is_found_to_a_twentieth_of_a_pixel_in_other_light() {
        let reference = patch(&image(Vector2::zeros(), 0.0, 0.0));
        for shift in [Vector2::new(0.3, -0.4), Vector2::new(-1.2, 0.7), Vector2::zeros()] {
            let start = Vector2::from_element(30.0);
            let current = patch(&image(shift, 0.0, 20.0));
            let found = current.align(start, &reference, start, &Matrix2::identity()).unwrap();
            assert!((found.position - start - shift).norm() < 0.05, "{shift:?}: {found:?}");
            assert!(found.correlation > 0.99);
        }
    }

    #[test]
    fn an_upright_window_is_a_window_without_a_warp() {
        let patch = patch(&image(Vector2::new(0.2, 0.1), 0.3, 0.0));
        let identity = Matrix2::identity();
        for at in
            [[30.0, 30.0], [28.3, 31.6], [33.9, 26.1], [34.49, 30.0], [34.5, 30.0], [30.0, 25.4], [f32::NAN, 30.0]]
        {
            let at = Vector2::from(at);
            let (upright, any) = (patch.upright_window(at), patch.window::<WINDOW>(at, &identity));
            assert_eq!(upright.is_some(), any.is_some(), "{at:?}");
            let pairs = upright.iter().flatten().flatten().zip(any.iter().flatten().flatten());
            pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-2, "{a} {b} at {at:?}"));
        }
    }

    #[test]
    fn a_turn_is_undone_by_the_warp() {
        let (start, shift, angle) = (Vector2::from_element(30.0), Vector2::new(0.4, 0.2), 0.5);
        let reference = patch(&image(Vector2::zeros(), 0.0, 0.0));
        let current = patch(&image(shift, angle, 0.0));
        let warp = *nalgebra::Rotation2::new(-angle).matrix();
        let found = current.align(start, &reference, start, &warp).unwrap();
        assert!((found.position - start - shift).norm() < 0.06, "{found:?}");
        let unwarped = current.align(start, &reference, start, &Matrix2::identity());
        assert!(unwarped.is_none_or(|u| u.correlation < found.correlation));
    }

    #[test]
    fn what_cannot_be_aligned_is_none() {
        let (start, reference) = (Vector2::from_element(30.0), patch(&image(Vector2::zeros(), 0.0, 0.0)));
        let flat = patch(&[100; STRIDE * STRIDE]);
        assert_eq!(reference.align(start, &flat, start, &Matrix2::identity()), None, "no texture");
        let enlarged = Matrix2::identity() * 4.0;
        assert_eq!(reference.align(start, &reference, start, &enlarged), None, "the patch is too small");
        assert_eq!(Patch::cut(&[0; STRIDE * STRIDE], STRIDE, [5, 30]), None, "the image ends");
        assert_eq!(Patch::cut(&[0; STRIDE * STRIDE], STRIDE, [30, 58]), None);
    }
}
