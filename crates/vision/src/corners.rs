//! Corners by the smaller eigenvalue of the structure tensor (Shi and Tomasi, CVPR 1994).

use opencv::core::{BORDER_DEFAULT, Mat, MatTraitConst, MatTraitConstManual, Point2f, Vector, no_array};
use opencv::imgproc::{corner_min_eigen_val, good_features_to_track};
use pfd_geometry::{GrayImage, Mask};

use crate::VisionError;
use crate::convert::gray_as_mat;

/// Side of the structure tensor's window, pixels.
const BLOCK: i32 = 3;
/// Side of the Sobel operator, pixels.
const APERTURE: i32 = 3;
/// Rows beside a band that its structure tensors reach into. What the Sobel operator reaches beyond, OpenCV takes from the whole image.
const MARGIN: usize = BLOCK as usize / 2;

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
        let image = gray_as_mat(gray)?;
        let (width, height) = gray.size();
        let (right, bottom) = (width.saturating_sub(border), height.saturating_sub(border));
        let mut corners = Vec::new();
        for top in (border..bottom).step_by(self.cell) {
            let rows = top..(top + self.cell).min(bottom);
            // One row of cells at a time: intermediate results of the whole image are megabytes, which OpenCV allocates anew and many an
            // allocator gives back to the system each time.
            let first = rows.start.saturating_sub(MARGIN);
            let band = image.row_bounds(first as i32, (rows.end + MARGIN).min(height) as i32)?;
            corner_min_eigen_val(&band, &mut self.strength, BLOCK, APERTURE, BORDER_DEFAULT)?;
            let strength = Strength { values: self.strength.data_typed()?, width, first };
            for left in (border..right).step_by(self.cell) {
                let cell = (left..(left + self.cell).min(right), rows.clone());
                corners.extend(best_of_cell(&strength, cell, self.min_strength, excluded));
            }
        }
        Ok(corners)
    }
}

/// Strength of corners in some rows of an image.
struct Strength<'a> {
    values: &'a [f32],
    width: usize,
    /// The first of these rows.
    first: usize,
}

/// The strongest corner in columns × rows, if any is strong enough.
fn best_of_cell(
    strength: &Strength<'_>,
    (columns, rows): (std::ops::Range<usize>, std::ops::Range<usize>),
    min_strength: f32,
    excluded: Option<&Mask>,
) -> Option<[f32; 2]> {
    let mut best = None;
    let mut best_strength = min_strength;
    for v in rows {
        let row = &strength.values[(v - strength.first) * strength.width..][..strength.width];
        for u in columns.clone() {
            let s = row[u];
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
    fn corners_of_bands_are_those_of_the_whole_image() {
        let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761).rotate_left(13).wrapping_mul(0x85eb_ca6b) as u8;
        let image = GrayImage::from_vec(50, 41, (0..50 * 41).map(noise).collect()).unwrap();
        let mut whole = Mat::default();
        corner_min_eigen_val(&gray_as_mat(&image).unwrap(), &mut whole, BLOCK, APERTURE, BORDER_DEFAULT).unwrap();
        let strength = Strength { values: whole.data_typed().unwrap(), width: 50, first: 0 };
        for border in [0, 4] {
            let cells = (border..41 - border).step_by(8).flat_map(|v| {
                let end = move |start: usize, size: usize| start..(start + 8).min(size - border);
                (border..50 - border).step_by(8).map(move |u| (end(u, 50), end(v, 41)))
            });
            let expected: Vec<_> = cells.filter_map(|cell| best_of_cell(&strength, cell, 1e-4, None)).collect();
            assert_eq!(GridCorners::new(8, 1e-4).find(&image, border, None).unwrap(), expected);
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
