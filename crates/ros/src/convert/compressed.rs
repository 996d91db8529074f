//! `sensor_msgs/CompressedImage`: JPEG and PNG colour, and image_transport's compressedDepth.

use std::io::Cursor;

use image::{DynamicImage, ImageReader, Limits};
use pfd_geometry::encoded::is_complete;
use pfd_geometry::{Camera, DepthImage, Image, RgbImage};

use super::image::{ConvertError, MILLIMETRES};
use crate::messages::sensor::CompressedImage;

/// Memory that decoding one image may take: the largest supported colour image, twice.
const MAX_DECODER_BYTES: u64 = 2 * 3 * (Camera::MAX_SIDE * Camera::MAX_SIDE) as u64;
/// compressedDepth puts a header before the PNG: an enum and two floats.
const DEPTH_HEADER: usize = 12;

/// Decodes a JPEG or PNG colour image.
///
/// # Errors
/// [`ConvertError::Compressed`] when the data is damaged, of another kind or too large.
pub fn rgb_from_compressed(message: &CompressedImage) -> Result<RgbImage, ConvertError> {
    let decoded = decode(&message.format, &message.data)?.into_rgb8();
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let pixels = decoded.into_raw().as_chunks::<3>().0.to_vec();
    Image::from_vec(width, height, pixels).map_err(|e| damaged(&message.format, &e))
}

/// Decodes compressedDepth: 16-bit millimetres, or quantised inverse depth for 32-bit metres
/// (`compressed_depth_image_transport`, `codec.cpp`: depth = a / (quantised − b)).
///
/// # Errors
/// [`ConvertError::Compressed`] when the data is damaged, of another kind or too large.
pub fn depth_from_compressed(message: &CompressedImage) -> Result<DepthImage, ConvertError> {
    let format = &message.format;
    let Some((header, png)) = message.data.split_at_checked(DEPTH_HEADER) else {
        return Err(damaged(format, &"shorter than its header"));
    };
    let DynamicImage::ImageLuma16(decoded) = decode(format, png)? else {
        return Err(damaged(format, &"not a 16-bit PNG; RVL is not supported, set the publisher's format to png"));
    };
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let raw = Image::from_vec(width, height, decoded.into_raw()).map_err(|e| damaged(format, &e))?;
    if !format.contains("32FC1") {
        return Ok(DepthImage::from_raw(&raw, MILLIMETRES));
    }
    let float = |at: usize| header[at..at + 4].try_into().map_or(0.0, f32::from_le_bytes);
    let (a, b) = (float(4), float(8));
    let metres = raw.pixels().iter().map(|&q| if q == 0 { 0.0 } else { a / (f32::from(q) - b) }).collect();
    let metres = Image::from_vec(width, height, metres).map_err(|e| damaged(format, &e))?;
    Ok(DepthImage::from_metres(metres))
}

fn decode(format: &str, data: &[u8]) -> Result<DynamicImage, ConvertError> {
    if !is_complete(data) {
        return Err(damaged(format, &"cut short: the end-of-image marker of the JPEG is missing"));
    }
    let mut reader = ImageReader::new(Cursor::new(data)).with_guessed_format().map_err(|e| damaged(format, &e))?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(Camera::MAX_SIDE as u32);
    limits.max_image_height = Some(Camera::MAX_SIDE as u32);
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    reader.limits(limits);
    reader.decode().map_err(|e| damaged(format, &e))
}

fn damaged(format: &str, reason: &dyn std::fmt::Display) -> ConvertError {
    ConvertError::Compressed { format: format.to_owned(), reason: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn png(image: &DynamicImage) -> Vec<u8> {
        let mut bytes = Vec::new();
        image.write_to(&mut Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
        bytes
    }

    fn message(format: &str, data: Vec<u8>) -> CompressedImage {
        CompressedImage { format: format.into(), data: data.into(), ..CompressedImage::default() }
    }

    #[test]
    fn colour_and_depth_decode() {
        let colour = image::RgbImage::from_raw(2, 1, vec![1, 2, 3, 4, 5, 6]).unwrap();
        let rgb = rgb_from_compressed(&message("rgb8; png compressed", png(&colour.into()))).unwrap();
        assert_eq!(rgb.pixels(), [[1, 2, 3], [4, 5, 6]]);
        let depth = image::ImageBuffer::from_raw(2, 1, vec![1500_u16, 0]).unwrap();
        let body = png(&DynamicImage::ImageLuma16(depth));
        let millimetres = message("16UC1; compressedDepth png", [vec![0; 12], body.clone()].concat());
        assert_eq!(depth_from_compressed(&millimetres).unwrap().image().pixels(), [1.5, 0.0]);
        let header = [[0; 4], 3000.0_f32.to_le_bytes(), 500.0_f32.to_le_bytes()].concat();
        let metres = message("32FC1; compressedDepth png", [header, body].concat());
        assert_eq!(depth_from_compressed(&metres).unwrap().image().pixels(), [3.0, 0.0]);
    }

    #[test]
    fn a_jpeg_that_was_cut_short_is_refused() {
        let noise =
            image::RgbImage::from_fn(64, 64, |x, y| image::Rgb([(x * 37 + y * 91) as u8, (x * y) as u8, y as u8]));
        let mut jpeg = Vec::new();
        DynamicImage::from(noise).write_to(&mut Cursor::new(&mut jpeg), image::ImageFormat::Jpeg).unwrap();
        assert!(rgb_from_compressed(&message("rgb8; jpeg compressed bgr8", jpeg.clone())).is_ok());
        jpeg.truncate(jpeg.len() / 2);
        let error = rgb_from_compressed(&message("rgb8; jpeg compressed bgr8", jpeg)).unwrap_err();
        assert!(error.to_string().contains("cut short"), "{error}");
    }

    proptest! {
        #[test]
        fn any_bytes_decode_or_are_refused(data in prop::collection::vec(any::<u8>(), 0..200), png in any::<bool>()) {
            let magic: &[u8] = if png { b"\x89PNG\r\n\x1a\n" } else { &[0xff, 0xd8, 0xff] };
            let _ = rgb_from_compressed(&message("jpeg", [magic, &data].concat()));
            let _ = depth_from_compressed(&message("16UC1; compressedDepth", [&[0; 12], magic, &data].concat()));
            let _ = depth_from_compressed(&message("", data));
        }
    }
}
