//! What can be wrong with a sequence.

use std::path::{Path, PathBuf};

/// A sequence that cannot be read, with the file at fault.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The file system refused.
    #[error("{}: {error}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The path is neither a sequence folder nor an archive of one.
    #[error("{}: not a sequence: a folder with rgb.txt and depth.txt in TUM layout, or its .tgz, is expected", path.display())]
    NotASequence {
        /// The path given.
        path: PathBuf,
    },
    /// A line of a text file is malformed.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// `calib.yaml` does not describe a camera.
    #[error("{}: {reason}", path.display())]
    Calibration {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// No colour image has a depth image near it.
    #[error(
        "{}: none of {rgb} colour images has a depth image within {max_difference} s (offset {offset} s): \
         were both recorded with the same clock?", path.display()
    )]
    NoPairs {
        /// The sequence.
        path: PathBuf,
        /// Number of colour images.
        rgb: usize,
        /// Largest time difference allowed, seconds.
        max_difference: f64,
        /// Seconds added to the depth stamps.
        offset: f64,
    },
    /// An image cannot be read.
    #[error("{}: {reason}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Colour and depth of a frame do not belong together, or not to the camera.
    #[error("{}: {error}", path.display())]
    Frame {
        /// The image at fault.
        path: PathBuf,
        /// Why.
        error: pfd_geometry::FrameError,
    },
    /// There is no such frame.
    #[error("frame {index} of a sequence of {len}")]
    OutOfRange {
        /// Index asked for.
        index: usize,
        /// Number of frames.
        len: usize,
    },
    /// The archive holds something that is not unpacked.
    #[error("{}: entry `{entry}`: {reason}", path.display())]
    Archive {
        /// The archive.
        path: PathBuf,
        /// Its entry at fault.
        entry: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl DatasetError {
    /// Whether only one image is at fault, so that the other frames can still be used.
    pub fn concerns_one_frame(&self) -> bool {
        matches!(self, Self::Image { .. } | Self::Frame { .. })
    }

    /// For `map_err` on file operations.
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |error| Self::Io { path: path.to_owned(), error }
    }
}
