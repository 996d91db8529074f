//! Sample frames with their masks drawn in.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use pfd_geometry::{Mask, RgbImage, Stamp};

use crate::ReportError;

/// Width in pixels of the images in a page.
const SAMPLE_WIDTH: u32 = 480;
const JPEG_QUALITY: u8 = 82;
/// Colour of what moves, and how strongly it covers the image.
const MASK_COLOUR: [u8; 3] = [255, 64, 32];
const MASK_OPACITY: f32 = 0.5;

/// A frame as it appears in a page.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Stamp of the frame.
    pub stamp: Stamp,
    /// Share of the image that is masked, 0 to 1.
    pub masked: f64,
    /// Line under the image.
    pub caption: String,
    /// The image, JPEG.
    pub jpeg: Vec<u8>,
}

impl Sample {
    /// Draws `mask` over `rgb` and reduces it to the size used in pages.
    ///
    /// # Errors
    /// When the image cannot be encoded.
    pub fn new(stamp: Stamp, caption: String, rgb: &RgbImage, mask: &Mask) -> Result<Self, ReportError> {
        let full = overlay(rgb, mask);
        let (width, height) = full.dimensions();
        let reduced_height = (height * SAMPLE_WIDTH / width.max(1)).max(1);
        let reduced = image::imageops::resize(&full, SAMPLE_WIDTH, reduced_height, FilterType::Triangle);
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY).encode_image(&reduced)?;
        Ok(Self { stamp, masked: mask.fraction(), caption, jpeg })
    }

    /// The image as a URI that needs no file.
    pub fn data_uri(&self) -> String {
        format!("data:image/jpeg;base64,{}", STANDARD.encode(&self.jpeg))
    }
}

/// `rgb` with the moving pixels tinted and their outline drawn.
pub fn overlay(rgb: &RgbImage, mask: &Mask) -> image::RgbImage {
    let colour_at = |u: u32, v: u32| {
        let (x, y) = (u as usize, v as usize);
        let pixel = rgb[(x, y)];
        let tinted = match (mask.is_dynamic(x, y), is_border(mask, x, y)) {
            (false, _) => pixel,
            (true, true) => MASK_COLOUR,
            (true, false) => std::array::from_fn(|c| blend(pixel[c], MASK_COLOUR[c])),
        };
        image::Rgb(tinted)
    };
    image::RgbImage::from_fn(rgb.width() as u32, rgb.height() as u32, colour_at)
}

fn blend(below: u8, above: u8) -> u8 {
    (f32::from(below) * (1.0 - MASK_OPACITY) + f32::from(above) * MASK_OPACITY) as u8
}

fn is_border(mask: &Mask, u: usize, v: usize) -> bool {
    let outside = |du: isize, dv: isize| match (u.checked_add_signed(du), v.checked_add_signed(dv)) {
        (Some(x), Some(y)) => !mask.is_dynamic(x, y),
        _ => true,
    };
    outside(-1, 0) || outside(1, 0) || outside(0, -1) || outside(0, 1)
}

/// `count` indices spread evenly over `0..len`, without the ends.
pub fn spread(len: usize, count: usize) -> Vec<usize> {
    let count = count.min(len);
    (0..count).map(|k| (2 * k + 1) * len / (2 * count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    #[test]
    fn moving_pixels_are_tinted() {
        let rgb = Image::filled(8, 6, [10_u8; 3]);
        let mut mask = Mask::empty(8, 6);
        mask.set(3, 3, true);
        let drawn = overlay(&rgb, &mask);
        assert_eq!(drawn.get_pixel(3, 3).0, MASK_COLOUR);
        assert_eq!(drawn.get_pixel(4, 3).0, [10; 3]);
        let sample = Sample::new(Stamp::default(), String::new(), &rgb, &mask).unwrap();
        assert!(sample.data_uri().starts_with("data:image/jpeg;base64,/9j/"));
    }

    #[test]
    fn samples_are_spread() {
        assert_eq!(spread(100, 4), [12, 37, 62, 87]);
        assert_eq!(spread(2, 4), [0, 1]);
        assert!(spread(0, 4).is_empty());
    }
}
