//! Colour and depth image files.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;

use image::{DynamicImage, ImageReader, Limits};
use pfd_geometry::encoded::is_complete;
use pfd_geometry::{Camera, GrayImage, Image, Mask, RgbImage};

use crate::DatasetError;

/// Reads a colour image, PNG or JPEG (by its content, not by its name); grey images become colour.
///
/// # Errors
/// When the file cannot be read or decoded.
pub fn read_color(path: &Path) -> Result<RgbImage, DatasetError> {
    let image = decode(path)?.into_rgb8();
    let (width, height) = image.dimensions();
    let pixels = image.pixels().map(|p| p.0).collect();
    from_pixels(path, width, height, pixels)
}

/// Reads a depth image: PNG with one channel of 16 bits, in sensor units.
///
/// # Errors
/// When the file cannot be read or decoded, or is of another kind.
pub fn read_depth(path: &Path) -> Result<Image<u16>, DatasetError> {
    let image = match decode(path)? {
        DynamicImage::ImageLuma16(image) => image,
        other => {
            let reason = format!("depth is an image with one channel of 16 bits, this one is {:?}", other.color());
            return Err(DatasetError::Image { path: path.to_owned(), reason });
        }
    };
    let (width, height) = image.dimensions();
    from_pixels(path, width, height, image.into_raw())
}

/// Reads a grey image with 8 bits whose values have a meaning, such as a true mask; palettes and colour channels that are alike are grey
/// as well.
///
/// # Errors
/// When the file cannot be read or decoded, or is of another kind: conversion would change the values.
pub fn read_gray(path: &Path) -> Result<GrayImage, DatasetError> {
    let decoded = decode(path)?;
    let is_gray = match &decoded {
        DynamicImage::ImageLuma8(_) | DynamicImage::ImageLumaA8(_) => true,
        DynamicImage::ImageRgb8(image) => image.pixels().all(|p| p.0 == [p.0[0]; 3]),
        DynamicImage::ImageRgba8(image) => image.pixels().all(|p| p.0[..3] == [p.0[0]; 3]),
        _ => false,
    };
    if !is_gray {
        let reason = format!("a grey image with 8 bits is expected, this one is {:?}", decoded.color());
        return Err(DatasetError::Image { path: path.to_owned(), reason });
    }
    let image = decoded.into_luma8();
    let (width, height) = image.dimensions();
    from_pixels(path, width, height, image.into_raw())
}

/// Reads a mask from an image of any kind: what is not black counts as dynamic. Transparency says nothing.
///
/// # Errors
/// When the file cannot be read or decoded.
pub fn read_mask(path: &Path) -> Result<Mask, DatasetError> {
    // All channels with all their bits: fewer would turn small values to 0.
    let image = decode(path)?.into_rgb16();
    let (width, height) = image.dimensions();
    let mut mask = Mask::empty(width as usize, height as usize);
    mask.assign(image.pixels().map(|pixel| pixel.0 != [0; 3]));
    Ok(mask)
}

/// Width and height of an image without decoding it.
///
/// # Errors
/// When the file cannot be read or is no image.
pub fn size(path: &Path) -> Result<(usize, usize), DatasetError> {
    let (width, height) = reader(path)?.into_dimensions().map_err(|e| unreadable(path, &e))?;
    Ok((width as usize, height as usize))
}

fn decode(path: &Path) -> Result<DynamicImage, DatasetError> {
    let failed = |reason: String| DatasetError::Image { path: path.to_owned(), reason };
    let data = std::fs::read(path).map_err(|e| failed(e.to_string()))?;
    if !is_complete(&data) {
        return Err(failed("a JPEG that was cut short: its end-of-image marker is missing".to_owned()));
    }
    limited(Cursor::new(data)).map_err(|e| failed(e.to_string()))?.decode().map_err(|e| unreadable(path, &e))
}

fn reader(path: &Path) -> Result<ImageReader<BufReader<File>>, DatasetError> {
    let unreadable = |e: std::io::Error| DatasetError::Image { path: path.to_owned(), reason: e.to_string() };
    File::open(path).and_then(|file| limited(BufReader::new(file))).map_err(unreadable)
}

fn limited<R: BufRead + Seek>(source: R) -> std::io::Result<ImageReader<R>> {
    let mut reader = ImageReader::new(source).with_guessed_format()?;
    // A file may claim any size: refuse it before memory is allocated.
    let mut limits = Limits::default();
    limits.max_image_width = Some(Camera::MAX_SIDE as u32);
    limits.max_image_height = Some(Camera::MAX_SIDE as u32);
    reader.limits(limits);
    Ok(reader)
}

fn unreadable(path: &Path, error: &image::ImageError) -> DatasetError {
    DatasetError::Image { path: path.to_owned(), reason: format!("not readable as an image: {error}") }
}

fn from_pixels<T>(path: &Path, width: u32, height: u32, pixels: Vec<T>) -> Result<Image<T>, DatasetError> {
    Image::from_vec(width as usize, height as usize, pixels)
        .map_err(|e| DatasetError::Image { path: path.to_owned(), reason: e.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_must_have_sixteen_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        image::GrayImage::new(4, 2).save(&path).unwrap();
        let error = read_depth(&path).unwrap_err().to_string();
        assert!(error.contains("depth.png") && error.contains("16 bits"), "{error}");
        image::ImageBuffer::from_pixel(4, 2, image::Luma([5000_u16])).save(&path).unwrap();
        assert_eq!(read_depth(&path).unwrap().pixels(), [5000; 8]);
        assert_eq!(size(&path).unwrap(), (4, 2));
    }

    #[test]
    fn what_is_not_black_is_masked_whatever_the_kind_of_image() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mask.png");
        let masked = || read_mask(&path).unwrap().image().pixels().to_vec();
        image::ImageBuffer::from_fn(2, 1, |u, _| image::Luma([u as u16])).save(&path).unwrap();
        assert_eq!(masked(), [0, 255], "1 of 16 bits");
        assert!(read_gray(&path).unwrap_err().to_string().contains("mask.png: a grey image with 8 bits"));
        image::ImageBuffer::from_fn(2, 1, |u, _| image::Rgba([0, 0, u as u8, 255])).save(&path).unwrap();
        assert_eq!(masked(), [0, 255], "faint blue");
        assert!(read_gray(&path).is_err());
        image::ImageBuffer::from_fn(2, 1, |u, _| image::Luma([u as u8])).save(&path).unwrap();
        assert_eq!(masked(), [0, 255]);
        assert_eq!(read_gray(&path).unwrap().pixels(), [0, 1]);
        image::ImageBuffer::from_fn(2, 1, |u, _| image::Rgb([128 * u as u8; 3])).save(&path).unwrap();
        assert_eq!(read_gray(&path).unwrap().pixels(), [0, 128], "grey in three channels");
    }

    #[test]
    fn a_file_that_is_no_image_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        std::fs::write(&path, b"not an image").unwrap();
        assert!(read_color(&path).unwrap_err().to_string().contains("a.jpg"));
        assert!(read_color(&folder.path().join("missing.png")).unwrap_err().concerns_one_frame());
    }
}
