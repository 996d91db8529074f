//! The working view: an ideal pinhole camera at reduced resolution, without lens distortion.
//!
//! Warps between frames are then a rotation, a translation and a division, and every image is small enough to visit a few
//! dozen times per frame.

use nalgebra::{Point2, Point3};
use pfd_geometry::{Camera, GrayImage, Image, Mask, Pose, RgbImage, RgbdFrame};

/// Columns the working view aims at; 640 columns become 320.
const TARGET_WIDTH: f64 = 320.0;
/// Index that stands for "outside the other image".
pub(crate) const OUTSIDE: u32 = u32::MAX;

/// An ideal pinhole camera in single precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pinhole {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) fx: f32,
    pub(crate) fy: f32,
    pub(crate) cx: f32,
    pub(crate) cy: f32,
}

impl Pinhole {
    /// The point (metres) seen at pixel `(u, v)` with depth `z`.
    pub(crate) fn unproject(&self, u: f32, v: f32, z: f32) -> [f32; 3] {
        [(u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z]
    }

    /// The point (metres) that pixel `index` shows at depth `z`.
    pub(crate) fn point(&self, index: usize, z: f32) -> [f32; 3] {
        self.unproject((index % self.width) as f32, (index / self.width) as f32, z)
    }

    /// Ray `(x, y, 1)` through pixel `index`.
    pub(crate) fn ray(&self, index: usize) -> [f32; 2] {
        let [x, y, _] = self.unproject((index % self.width) as f32, (index / self.width) as f32, 1.0);
        [x, y]
    }

    /// Pixel of a point in front of the camera.
    #[inline]
    pub(crate) fn project(&self, p: [f32; 3]) -> [f32; 2] {
        let inverse = 1.0 / p[2];
        [self.fx * p[0] * inverse + self.cx, self.fy * p[1] * inverse + self.cy]
    }

    /// Image motion, pixels, of what pixel `index` shows at depth `z` when the camera moves by `motion`; `None` without depth.
    pub(crate) fn displacement(&self, motion: &Motion, index: usize, z: f32) -> Option<[f32; 2]> {
        let moved = (z > 0.0).then(|| motion.apply(self.point(index, z))).filter(|p| p[2] > 0.0)?;
        let [x, y] = self.project(moved);
        Some([x - (index % self.width) as f32, y - (index / self.width) as f32])
    }

    /// Index of the pixel nearest to `(u, v)`, if inside.
    #[inline]
    pub(crate) fn nearest(&self, pixel: [f32; 2]) -> Option<usize> {
        let index = self.nearest_index(pixel);
        (index != OUTSIDE).then_some(index as usize)
    }

    /// The same, [`OUTSIDE`] if not inside. Has no branch on the way to the index, so that several can be computed at once.
    #[inline]
    pub(crate) fn nearest_index(&self, [u, v]: [f32; 2]) -> u32 {
        let (u, v) = (u + 0.5, v + 0.5);
        let inside = u >= 0.0 && v >= 0.0 && u < self.width as f32 && v < self.height as f32;
        let index = (v as i32).wrapping_mul(self.width as i32).wrapping_add(u as i32);
        if inside { index as u32 } else { OUTSIDE }
    }

    /// Number of pixels.
    pub(crate) fn pixels(&self) -> usize {
        self.width * self.height
    }
}

/// The point (metres) on a ray `(x, y, 1)` at depth `z`.
#[inline]
pub(crate) fn along([x, y]: [f32; 2], z: f32) -> [f32; 3] {
    [x * z, y * z, z]
}

/// The whole part of a coordinate that is not negative. By way of `i32`, which takes a third of the instructions of a cast to `usize`.
#[inline]
pub(crate) fn floor(x: f32) -> usize {
    x as i32 as usize
}

/// A rigid motion in single precision, as a matrix.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    rotation: [[f32; 3]; 3],
    translation: [f32; 3],
}

impl From<&Pose> for Motion {
    fn from(pose: &Pose) -> Self {
        let r = pose.rotation.to_rotation_matrix().into_inner();
        let t = &pose.translation.vector;
        let row = |i: usize| [r[(i, 0)] as f32, r[(i, 1)] as f32, r[(i, 2)] as f32];
        Self { rotation: [row(0), row(1), row(2)], translation: [t.x as f32, t.y as f32, t.z as f32] }
    }
}

impl Motion {
    /// The point after the motion.
    #[inline]
    pub(crate) fn apply(&self, p: [f32; 3]) -> [f32; 3] {
        let row = |i: usize| {
            let r = &self.rotation[i];
            r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + self.translation[i]
        };
        [row(0), row(1), row(2)]
    }
}

/// Maps between camera images and the working view.
#[derive(Debug)]
pub(crate) struct View {
    pub(crate) camera: Pinhole,
    /// Camera pixel under each working pixel (position between pixels).
    source: Vec<[f32; 2]>,
    /// What each working pixel is interpolated from; outside of the camera image the nearest pixel of its border.
    corners: Vec<Corner>,
    /// Where one of those is not the mean of all that a working pixel covers: what makes that mean, [`taps`] squared for each.
    grid: Vec<Corner>,
    /// Whether a working pixel lies within the camera image. A lens that distorts leaves some at the border that do not.
    pub(crate) inside: Vec<bool>,
    /// Working pixel under each camera pixel.
    target: Vec<u32>,
    source_size: (usize, usize),
    /// Ray `(x, y, 1)` through each working pixel.
    pub(crate) rays: Vec<[f32; 2]>,
}

/// One frame in the working view.
#[derive(Clone, Debug, Default)]
pub(crate) struct ViewFrame {
    /// Luma.
    pub(crate) gray: GrayImage,
    /// Metres; 0 = none.
    pub(crate) depth: Image<f32>,
}

impl View {
    pub(crate) fn new(camera: &Camera) -> Self {
        let factor = (camera.width as f64 / TARGET_WIDTH).round().max(1.0);
        let pinhole = enclosing_pinhole(camera, factor);
        let source: Vec<_> = (0..pinhole.pixels()).map(|i| source_pixel(camera, &pinhole, i)).collect();
        let size = (camera.width, camera.height);
        let corners = source.iter().map(|&p| Corner::at(p, size)).collect();
        let grid = match taps(factor) {
            1 => Vec::new(),
            count => source.iter().flat_map(|&p| spread(p, factor, count)).map(|p| Corner::at(p, size)).collect(),
        };
        let inside = source.iter().map(|&p| is_inside(p, size)).collect();
        let target = (0..camera.width * camera.height).map(|i| target_pixel(camera, &pinhole, i)).collect();
        let rays = (0..pinhole.pixels()).map(|i| pinhole.ray(i)).collect();
        Self { camera: pinhole, source, corners, grid, inside, target, source_size: size, rays }
    }

    /// Resamples a frame: luma by the mean of what a pixel covers, depth by the nearest measurement. Outside of the camera image luma goes
    /// on as at its border, so that there is no edge, and depth is missing.
    pub(crate) fn resample(&self, frame: &RgbdFrame, out: &mut ViewFrame) {
        let (width, height) = (self.camera.width, self.camera.height);
        if out.gray.size() != (width, height) {
            out.gray = Image::filled(width, height, 0);
            out.depth = Image::filled(width, height, 0.0);
        }
        let (gray, depth) = (frame.gray(), frame.depth().image());
        let targets = out.gray.pixels_mut().iter_mut().zip(out.depth.pixels_mut());
        for ((g, d), (corner, &inside)) in targets.zip(self.corners.iter().zip(&self.inside)) {
            if self.grid.is_empty() {
                *g = corner.interpolate(|i| gray.pixels()[i]);
            }
            *d = if inside { corner.nearest_valid(depth.pixels()) } else { 0.0 };
        }
        if !self.grid.is_empty() {
            self.average(gray.pixels(), out.gray.pixels_mut());
        }
    }

    /// The luma of large images, of which a single interpolation would pass over most pixels, and keep the noise of the others.
    fn average(&self, gray: &[u8], out: &mut [u8]) {
        let per_pixel = self.grid.len() / out.len().max(1);
        for (g, corners) in out.iter_mut().zip(self.grid.chunks_exact(per_pixel.max(1))) {
            let sum: u32 = corners.iter().map(|corner| u32::from(corner.interpolate(|i| gray[i]))).sum();
            *g = ((sum + per_pixel as u32 / 2) / per_pixel as u32) as u8;
        }
    }

    /// Raises a mask in the working view to the resolution of the camera, which is that of `out`.
    pub(crate) fn enlarge(&self, small: &[u8], out: &mut Mask) {
        out.assign(self.target.iter().map(|&i| small.get(i as usize).is_some_and(|&m| m != Mask::STATIC)));
    }

    /// Colour of working pixel `index`, the mean of what it covers: red, green, blue.
    pub(crate) fn colour(&self, rgb: &RgbImage, index: usize) -> [u8; 3] {
        let pixels = rgb.pixels();
        let covered = self.covered(index);
        let count = covered.len() as u32;
        let mut sums = [0; 3];
        for corner in covered {
            for (sum, value) in sums.iter_mut().zip(corner.interpolate_colour(|i| pixels[i])) {
                *sum += u32::from(value);
            }
        }
        sums.map(|sum| ((sum + count / 2) / count) as u8)
    }

    /// What makes the mean of all that working pixel `index` covers.
    fn covered(&self, index: usize) -> &[Corner] {
        let per_pixel = self.grid.len() / self.corners.len();
        if per_pixel == 0 {
            std::slice::from_ref(&self.corners[index])
        } else {
            &self.grid[index * per_pixel..][..per_pixel]
        }
    }

    /// Camera pixel under working pixel `index`.
    pub(crate) fn to_camera(&self, index: usize) -> [f32; 2] {
        self.source[index]
    }

    /// Working pixel under a camera pixel.
    pub(crate) fn to_working(&self, x: f32, y: f32) -> Option<usize> {
        let (width, height) = self.source_size;
        let inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
        let index = inside.then(|| self.target[y as usize * width + x as usize])?;
        (index != OUTSIDE).then_some(index as usize)
    }

    /// Whether working pixel `index` lies less than `margin` working pixels from the border of the camera image.
    pub(crate) fn is_at_border(&self, index: usize, margin: f32) -> bool {
        let margin = margin * self.scale();
        let near = |p: f32, size: usize| p < margin || p > (size - 1) as f32 - margin;
        let [x, y] = self.to_camera(index);
        near(x, self.source_size.0) || near(y, self.source_size.1)
    }

    /// Camera pixels per working pixel.
    pub(crate) fn scale(&self) -> f32 {
        self.source_size.0 as f32 / self.camera.width as f32
    }

    /// Size of the camera's images.
    pub(crate) fn source_size(&self) -> (usize, usize) {
        self.source_size
    }
}

/// Interpolations per axis that cover `factor` pixels: each is a mean of two.
fn taps(factor: f64) -> usize {
    (factor / 2.0).ceil() as usize
}

/// `count` by `count` positions, evenly spread over the `factor` pixels around one.
fn spread([x, y]: [f32; 2], factor: f64, count: usize) -> impl Iterator<Item = [f32; 2]> {
    let offset = move |k: usize| ((k as f64 - (count as f64 - 1.0) / 2.0) * factor / count as f64) as f32;
    (0..count * count).map(move |k| [x + offset(k % count), y + offset(k / count)])
}

/// The four camera pixels around a position.
#[derive(Clone, Copy, Debug)]
struct Corner {
    /// Of the upper left one.
    index: u32,
    /// From there to the right one, …
    right: u32,
    /// … and to the lower one; 0 at the border of the image.
    down: u32,
    fraction: [f32; 2],
}

impl Corner {
    /// That of the position, or of the nearest one in an image of this size.
    fn at([x, y]: [f32; 2], (width, height): (usize, usize)) -> Self {
        let (x, y) = (x.clamp(0.0, width as f32 - 1.0), y.clamp(0.0, height as f32 - 1.0));
        let (u, v) = (x as usize, y as usize);
        Self {
            index: (v * width + u) as u32,
            right: u32::from(u + 1 < width),
            down: if v + 1 < height { width as u32 } else { 0 },
            fraction: [x - u as f32, y - v as f32],
        }
    }

    fn indices(&self) -> [usize; 4] {
        let i = self.index;
        [i, i + self.right, i + self.down, i + self.right + self.down].map(|i| i as usize)
    }

    #[inline]
    fn interpolate(&self, value: impl Fn(usize) -> u8) -> u8 {
        self.blend(self.indices().map(value))
    }

    #[inline]
    fn interpolate_colour(&self, value: impl Fn(usize) -> [u8; 3]) -> [u8; 3] {
        let around = self.indices().map(value);
        [0, 1, 2].map(|channel| self.blend(around.map(|colour| colour[channel])))
    }

    #[inline]
    fn blend(&self, around: [u8; 4]) -> u8 {
        let [a, b, c, d] = around.map(f32::from);
        let [x, y] = self.fraction;
        let (top, bottom) = (a + (b - a) * x, c + (d - c) * x);
        (top + (bottom - top) * y + 0.5) as u8
    }

    /// Depth is not interpolated: a mean across an edge is a surface that does not exist.
    fn nearest_valid(&self, depth: &[f32]) -> f32 {
        let [x, y] = self.fraction;
        let nearest = self.index + if x > 0.5 { self.right } else { 0 } + if y > 0.5 { self.down } else { 0 };
        let first = depth[nearest as usize];
        if first > 0.0 {
            return first;
        }
        self.indices().into_iter().map(|i| depth[i]).find(|&z| z > 0.0).unwrap_or(0.0)
    }
}

/// Whether a position lies on a pixel of an image.
fn is_inside([x, y]: [f32; 2], (width, height): (usize, usize)) -> bool {
    x > -0.5 && y > -0.5 && x < width as f32 - 0.5 && y < height as f32 - 0.5
}

/// The pinhole camera at `1 / factor` of the resolution whose image holds the whole camera image.
fn enclosing_pinhole(camera: &Camera, factor: f64) -> Pinhole {
    let (width, height) = (
        (camera.width as f64 / factor).ceil().max(1.0) as usize,
        (camera.height as f64 / factor).ceil().max(1.0) as usize,
    );
    // Pixel centres: camera pixel `factor * u + (factor - 1) / 2` lies under working pixel `u`.
    let shift = (factor - 1.0) / 2.0;
    let ideal = Pinhole {
        width,
        height,
        fx: (camera.fx / factor) as f32,
        fy: (camera.fy / factor) as f32,
        cx: ((camera.cx - shift) / factor) as f32,
        cy: ((camera.cy - shift) / factor) as f32,
    };
    if camera.distortion.is_zero() {
        return ideal;
    }
    let bounds = ray_bounds(camera);
    let (fx, cx) = fit_axis(bounds[0], width);
    let (fy, cy) = fit_axis(bounds[1], height);
    Pinhole { width, height, fx, fy, cx, cy }
}

/// Focal length and principal point that spread rays from `low` to `high` over `size` pixels.
fn fit_axis([low, high]: [f64; 2], size: usize) -> (f32, f32) {
    let focal = (size as f64 - 1.0).max(1.0) / (high - low).max(f64::EPSILON);
    (focal as f32, (-low * focal) as f32)
}

/// Smallest and largest ray slope in x and y along the image border.
fn ray_bounds(camera: &Camera) -> [[f64; 2]; 2] {
    let (right, bottom) = (camera.width as f64 - 1.0, camera.height as f64 - 1.0);
    let columns = (0..camera.width).flat_map(|u| [(u as f64, 0.0), (u as f64, bottom)]);
    let rows = (0..camera.height).flat_map(|v| [(0.0, v as f64), (right, v as f64)]);
    let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for (u, v) in columns.chain(rows) {
        let ray = camera.ray(&Point2::new(u, v));
        for (bound, value) in bounds.iter_mut().zip([ray.x, ray.y]) {
            *bound = [bound[0].min(value), bound[1].max(value)];
        }
    }
    bounds
}

fn source_pixel(camera: &Camera, pinhole: &Pinhole, index: usize) -> [f32; 2] {
    let (u, v) = ((index % pinhole.width) as f32, (index / pinhole.width) as f32);
    let [x, y, z] = pinhole.unproject(u, v, 1.0).map(f64::from);
    camera.project(&Point3::new(x, y, z)).map_or([-1.0; 2], |p| [p.x as f32, p.y as f32])
}

fn target_pixel(camera: &Camera, pinhole: &Pinhole, index: usize) -> u32 {
    let (u, v) = ((index % camera.width) as f64, (index / camera.width) as f64);
    let ray = camera.ray(&Point2::new(u, v));
    let pixel = pinhole.project([ray.x as f32, ray.y as f32, 1.0]);
    pinhole.nearest(pixel).map_or(OUTSIDE, |i| i as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::{DepthImage, Distortion, Stamp};

    fn camera(distortion: [f64; 5]) -> Camera {
        Camera::new((640, 480), [517.3, 516.5, 318.6, 255.3], Distortion(distortion)).unwrap()
    }

    #[test]
    fn noise_is_averaged_whatever_the_size_of_the_image() {
        for (width, height) in [(640, 480), (848, 480), (1280, 720), (1920, 1080)] {
            let focal = 0.9 * width as f64;
            let intrinsics = [focal, focal, (width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0];
            let view = View::new(&Camera::new((width, height), intrinsics, Distortion::default()).unwrap());
            // A chequerboard of single pixels.
            let mut rgb = Image::filled(width, height, [80_u8; 3]);
            for (i, pixel) in rgb.pixels_mut().iter_mut().enumerate() {
                *pixel = if (i % width + i / width) % 2 == 0 { [80; 3] } else { [160; 3] };
            }
            let depth = DepthImage::from_metres(Image::filled(width, height, 2.0));
            let mut out = ViewFrame::default();
            let frame = RgbdFrame::new(Stamp::from_nanos(0), rgb, depth).unwrap();
            view.resample(&frame, &mut out);
            // At the border less than all of a working pixel lies in the image.
            let (columns, rows) = out.gray.size();
            let inner = (1..rows - 1).flat_map(|v| (1..columns - 1).map(move |u| (u, v)));
            let levels: Vec<u8> = inner.map(|at| out.gray[at]).collect();
            assert!(levels.iter().all(|g| (108..133).contains(g)), "{width}: {:?}", &levels[..9]);
            let same = |&(u, v): &(usize, usize)| {
                view.colour(frame.rgb(), v * columns + u).iter().all(|c| c.abs_diff(out.gray[(u, v)]) < 2)
            };
            assert!((1..rows - 1).flat_map(|v| (1..columns - 1).map(move |u| (u, v))).all(|at| same(&at)), "{width}");
        }
    }

    #[test]
    fn every_camera_pixel_has_a_working_pixel_that_leads_back() {
        for distortion in [[0.0; 5], [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]] {
            let view = View::new(&camera(distortion));
            for (i, &t) in view.target.iter().enumerate() {
                assert_ne!(t, OUTSIDE, "pixel {i}");
                let [x, y] = view.source[t as usize];
                let (u, v) = ((i % 640) as f32, (i / 640) as f32);
                assert!((x - u).abs() < 2.5 && (y - v).abs() < 2.5, "{u} {v} → {x} {y}");
            }
        }
    }

    #[test]
    fn the_border_is_that_of_the_camera_image() {
        let view = View::new(&camera([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]));
        let at_border = |x: f32, y: f32| view.is_at_border(view.to_working(x, y).unwrap(), 3.0);
        assert_eq!([at_border(2.0, 240.0), at_border(320.0, 477.0), at_border(637.0, 3.0)], [true; 3]);
        assert_eq!([at_border(12.0, 240.0), at_border(320.0, 240.0), at_border(320.0, 466.0)], [false; 3]);
    }

    #[test]
    fn outside_of_the_camera_image_luma_goes_on_and_nothing_is_measured() {
        let view = View::new(&camera([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]));
        let depth = DepthImage::from_metres(Image::filled(640, 480, 2.0_f32));
        let frame = RgbdFrame::new(Stamp::default(), Image::filled(640, 480, [100_u8; 3]), depth).unwrap();
        let mut small = ViewFrame::default();
        view.resample(&frame, &mut small);
        assert!(small.gray.pixels().iter().all(|&g| g == 100));
        let outside = view.inside.iter().filter(|inside| !**inside).count();
        assert!(outside > 0 && outside < view.camera.pixels() / 20, "{outside}");
        assert!(small.depth.pixels().iter().zip(&view.inside).all(|(&z, &inside)| z == if inside { 2.0 } else { 0.0 }));
    }

    #[test]
    fn resampling_halves_and_keeps_depth_edges() {
        let rgb = Image::filled(640, 480, [100_u8; 3]);
        let mut depth = Image::filled(640, 480, 1.0_f32);
        for v in 0..480 {
            for u in 320..640 {
                depth[(u, v)] = 3.0;
            }
        }
        let frame = RgbdFrame::new(Stamp::default(), rgb, DepthImage::from_metres(depth)).unwrap();
        let view = View::new(&camera([0.0; 5]));
        let mut small = ViewFrame::default();
        view.resample(&frame, &mut small);
        assert_eq!(small.gray.size(), (320, 240));
        assert!(small.gray.pixels().iter().all(|&g| g == 100));
        assert!(small.depth.pixels().iter().all(|&d| d == 1.0 || d == 3.0));
    }
}
