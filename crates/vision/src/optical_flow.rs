//! Sparse optical flow: pyramidal Lucas-Kanade (Bouguet 2000).

use opencv::core::{Mat, Point2f, Size, TermCriteria, TermCriteria_COUNT, TermCriteria_EPS, Vector};
use opencv::video::{OPTFLOW_USE_INITIAL_FLOW, build_optical_flow_pyramid, calc_optical_flow_pyr_lk};
use pfd_geometry::GrayImage;

use crate::VisionError;
use crate::convert::gray_as_mat;

/// How Lucas-Kanade searches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowOptions {
    /// Side of the square window, pixels.
    pub window: i32,
    /// Pyramid levels above the image itself.
    pub levels: i32,
    /// Iterations per level.
    pub iterations: i32,
    /// Steps shorter than this (pixels) end the iteration.
    pub precision: f64,
}

impl Default for FlowOptions {
    fn default() -> Self {
        Self { window: 15, levels: 3, iterations: 15, precision: 0.02 }
    }
}

/// Smallest eigenvalue of the window's structure tensor (per pixel, OpenCV's scale) below which a point has no texture.
const MIN_EIGENVALUE: f64 = 1e-4;

/// The image pyramid of one frame; its buffers are kept when it is rebuilt.
#[derive(Debug, Default)]
pub struct FlowPyramid(Vector<Mat>);

impl FlowPyramid {
    /// Replaces the contents by the pyramid of `gray`.
    ///
    /// # Errors
    /// When OpenCV refuses.
    pub fn rebuild(&mut self, gray: &GrayImage, options: &FlowOptions) -> Result<(), VisionError> {
        let image = gray_as_mat(gray)?;
        let window = Size::new(options.window, options.window);
        let constant_border = opencv::core::BORDER_CONSTANT;
        let reflect = opencv::core::BORDER_REFLECT_101;
        build_optical_flow_pyramid(&image, &mut self.0, window, options.levels, true, reflect, constant_border, false)?;
        Ok(())
    }

    /// Whether nothing was built yet.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// Follows `points` from one frame to another; `guess` (same length) starts the search, else the points themselves do.
/// `None` where a point was lost.
///
/// # Errors
/// When OpenCV refuses.
pub fn track_points(
    from: &FlowPyramid,
    to: &FlowPyramid,
    points: &[[f32; 2]],
    guess: Option<&[[f32; 2]]>,
    options: &FlowOptions,
) -> Result<Vec<Option<[f32; 2]>>, VisionError> {
    if points.is_empty() || from.is_empty() || to.is_empty() {
        return Ok(vec![None; points.len()]);
    }
    let start = to_vector(points);
    let mut end = to_vector(guess.filter(|g| g.len() == points.len()).unwrap_or(points));
    let (mut status, mut error) = (Vector::<u8>::new(), Vector::<f32>::new());
    let criteria = TermCriteria::new(TermCriteria_COUNT + TermCriteria_EPS, options.iterations, options.precision)?;
    calc_optical_flow_pyr_lk(
        &from.0,
        &to.0,
        &start,
        &mut end,
        &mut status,
        &mut error,
        Size::new(options.window, options.window),
        options.levels,
        criteria,
        OPTFLOW_USE_INITIAL_FLOW,
        MIN_EIGENVALUE,
    )?;
    Ok(end.iter().zip(status.iter()).map(|(p, found)| (found == 1).then_some([p.x, p.y])).collect())
}

fn to_vector(points: &[[f32; 2]]) -> Vector<Point2f> {
    points.iter().map(|&[x, y]| Point2f::new(x, y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    /// A smooth texture moved by `(dx, dy)` pixels.
    fn texture(dx: f32, dy: f32) -> GrayImage {
        let mut image = Image::filled(120, 90, 0_u8);
        for v in 0..90 {
            for u in 0..120 {
                let (x, y) = (u as f32 - dx, v as f32 - dy);
                image[(u, v)] = (127.0 + 60.0 * (x * 0.21).sin() + 60.0 * (y * 0.17 + x * 0.05).cos()) as u8;
            }
        }
        image
    }

    #[test]
    fn follows_a_known_shift() {
        let options = FlowOptions::default();
        let (mut a, mut b) = (FlowPyramid::default(), FlowPyramid::default());
        a.rebuild(&texture(0.0, 0.0), &options).unwrap();
        b.rebuild(&texture(3.25, -2.5), &options).unwrap();
        let points = [[40.0, 40.0], [70.0, 50.0]];
        let tracked = track_points(&a, &b, &points, None, &options).unwrap();
        for (p, q) in points.iter().zip(&tracked) {
            let q = q.unwrap();
            assert!((q[0] - p[0] - 3.25).abs() < 0.1 && (q[1] - p[1] + 2.5).abs() < 0.1, "{p:?} → {q:?}");
        }
    }

    #[test]
    fn nothing_to_follow_is_no_error() {
        let empty = FlowPyramid::default();
        let options = FlowOptions::default();
        assert_eq!(track_points(&empty, &empty, &[[1.0, 1.0]], None, &options).unwrap(), [None]);
        assert_eq!(track_points(&empty, &empty, &[], None, &options).unwrap(), []);
    }
}
