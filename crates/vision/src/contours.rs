//! Outlines of binary images.

use opencv::core::{Point, Vector};
use opencv::imgproc::{CHAIN_APPROX_SIMPLE, RETR_EXTERNAL, bounding_rect, contour_area_def, find_contours_def};
use pfd_geometry::Mask;

use crate::VisionError;
use crate::convert::gray_as_mat;

/// The axis-aligned rectangle around a contour and the area the contour encloses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contour {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Enclosed area, pixels.
    pub area: f64,
}

/// The contour of `mask` that encloses the largest area; `None` when nothing is set.
///
/// # Errors
/// When OpenCV refuses.
pub fn largest_contour(mask: &Mask) -> Result<Option<Contour>, VisionError> {
    let mut contours = Vector::<Vector<Point>>::new();
    find_contours_def(&gray_as_mat(mask.image())?, &mut contours, RETR_EXTERNAL, CHAIN_APPROX_SIMPLE)?;
    let mut largest: Option<Contour> = None;
    for contour in &contours {
        let area = contour_area_def(&contour)?;
        if largest.is_none_or(|l| area > l.area) {
            let r = bounding_rect(&contour)?;
            let (x, y, width, height) = (r.x as u32, r.y as u32, r.width as u32, r.height as u32);
            largest = Some(Contour { x, y, width, height, area });
        }
    }
    Ok(largest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_larger_of_two_blobs() {
        let mut mask = Mask::empty(40, 30);
        for v in 5..10 {
            for u in 3..8 {
                mask.set(u, v, true);
            }
        }
        for v in 12..28 {
            for u in 20..30 {
                mask.set(u, v, true);
            }
        }
        let found = largest_contour(&mask).unwrap().unwrap();
        assert_eq!((found.x, found.y, found.width, found.height), (20, 12, 10, 16));
        assert_eq!(largest_contour(&Mask::empty(4, 4)).unwrap(), None);
    }
}
