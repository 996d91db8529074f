//! Motion JPEG in an AVI container (RIFF, "AVI RIFF File Reference"): plays everywhere and needs no codec library.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use image::codecs::jpeg::JpegEncoder;

use crate::ReportError;

const JPEG_QUALITY: u8 = 85;
/// Bytes of everything before the first frame.
const HEADER_SIZE: u32 = 224;
/// Offsets of the fields that are known only at the end.
const RIFF_SIZE_AT: u64 = 4;
const FRAMES_AT: u64 = 48;
const STREAM_FRAMES_AT: u64 = 140;
const MOVI_SIZE_AT: u64 = 216;
/// The index holds 32-bit offsets.
const MAX_BYTES: u64 = (1 << 31) - (1 << 24);
/// Flags of the format: the file has an index; the frame stands alone.
const HAS_INDEX: u32 = 0x10;
const KEY_FRAME: u32 = 0x10;

/// A video that is being written.
#[derive(Debug)]
pub struct Video {
    path: PathBuf,
    file: BufWriter<File>,
    size: (u32, u32),
    /// Offset (from the start of the list of frames) and length of each frame.
    index: Vec<(u32, u32)>,
    /// Bytes of the list of frames, its name included.
    movi: u32,
}

impl Video {
    /// Begins a video of frames of `size` (columns, rows).
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn create(path: &Path, size: (u32, u32), frames_per_second: f64) -> Result<Self, ReportError> {
        let begin = || -> io::Result<BufWriter<File>> {
            let mut file = BufWriter::new(File::create(path)?);
            file.write_all(&header(size, frames_per_second))?;
            Ok(file)
        };
        let file = begin().map_err(|error| ReportError::Io { path: path.to_owned(), error })?;
        Ok(Self { path: path.to_owned(), file, size, index: Vec::new(), movi: 4 })
    }

    /// Adds a frame. Frames of another size, and frames beyond 2 GB, are left out.
    ///
    /// # Errors
    /// When the frame cannot be encoded or written.
    pub fn add(&mut self, frame: &image::RgbImage) -> Result<(), ReportError> {
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY).encode_image(frame)?;
        let length = jpeg.len() as u32;
        // Chunks begin at even offsets.
        jpeg.resize(jpeg.len().next_multiple_of(2), 0);
        if frame.dimensions() != self.size || u64::from(self.movi) + jpeg.len() as u64 > MAX_BYTES {
            return Ok(());
        }
        let mut chunk = [b"00dc".as_slice(), &length.to_le_bytes()].concat();
        chunk.append(&mut jpeg);
        self.file.write_all(&chunk).map_err(|error| ReportError::Io { path: self.path.clone(), error })?;
        self.index.push((self.movi, length));
        self.movi += chunk.len() as u32;
        Ok(())
    }

    /// Writes the index and completes the header.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(mut self) -> Result<(), ReportError> {
        self.complete().map_err(|error| ReportError::Io { path: self.path.clone(), error })
    }

    fn complete(&mut self) -> io::Result<()> {
        let frames = self.index.len() as u32;
        self.file.write_all(b"idx1")?;
        self.file.write_all(&(16 * frames).to_le_bytes())?;
        for (offset, length) in &self.index {
            self.file.write_all(b"00dc")?;
            for field in [KEY_FRAME, *offset, *length] {
                self.file.write_all(&field.to_le_bytes())?;
            }
        }
        let riff = HEADER_SIZE - 8 + (self.movi - 4) + 8 + 16 * frames;
        let fields = [(RIFF_SIZE_AT, riff), (FRAMES_AT, frames), (STREAM_FRAMES_AT, frames), (MOVI_SIZE_AT, self.movi)];
        for (offset, value) in fields {
            self.file.seek(SeekFrom::Start(offset))?;
            self.file.write_all(&value.to_le_bytes())?;
        }
        self.file.flush()
    }
}

/// Main header, stream header and format; sizes and numbers of frames are filled in at the end.
fn header((width, height): (u32, u32), frames_per_second: f64) -> Vec<u8> {
    const MICROSECONDS: f64 = 1e6;
    const RATE_SCALE: u32 = 1000;
    let rate = (frames_per_second * f64::from(RATE_SCALE)) as u32;
    let pixels = width * height;
    let mut h = Vec::with_capacity(HEADER_SIZE as usize);
    let text = |h: &mut Vec<u8>, text: &[u8; 4]| h.extend_from_slice(text);
    let numbers = |h: &mut Vec<u8>, values: &[u32]| values.iter().for_each(|v| h.extend_from_slice(&v.to_le_bytes()));
    text(&mut h, b"RIFF");
    numbers(&mut h, &[0]);
    text(&mut h, b"AVI ");
    text(&mut h, b"LIST");
    numbers(&mut h, &[192]);
    text(&mut h, b"hdrl");
    text(&mut h, b"avih");
    let interval = (MICROSECONDS / frames_per_second) as u32;
    numbers(&mut h, &[56, interval, 0, 0, HAS_INDEX, 0, 0, 1, 3 * pixels, width, height, 0, 0, 0, 0]);
    text(&mut h, b"LIST");
    numbers(&mut h, &[116]);
    text(&mut h, b"strl");
    text(&mut h, b"strh");
    numbers(&mut h, &[56]);
    text(&mut h, b"vids");
    text(&mut h, b"MJPG");
    let frame = (height << 16) | (width & 0xffff);
    numbers(&mut h, &[0, 0, 0, RATE_SCALE, rate, 0, 0, 3 * pixels, u32::MAX, 0, 0, frame]);
    text(&mut h, b"strf");
    // One plane of 24 bits per pixel.
    numbers(&mut h, &[40, 40, width, height, (24 << 16) | 1]);
    text(&mut h, b"MJPG");
    numbers(&mut h, &[3 * pixels, 0, 0, 0, 0]);
    text(&mut h, b"LIST");
    numbers(&mut h, &[0]);
    text(&mut h, b"movi");
    h
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(bytes: &[u8], at: u64) -> u32 {
        u32::from_le_bytes(bytes[at as usize..at as usize + 4].try_into().unwrap())
    }

    #[test]
    fn sizes_and_index_fit_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.avi");
        let mut video = Video::create(&path, (32, 16), 30.0).unwrap();
        for value in 0..3 {
            video.add(&image::RgbImage::from_pixel(32, 16, image::Rgb([80 * value, 0, 0]))).unwrap();
        }
        video.add(&image::RgbImage::new(8, 8)).unwrap();
        video.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(number(&bytes, RIFF_SIZE_AT) as usize, bytes.len() - 8);
        assert_eq!((number(&bytes, FRAMES_AT), number(&bytes, STREAM_FRAMES_AT)), (3, 3));
        assert_eq!(&bytes[220..224], b"movi");
        let index = MOVI_SIZE_AT + 4 + u64::from(number(&bytes, MOVI_SIZE_AT));
        assert_eq!(&bytes[index as usize..index as usize + 4], b"idx1");
        for frame in 0..3 {
            let entry = index + 8 + 16 * frame;
            let chunk = MOVI_SIZE_AT + 4 + u64::from(number(&bytes, entry + 8));
            assert_eq!(&bytes[chunk as usize..chunk as usize + 4], b"00dc");
            assert_eq!(bytes[chunk as usize + 8..chunk as usize + 10], [0xff, 0xd8]);
        }
    }
}
