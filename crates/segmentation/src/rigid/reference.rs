//! Past frames to compare with, and how current pixels map into them.

use nalgebra::Matrix3;
use pfd_geometry::{GrayImage, Image, Pose};
use pfd_vision::VisionError;
use pfd_vision::warp::box_mean;

use super::view::{Motion, OUTSIDE, Pinhole, ViewFrame, along};

/// Side of the window whose mean is taken off for the texture image, working pixels: shadows and exposure change more slowly
/// over the image than this, texture faster.
const TEXTURE_WINDOW: i32 = 9;

/// Where a current pixel was seen by an earlier frame.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Warp {
    /// By rigid motion and depth.
    Rigid(Motion),
    /// By one homography for all pixels; depth is taken as unchanged.
    Plane([[f32; 3]; 3]),
}

impl Warp {
    /// Position and depth in the other view of the surface on `ray` with depth `z`.
    #[inline]
    pub(crate) fn apply(&self, camera: &Pinhole, ray: [f32; 2], z: f32) -> Option<([f32; 2], f32)> {
        match self {
            Self::Rigid(motion) => {
                let p = motion.apply(along(ray, z));
                (p[2] > 0.0).then(|| (camera.project(p), p[2]))
            }
            Self::Plane(h) => {
                let [u, v] = camera.project([ray[0], ray[1], 1.0]);
                let row = |i: usize| h[i][0] * u + h[i][1] * v + h[i][2];
                let w = row(2);
                (w > f32::EPSILON).then(|| ([row(0) / w, row(1) / w], z))
            }
        }
    }

    /// The pixel of the other view nearest to each surface, given by its ray and depth (metres, 0 = none); [`OUTSIDE`] where there is none.
    pub(crate) fn places(&self, camera: &Pinhole, rays: &[[f32; 2]], depth: &[f32], out: &mut Vec<u32>) {
        out.resize(depth.len(), OUTSIDE);
        let surfaces = rays.iter().zip(depth);
        match self {
            Self::Rigid(motion) => {
                for (out, (&ray, &z)) in out.iter_mut().zip(surfaces) {
                    let p = motion.apply(along(ray, z));
                    let place = camera.nearest_index(camera.project(p));
                    *out = if z > 0.0 && p[2] > 0.0 { place } else { OUTSIDE };
                }
            }
            Self::Plane(_) => {
                for (out, (&ray, &z)) in out.iter_mut().zip(surfaces) {
                    let place = (z > 0.0).then(|| self.apply(camera, ray, z)).flatten();
                    *out = place.map_or(OUTSIDE, |(pixel, _)| camera.nearest_index(pixel));
                }
            }
        }
    }

    /// A homography in single precision.
    pub(crate) fn plane(h: &Matrix3<f64>) -> Self {
        let row = |i: usize| [h[(i, 0)] as f32, h[(i, 1)] as f32, h[(i, 2)] as f32];
        Self::Plane([row(0), row(1), row(2)])
    }
}

/// Camera motion between two frames.
#[derive(Clone, Copy, Debug)]
#[allow(non_snake_case)]
pub(crate) struct FrameMotion {
    /// Current camera coordinates to those of the earlier frame.
    pub(crate) T_earlier_current: Pose,
    /// Current pixels to pixels of the earlier frame, where compensation is by homography.
    pub(crate) homography: Option<Matrix3<f64>>,
}

impl FrameMotion {
    /// No motion.
    pub(crate) fn none(homography: bool) -> Self {
        Self { T_earlier_current: Pose::identity(), homography: homography.then(Matrix3::identity) }
    }

    /// This motion after one more frame.
    pub(crate) fn then(&self, next: &Self) -> Self {
        Self {
            T_earlier_current: self.T_earlier_current * next.T_earlier_current,
            homography: self.homography.zip(next.homography).map(|(a, b)| a * b),
        }
    }

    /// The warp of current pixels into the earlier frame.
    pub(crate) fn warp(&self) -> Warp {
        self.homography.map_or_else(|| Warp::Rigid(Motion::from(&self.T_earlier_current)), |h| Warp::plane(&h))
    }
}

/// What a frame offers for comparison.
#[derive(Clone, Debug, Default)]
pub(crate) struct Appearance {
    /// Luma without its local mean (or luma itself where shadows are to count as motion).
    pub(crate) texture: Image<f32>,
    /// Luma.
    pub(crate) gray: GrayImage,
    /// Nearest depth in the 5×5 neighbourhood; 0 where the pixel itself has none.
    pub(crate) near: Image<f32>,
    /// Farthest depth there.
    pub(crate) far: Image<f32>,
    /// 255 where something moved: no texture to compare with.
    pub(crate) mask: Vec<u8>,
}

impl Appearance {
    /// Derives everything from a frame, reusing the buffers.
    pub(crate) fn update(
        &mut self,
        frame: &ViewFrame,
        remove_mean: bool,
        spare: &mut RangeBuffers,
    ) -> Result<(), VisionError> {
        let (width, height) = frame.gray.size();
        if self.texture.size() != (width, height) {
            self.texture = Image::filled(width, height, 0.0);
            self.near = self.texture.clone();
            self.far = self.texture.clone();
        }
        if remove_mean {
            box_mean(&frame.gray, TEXTURE_WINDOW, &mut self.texture)?;
            for (t, &g) in self.texture.pixels_mut().iter_mut().zip(frame.gray.pixels()) {
                *t = f32::from(g) - *t;
            }
        } else {
            for (t, &g) in self.texture.pixels_mut().iter_mut().zip(frame.gray.pixels()) {
                *t = f32::from(g);
            }
        }
        self.gray.clone_from(&frame.gray);
        depth_range(width, frame.depth.pixels(), spare, self.near.pixels_mut(), self.far.pixels_mut());
        Ok(())
    }
}

/// A past frame.
#[derive(Clone, Debug)]
pub(crate) struct Reference {
    /// Seconds since some fixed instant.
    pub(crate) time: f64,
    /// Motion from then to now.
    pub(crate) motion: FrameMotion,
    /// Image motion when it was taken, pixels per frame.
    pub(crate) flow: f32,
    /// What it looked like.
    pub(crate) appearance: Appearance,
}

/// Buffers of [`depth_range`].
#[derive(Debug, Default)]
pub(crate) struct RangeBuffers {
    /// A row with a margin that changes no minimum or maximum.
    row: Vec<f32>,
    /// Nearest and farthest depth among the neighbours within the row.
    low: Vec<f32>,
    high: Vec<f32>,
}

/// Nearest and farthest depth of each 5×5 neighbourhood, ignoring missing depth; both 0 where the centre has none.
///
/// Two pixels are what registration of depth to colour, rolling shutter and the sensor's ragged edges move an edge by.
pub(crate) fn depth_range(
    width: usize,
    depth: &[f32],
    RangeBuffers { row, low, high }: &mut RangeBuffers,
    near: &mut [f32],
    far: &mut [f32],
) {
    let or_infinite = |z: f32| if z > 0.0 { z } else { f32::INFINITY };
    spread_rows(width, depth, (or_infinite, f32::INFINITY), smaller, (row, low));
    spread_rows(width, depth, (|z| z, 0.0), larger, (row, high));
    spread_columns(width, depth, low, smaller, near);
    spread_columns(width, depth, high, larger, far);
}

/// Side of the neighbourhood.
const RANGE: usize = 2 * RANGE_RADIUS + 1;

/// Combines each value with its neighbours in the row, after `value` was applied to all; beyond the ends of rows there is `neutral`.
fn spread_rows(
    width: usize,
    depth: &[f32],
    (value, neutral): (impl Fn(f32) -> f32, f32),
    combine: impl Fn(f32, f32) -> f32,
    (row, out): (&mut Vec<f32>, &mut Vec<f32>),
) {
    row.clear();
    row.resize(width + 2 * RANGE_RADIUS, neutral);
    out.resize(depth.len(), 0.0);
    for (out, depth) in out.chunks_exact_mut(width.max(1)).zip(depth.chunks_exact(width.max(1))) {
        row[RANGE_RADIUS..].iter_mut().zip(depth).for_each(|(to, &z)| *to = value(z));
        combine_rows(std::array::from_fn(|shift| &row[shift..shift + width]), &combine, out);
    }
}

/// Combines each value with its neighbours in the column; 0 where `depth` is 0.
fn spread_columns(width: usize, depth: &[f32], values: &[f32], combine: impl Fn(f32, f32) -> f32, out: &mut [f32]) {
    let row = |v: usize| v * width..(v + 1) * width;
    let height = depth.len() / width.max(1);
    for v in 0..height {
        // Beside the first and last rows some count twice, which changes no minimum or maximum.
        let near = |k: usize| (v + k).saturating_sub(RANGE_RADIUS).min(height - 1);
        let out = &mut out[row(v)];
        combine_rows(std::array::from_fn(|k| &values[row(near(k))]), &combine, out);
        out.iter_mut().zip(&depth[row(v)]).for_each(|(out, &z)| *out = if z > 0.0 { *out } else { 0.0 });
    }
}

/// Combines rows of equal length value by value.
fn combine_rows([a, b, c, d, e]: [&[f32]; RANGE], combine: impl Fn(f32, f32) -> f32, out: &mut [f32]) {
    for (((((out, &a), &b), &c), &d), &e) in out.iter_mut().zip(a).zip(b).zip(c).zip(d).zip(e) {
        *out = combine(combine(combine(a, b), combine(c, d)), e);
    }
}

/// `f32::min` for numbers, without its care for NaN: one instruction.
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `f32::max` in the same way.
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Half the side of the neighbourhood, working pixels.
pub(crate) const RANGE_RADIUS: usize = 2;

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::pose;

    #[test]
    fn range_of_a_small_image() {
        // 4×2 pixels, one without depth.
        let depth = [1.0, 2.0, 5.0, 6.0, 0.0, 3.0, 4.0, 4.0];
        let (mut near, mut far) = ([9.0; 8], [9.0; 8]);
        depth_range(4, &depth, &mut RangeBuffers::default(), &mut near, &mut far);
        assert_eq!(near, [1.0, 1.0, 1.0, 2.0, 0.0, 1.0, 1.0, 2.0]);
        assert_eq!(far, [5.0, 6.0, 6.0, 6.0, 0.0, 6.0, 6.0, 6.0]);
    }

    #[test]
    fn range_of_each_neighbourhood() {
        let (width, height) = (9, 8);
        let depth: Vec<f32> = (0..width * height).map(|i| (i * 29 % 31) as f32 * 0.1).collect();
        let (mut near, mut far) = (vec![9.0; depth.len()], vec![9.0; depth.len()]);
        depth_range(width, &depth, &mut RangeBuffers::default(), &mut near, &mut far);
        for (i, &z) in depth.iter().enumerate() {
            let around = |j: &usize| (j % width).abs_diff(i % width) <= 2 && (j / width).abs_diff(i / width) <= 2;
            let seen = || (0..depth.len()).filter(around).map(|j| depth[j]).filter(|z| *z > 0.0);
            let expected = if z > 0.0 { [seen().fold(9.0, f32::min), seen().fold(0.0, f32::max)] } else { [0.0; 2] };
            assert_eq!([near[i], far[i]], expected, "{i}");
        }
    }

    #[test]
    fn places_of_many_surfaces_are_those_of_each() {
        let camera = Pinhole { width: 32, height: 24, fx: 26.0, fy: 26.0, cx: 15.5, cy: 11.5 };
        let rays: Vec<_> = (0..camera.pixels()).map(|i| camera.ray(i)).collect();
        let depth: Vec<f32> = (0..camera.pixels()).map(|i| (i * 7 % 11) as f32 * 0.4).collect();
        // So far back that the nearest surfaces are behind the other camera.
        let motion = Motion::from(&pose::exp(&nalgebra::Vector6::new(0.01, 0.02, -0.5, 0.02, -0.1, 0.2)));
        let h = Matrix3::new(1.0, 0.1, 4.0, 0.0, 0.9, -2.0, 0.0, 0.01, 0.8);
        for warp in [Warp::Rigid(motion), Warp::plane(&h)] {
            let mut places = Vec::new();
            warp.places(&camera, &rays, &depth, &mut places);
            let place = |i: usize| {
                let (pixel, _) = (depth[i] > 0.0).then(|| warp.apply(&camera, rays[i], depth[i])).flatten()?;
                camera.nearest(pixel)
            };
            let expected: Vec<u32> = (0..depth.len()).map(|i| place(i).map_or(OUTSIDE, |i| i as u32)).collect();
            assert_eq!(places, expected);
            let inside = expected.iter().filter(|place| **place != OUTSIDE).count();
            assert!((100..depth.len() - 100).contains(&inside), "{inside}");
        }
    }

    #[test]
    fn a_homography_maps_pixels_and_keeps_depth() {
        let h = Matrix3::new(1.0, 0.0, 4.0, 0.0, 1.0, -2.0, 0.0, 0.0, 1.0);
        let camera = Pinhole { width: 32, height: 24, fx: 26.0, fy: 26.0, cx: 15.5, cy: 11.5 };
        let (p, z) = Warp::plane(&h).apply(&camera, camera.ray(10 * 32 + 10), 1.5).unwrap();
        assert!((p[0] - 14.0).abs() < 1e-4 && (p[1] - 8.0).abs() < 1e-4 && z == 1.5);
    }
}
