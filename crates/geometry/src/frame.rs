//! One synchronised colour and depth measurement.

use crate::{Camera, DepthImage, GrayImage, RgbImage, Stamp};

/// Colour and depth images that do not belong together.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Colour and depth have different sizes; depth must be registered to colour.
    #[error("depth is {depth_width}x{depth_height} but colour is {width}x{height}: depth must be registered to colour")]
    SizeMismatch {
        /// Columns of the colour image.
        width: usize,
        /// Rows of the colour image.
        height: usize,
        /// Columns of the depth image.
        depth_width: usize,
        /// Rows of the depth image.
        depth_height: usize,
    },
    /// The image is not of the size that the camera model describes.
    #[error("the image is {width}x{height} but the camera model is for {camera_width}x{camera_height}")]
    CameraMismatch {
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
        /// Columns in the camera model.
        camera_width: usize,
        /// Rows in the camera model.
        camera_height: usize,
    },
}

/// A colour image and the depth image registered to it, at the stamp of the colour image.
#[derive(Clone, Debug, PartialEq)]
pub struct RgbdFrame {
    stamp: Stamp,
    rgb: RgbImage,
    gray: GrayImage,
    depth: DepthImage,
}

impl RgbdFrame {
    /// Joins colour and depth and derives the luma image.
    ///
    /// # Errors
    /// [`FrameError::SizeMismatch`] when the sizes differ.
    pub fn new(stamp: Stamp, rgb: RgbImage, depth: DepthImage) -> Result<Self, FrameError> {
        let ((width, height), (depth_width, depth_height)) = (rgb.size(), depth.image().size());
        if (width, height) != (depth_width, depth_height) {
            return Err(FrameError::SizeMismatch { width, height, depth_width, depth_height });
        }
        let gray = rgb.to_gray();
        Ok(Self { stamp, rgb, gray, depth })
    }

    /// Checks that the images have the size of `camera`.
    ///
    /// # Errors
    /// [`FrameError::CameraMismatch`] when they do not.
    pub fn check_camera(&self, camera: &Camera) -> Result<(), FrameError> {
        let (width, height) = self.rgb.size();
        if (width, height) == (camera.width, camera.height) {
            return Ok(());
        }
        Err(FrameError::CameraMismatch { width, height, camera_width: camera.width, camera_height: camera.height })
    }

    /// Stamp of the colour image.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// The colour image.
    pub fn rgb(&self) -> &RgbImage {
        &self.rgb
    }

    /// Luma of the colour image.
    pub fn gray(&self) -> &GrayImage {
        &self.gray
    }

    /// Depth registered to the colour image.
    pub fn depth(&self) -> &DepthImage {
        &self.depth
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Image;

    #[test]
    fn sizes_must_agree() {
        let rgb = Image::filled(4, 2, [9_u8; 3]);
        let depth = DepthImage::from_metres(Image::filled(2, 4, 1.0));
        assert!(matches!(
            RgbdFrame::new(Stamp::default(), rgb, depth),
            Err(FrameError::SizeMismatch { width: 4, depth_width: 2, .. })
        ));
    }
}
