//! `sensor_msgs/Image`.

use bytes::Bytes;
use pfd_geometry::{Camera, DepthImage, Image, Mask, RgbImage, Stamp};

use crate::messages::{sensor, standard::Header};

/// An image message that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConvertError {
    /// The size is zero or beyond what is supported.
    #[error("{width}x{height} pixels: supported are 1 to {} a side", Camera::MAX_SIDE)]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The rows are shorter than the pixels need.
    #[error("step {step} is too small for {width} pixels of `{encoding}`, which need {needed} bytes")]
    Step {
        /// Bytes a row by the message.
        step: u32,
        /// Columns.
        width: u32,
        /// Encoding.
        encoding: String,
        /// Bytes that a row needs.
        needed: usize,
    },
    /// There are fewer bytes than size and step promise.
    #[error("{got} bytes of data where height x step promise {needed}")]
    Data {
        /// Bytes promised.
        needed: usize,
        /// Bytes there.
        got: usize,
    },
    /// The encoding is not known for this use.
    #[error("encoding `{encoding}` is not supported; use one of: {supported}")]
    Encoding {
        /// Encoding of the message.
        encoding: String,
        /// What would be understood.
        supported: &'static str,
    },
    /// The compressed data is damaged or too large.
    #[error("compressed image (`{format}`): {reason}")]
    Compressed {
        /// Format of the message.
        format: String,
        /// What is wrong.
        reason: String,
    },
    /// The camera_info is not that of a camera.
    #[error("camera_info: {0}")]
    Camera(String),
}

const COLOUR_ENCODINGS: &str = "rgb8, bgr8, rgba8, bgra8, mono8";
const DEPTH_ENCODINGS: &str = "16UC1 or mono16 (millimetres), 32FC1 (metres)";
/// Millimetres a metre.
pub(super) const MILLIMETRES: f32 = 1000.0;

/// The rows of an image message, without padding; every size is checked.
fn rows(message: &sensor::Image, bytes_per_pixel: usize) -> Result<impl Iterator<Item = &[u8]>, ConvertError> {
    let (width, height, step) = (message.width as usize, message.height as usize, message.step as usize);
    if !(1..=Camera::MAX_SIDE).contains(&width) || !(1..=Camera::MAX_SIDE).contains(&height) {
        return Err(ConvertError::Size { width: message.width, height: message.height });
    }
    let needed = width * bytes_per_pixel;
    if step < needed {
        let encoding = message.encoding.clone();
        return Err(ConvertError::Step { step: message.step, width: message.width, encoding, needed });
    }
    // The padding of the last row may be missing.
    let total = step.checked_mul(height - 1).and_then(|n| n.checked_add(needed)).unwrap_or(usize::MAX);
    if message.data.len() < total {
        return Err(ConvertError::Data { needed: total, got: message.data.len() });
    }
    Ok(message.data.chunks(step).take(height).map(move |row| &row[..needed]))
}

/// Converts pixel by pixel.
fn convert<const N: usize, T>(
    message: &sensor::Image,
    pixel: impl Fn([u8; N]) -> T + Copy,
) -> Result<Image<T>, ConvertError> {
    let rows = rows(message, N)?;
    let (width, height) = (message.width as usize, message.height as usize);
    let mut pixels = Vec::with_capacity(width * height);
    for row in rows {
        pixels.extend(row.as_chunks::<N>().0.iter().map(|&bytes| pixel(bytes)));
    }
    Image::from_vec(width, height, pixels).map_err(|_| ConvertError::Data { needed: width * height * N, got: 0 })
}

/// The colour image of a message in any of the supported encodings.
///
/// # Errors
/// [`ConvertError`] when sizes do not match or the encoding is not one of colour.
pub fn rgb_from_image(message: &sensor::Image) -> Result<RgbImage, ConvertError> {
    match message.encoding.as_str() {
        "rgb8" => convert(message, |p: [u8; 3]| p),
        "bgr8" => convert(message, |[b, g, r]| [r, g, b]),
        "rgba8" => convert(message, |[r, g, b, _]| [r, g, b]),
        "bgra8" => convert(message, |[b, g, r, _]| [r, g, b]),
        "mono8" | "8UC1" => convert(message, |[v]| [v; 3]),
        other => Err(ConvertError::Encoding { encoding: other.to_owned(), supported: COLOUR_ENCODINGS }),
    }
}

/// The depth image of a message in any of the supported encodings.
///
/// # Errors
/// [`ConvertError`] when sizes do not match or the encoding is not one of depth.
pub fn depth_from_image(message: &sensor::Image) -> Result<DepthImage, ConvertError> {
    let big = message.is_bigendian != 0;
    match message.encoding.as_str() {
        "16UC1" | "mono16" => {
            let raw = convert(message, |b: [u8; 2]| if big { u16::from_be_bytes(b) } else { u16::from_le_bytes(b) })?;
            Ok(DepthImage::from_raw(&raw, MILLIMETRES))
        }
        "32FC1" => {
            let metres =
                convert(message, |b: [u8; 4]| if big { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) })?;
            Ok(DepthImage::from_metres(metres))
        }
        other => Err(ConvertError::Encoding { encoding: other.to_owned(), supported: DEPTH_ENCODINGS }),
    }
}

/// The mask of a message: `mono8`, everything but 0 is dynamic.
///
/// # Errors
/// [`ConvertError`] when sizes do not match or the encoding is another.
pub fn mask_from_image(message: &sensor::Image) -> Result<Mask, ConvertError> {
    match message.encoding.as_str() {
        "mono8" | "8UC1" => Ok(Mask::from_image(convert(message, |[v]: [u8; 1]| v)?)),
        other => Err(ConvertError::Encoding { encoding: other.to_owned(), supported: "mono8" }),
    }
}

fn message(header: Header, size: (usize, usize), encoding: &str, data: Bytes) -> sensor::Image {
    let (width, height) = (size.0 as u32, size.1 as u32);
    let step = (data.len() / size.1.max(1)) as u32;
    sensor::Image { header, height, width, encoding: encoding.to_owned(), is_bigendian: 0, step, data }
}

/// `rgb8`
pub fn rgb_to_image(image: &RgbImage, stamp: Stamp, frame: &str) -> sensor::Image {
    message(Header::new(stamp, frame), image.size(), "rgb8", Bytes::copy_from_slice(image.as_bytes()))
}

/// `mono8`, 255 = dynamic
pub fn mask_to_image(mask: &Mask, stamp: Stamp, frame: &str) -> sensor::Image {
    let image = mask.image();
    message(Header::new(stamp, frame), image.size(), "mono8", Bytes::copy_from_slice(image.pixels()))
}

/// `32FC1` in metres; 0 where there is no measurement.
pub fn depth_to_metres(depth: &DepthImage, stamp: Stamp, frame: &str) -> sensor::Image {
    let image = depth.image();
    let data: Vec<u8> = image.pixels().iter().flat_map(|d| d.to_le_bytes()).collect();
    message(Header::new(stamp, frame), image.size(), "32FC1", data.into())
}

/// `16UC1` in millimetres, rounded; 0 where there is no measurement or it does not fit.
pub fn depth_to_millimetres(depth: &DepthImage, stamp: Stamp, frame: &str) -> sensor::Image {
    let image = depth.image();
    let raw = |d: f32| {
        let millimetres = (d * MILLIMETRES).round();
        if millimetres <= f32::from(u16::MAX) { millimetres as u16 } else { 0 }
    };
    let data: Vec<u8> = image.pixels().iter().flat_map(|&d| raw(d).to_le_bytes()).collect();
    message(Header::new(stamp, frame), image.size(), "16UC1", data.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn image(encoding: &str, (width, height): (u32, u32), step: u32, data: &[u8]) -> sensor::Image {
        let data = Bytes::copy_from_slice(data);
        sensor::Image { height, width, encoding: encoding.into(), step, data, ..sensor::Image::default() }
    }

    #[test]
    fn colour_encodings_give_the_same_pixel() {
        for (encoding, bytes) in
            [("rgb8", &[1, 2, 3][..]), ("bgr8", &[3, 2, 1]), ("rgba8", &[1, 2, 3, 9]), ("bgra8", &[3, 2, 1, 9])]
        {
            let rgb = rgb_from_image(&image(encoding, (1, 1), bytes.len() as u32, bytes)).unwrap();
            assert_eq!(rgb.pixels(), [[1, 2, 3]], "{encoding}");
        }
        assert_eq!(rgb_from_image(&image("mono8", (1, 1), 1, &[7])).unwrap().pixels(), [[7, 7, 7]]);
    }

    #[test]
    fn padding_is_skipped_and_the_last_may_be_missing() {
        let message = image("mono8", (2, 2), 4, &[1, 2, 0, 0, 3, 4]);
        assert_eq!(rgb_from_image(&message).unwrap().pixels(), [[1; 3], [2; 3], [3; 3], [4; 3]]);
    }

    #[test]
    fn depth_encodings_and_byte_orders() {
        let mut message = image("16UC1", (2, 1), 4, &[0xdc, 0x05, 0, 0]);
        assert_eq!(depth_from_image(&message).unwrap().image().pixels(), [1.5, 0.0]);
        message.encoding = "mono16".into();
        message.is_bigendian = 1;
        message.data = Bytes::from_static(&[0x05, 0xdc, 0, 0]);
        assert_eq!(depth_from_image(&message).unwrap().image().pixels(), [1.5, 0.0]);
        let metres: Vec<u8> = [1.5_f32, f32::NAN].iter().flat_map(|d| d.to_le_bytes()).collect();
        assert_eq!(depth_from_image(&image("32FC1", (2, 1), 8, &metres)).unwrap().image().pixels(), [1.5, 0.0]);
    }

    #[test]
    fn lies_about_the_size_are_refused() {
        let error = |m: &sensor::Image| rgb_from_image(m).unwrap_err();
        assert!(matches!(error(&image("rgb8", (2, 2), 6, &[0; 11])), ConvertError::Data { needed: 12, got: 11 }));
        assert!(matches!(error(&image("rgb8", (2, 2), 5, &[0; 12])), ConvertError::Step { needed: 6, .. }));
        assert!(matches!(error(&image("rgb8", (0, 2), 0, &[])), ConvertError::Size { .. }));
        assert!(matches!(error(&image("rgb8", (u32::MAX, u32::MAX), u32::MAX, &[0; 9])), ConvertError::Size { .. }));
        assert!(matches!(error(&image("yuv422", (1, 1), 2, &[0; 2])), ConvertError::Encoding { .. }));
        assert!(matches!(error(&image("rgb8", (8, 8192), u32::MAX, &[0; 9])), ConvertError::Data { .. }));
    }

    #[test]
    fn images_survive_the_way_there_and_back() {
        let depth = DepthImage::from_metres(Image::from_vec(2, 1, vec![1.2346, 0.0]).unwrap());
        assert_eq!(depth_from_image(&depth_to_metres(&depth, Stamp::default(), "c")).unwrap(), depth);
        let rounded = depth_from_image(&depth_to_millimetres(&depth, Stamp::default(), "c")).unwrap();
        assert_eq!(rounded.image().pixels(), [1.235, 0.0]);
        let mut mask = Mask::empty(3, 2);
        mask.set(1, 1, true);
        assert_eq!(mask_from_image(&mask_to_image(&mask, Stamp::default(), "c")).unwrap(), mask);
    }

    proptest! {
        #[test]
        fn any_message_converts_or_is_refused(
            encoding in "(rgb8|bgra8|mono8|16UC1|32FC1|mono16|.{0,6})",
            width in prop_oneof![0_u32..20, any::<u32>()],
            height in prop_oneof![0_u32..20, any::<u32>()],
            step in prop_oneof![0_u32..80, any::<u32>()],
            is_bigendian in any::<u8>(),
            data in prop::collection::vec(any::<u8>(), 0..600),
        ) {
            let message = sensor::Image { is_bigendian, ..image(&encoding, (width, height), step, &data) };
            for size in [
                rgb_from_image(&message).map(|i| i.size()),
                depth_from_image(&message).map(|i| i.image().size()),
                mask_from_image(&message).map(|i| i.image().size()),
            ].into_iter().flatten() {
                prop_assert_eq!(size, (width as usize, height as usize));
            }
        }
    }
}
