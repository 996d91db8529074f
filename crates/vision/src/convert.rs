//! Between our images and OpenCV's matrices.

use opencv::boxed_ref::BoxedRef;
use opencv::core::Mat;
use pfd_geometry::GrayImage;

/// An image operation that failed.
#[derive(Debug, thiserror::Error)]
pub enum VisionError {
    /// OpenCV refused the operation.
    #[error("OpenCV: {0}")]
    OpenCv(#[from] opencv::Error),
    /// Two images that belong together have different sizes.
    #[error("images of {}x{} and {}x{} do not belong together", .0.0, .0.1, .1.0, .1.1)]
    SizeMismatch((usize, usize), (usize, usize)),
}

/// Keeps OpenCV on the calling thread, so that results do not depend on the number of cores and the caller decides what runs
/// in parallel.
///
/// # Errors
/// When OpenCV refuses.
pub fn use_single_thread() -> Result<(), VisionError> {
    Ok(opencv::core::set_num_threads(1)?)
}

/// A matrix over the pixels of `image`, without a copy.
pub(crate) fn gray_as_mat(image: &GrayImage) -> Result<BoxedRef<'_, Mat>, VisionError> {
    Ok(Mat::new_rows_cols_with_data(image.height() as i32, image.width() as i32, image.pixels())?)
}
