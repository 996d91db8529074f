//! Corners by the smaller eigenvalue of the structure tensor (Shi and Tomasi, CVPR 1994).

use opencv::core::{BORDER_DEFAULT, Mat, MatTraitConst, MatTraitConstManual, Point2f, Vector, no_array};
use opencv::imgproc::{corner_min_eigen_val, good_features_to_track};
use pfd_geometry::{GrayImage, Mask};

use crate::VisionError;
use crate::convert::gray_as_mat;

/// Side of the structure tensor's window, pixels.
const BLOCK: i32 = 3;

/// The strongest corners of an image, at least `distance` pixels apart and at least `quality` times as strong as the
/// strongest.
///
/// # Errors
/// When OpenCV refuses.
pub fn strongest_corners(
    gray: &GrayImage,
    count: usize,
    quality: f64,
    distance: f64,
) -> Result<Vec<[f32; 2]>, VisionError> {
    let mut corners = Vector::<Point2f>::new();
    let image = gray_as_mat(gray)?;
    good_features_to_track(&image, &mut corners, count as i32, quality, distance, &no_array(), BLOCK, false, 0.04)?;
    Ok(corners.iter().map(|p| [p.x, p.y]).collect())
}

/// Finds the best corner of each cell of a regular grid, so that corners cover the image evenly.
#[derive(Debug)]
pub struct GridCorners {
    cell: usize,
    min_strength: f32,
    strength: Mat,
}

impl GridCorners {
    /// Cells of `cell × cell` pixels; corners weaker than `min_strength` (OpenCV's scale: squared grey levels, image
    /// scaled to 0..1) do not count.
    pub fn new(cell: usize, min_strength: f32) -> Self {
        Self { cell: cell.max(1), min_strength, strength: Mat::default() }
    }

    /// Corners of `gray` at least `border` pixels inside the image and outside `excluded`.
    ///
    /// # Errors
    /// When OpenCV refuses.
    pub fn find(
        &mut self,
        gray: &GrayImage,
        border: usize,
        excluded: Option<&Mask>,
    ) -> Result<Vec<[f32; 2]>, VisionError> {
        corner_min_eigen_val(&gray_as_mat(gray)?, &mut self.strength, BLOCK, 3, BORDER_DEFAULT)?;
        let mut corners = Vec::new();
        if !self.strength.is_continuous() {
            return Ok(corners);
        }
        let strength: &[f32] = self.strength.data_typed()?;
        let (width, height) = gray.size();
        let (right, bottom) = (width.saturating_sub(border), height.saturating_sub(border));
        for top in (border..bottom).step_by(self.cell) {
            for left in (border..right).step_by(self.cell) {
                let cell = (left..(left + self.cell).min(right), top..(top + self.cell).min(bottom));
                corners.extend(best_of_cell(strength, width, cell, self.min_strength, excluded));
            }
        }
        Ok(corners)
    }
}

/// The strongest corner in columns × rows, if any is strong enough.
fn best_of_cell(
    strength: &[f32],
    width: usize,
    (columns, rows): (std::ops::Range<usize>, std::ops::Range<usize>),
    min_strength: f32,
    excluded: Option<&Mask>,
) -> Option<[f32; 2]> {
    let mut best = None;
    let mut best_strength = min_strength;
    for v in rows {
        for u in columns.clone() {
            let s = strength[v * width + u];
            if s > best_strength && !excluded.is_some_and(|m| m.is_dynamic(u, v)) {
                (best, best_strength) = (Some([u as f32, v as f32]), s);
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    /// A black image with a white square from (20, 20) to (39, 39).
    fn square() -> GrayImage {
        let mut image = Image::filled(64, 64, 0_u8);
        for v in 20..40 {
            for u in 20..40 {
                image[(u, v)] = 255;
            }
        }
        image
    }

    #[test]
    fn finds_the_corners_of_a_square() {
        let corners = strongest_corners(&square(), 10, 0.5, 3.0).unwrap();
        assert_eq!(corners.len(), 4);
        for [x, y] in corners {
            assert!([20.0, 39.0].iter().any(|c: &f32| (c - x).abs() < 2.0), "{x}");
            assert!([20.0, 39.0].iter().any(|c: &f32| (c - y).abs() < 2.0), "{y}");
        }
    }

    #[test]
    fn one_corner_a_cell_and_none_under_the_mask() {
        let mut grid = GridCorners::new(32, 1e-3);
        assert_eq!(grid.find(&square(), 0, None).unwrap().len(), 4);
        let mut mask = Mask::empty(64, 64);
        for v in 0..64 {
            for u in 0..32 {
                mask.set(u, v, true);
            }
        }
        let corners = grid.find(&square(), 0, Some(&mask)).unwrap();
        assert_eq!(corners.len(), 2);
        assert!(corners.iter().all(|c| c[0] >= 32.0));
    }
}
