//! Image warps and filters.

use nalgebra::Matrix3;
use opencv::core::{BORDER_CONSTANT, BORDER_DEFAULT, Mat, Scalar, Size};
use opencv::imgproc::{INTER_LINEAR, box_filter, gaussian_blur_def, warp_perspective};
use pfd_geometry::{GrayImage, Image};

use crate::VisionError;
use crate::convert::gray_as_mat;

/// Warps `image` so that pixel `p` moves to `H p`, into `out` of the same size; pixels without a source become 0.
///
/// # Errors
/// [`VisionError::SizeMismatch`], or when OpenCV refuses.
pub fn warp_by_homography(
    image: &GrayImage,
    homography: &Matrix3<f64>,
    out: &mut GrayImage,
) -> Result<(), VisionError> {
    same_size(image.size(), out.size())?;
    let rows: Vec<f64> = homography.transpose().iter().copied().collect();
    let matrix = Mat::new_rows_cols_with_data(3, 3, &rows)?;
    let size = Size::new(image.width() as i32, image.height() as i32);
    let (width, height) = (size.width, size.height);
    let mut target = Mat::new_rows_cols_with_data_mut(height, width, out.pixels_mut())?;
    let black = Scalar::default();
    Ok(warp_perspective(&gray_as_mat(image)?, &mut target, &matrix, size, INTER_LINEAR, BORDER_CONSTANT, black)?)
}

/// The mean over a square window of `side` pixels, into `out` of the same size.
///
/// # Errors
/// [`VisionError::SizeMismatch`], or when OpenCV refuses.
pub fn box_mean(image: &GrayImage, side: i32, out: &mut Image<f32>) -> Result<(), VisionError> {
    same_size(image.size(), out.size())?;
    let (width, height) = (image.width() as i32, image.height() as i32);
    let mut target = Mat::new_rows_cols_with_data_mut(height, width, out.pixels_mut())?;
    let anchor = opencv::core::Point::new(-1, -1);
    let window = Size::new(side, side);
    let depth = opencv::core::CV_32F;
    Ok(box_filter(&gray_as_mat(image)?, &mut target, depth, window, anchor, true, BORDER_DEFAULT)?)
}

/// The image smoothed by a Gaussian of standard deviation `sigma` pixels, into `out` of the same size.
///
/// # Errors
/// [`VisionError::SizeMismatch`], or when OpenCV refuses.
pub fn gaussian_smooth(image: &GrayImage, sigma: f64, out: &mut GrayImage) -> Result<(), VisionError> {
    same_size(image.size(), out.size())?;
    let (width, height) = (image.width() as i32, image.height() as i32);
    let mut target = Mat::new_rows_cols_with_data_mut(height, width, out.pixels_mut())?;
    Ok(gaussian_blur_def(&gray_as_mat(image)?, &mut target, Size::default(), sigma)?)
}

fn same_size(a: (usize, usize), b: (usize, usize)) -> Result<(), VisionError> {
    if a == b { Ok(()) } else { Err(VisionError::SizeMismatch(a, b)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_translation_moves_pixels() {
        let mut image = Image::filled(8, 6, 0_u8);
        image[(2, 3)] = 200;
        let mut out = Image::filled(8, 6, 7_u8);
        warp_by_homography(&image, &Matrix3::new_translation(&nalgebra::Vector2::new(3.0, -1.0)), &mut out).unwrap();
        assert_eq!(out[(5, 2)], 200);
        assert_eq!(out.pixels().iter().map(|&p| u32::from(p)).sum::<u32>(), 200);
    }

    #[test]
    fn sizes_must_agree() {
        let image = Image::filled(8, 6, 0_u8);
        let mut out = Image::filled(8, 5, 0_u8);
        assert!(matches!(
            warp_by_homography(&image, &Matrix3::identity(), &mut out),
            Err(VisionError::SizeMismatch((8, 6), (8, 5)))
        ));
    }

    #[test]
    fn box_mean_of_a_constant() {
        let mut out = Image::filled(9, 7, 0.0_f32);
        box_mean(&Image::filled(9, 7, 40_u8), 5, &mut out).unwrap();
        assert!(out.pixels().iter().all(|&p| (p - 40.0).abs() < 1e-4));
    }
}
