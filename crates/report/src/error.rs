//! Why a report could not be made.

use std::path::{Path, PathBuf};

/// A report that could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The file system refused.
    #[error("{}: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A line of a table is malformed.
    #[error("{}: {error}", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// Line and reason.
        error: csv::Error,
    },
    /// A plot could not be drawn.
    #[error("plot `{title}`: {reason}")]
    Plot {
        /// Title of the plot.
        title: String,
        /// Why.
        reason: String,
    },
    /// An image could not be encoded.
    #[error("sample image")]
    Image(#[from] image::ImageError),
    /// The lines between which a summary belongs are missing.
    #[error("no lines `{begin}` and `{end}` to put the summary between")]
    Markers {
        /// The line before the summary.
        begin: &'static str,
        /// The line after it.
        end: &'static str,
    },
    /// A value has no JSON form.
    #[error("{}: {error}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Why.
        error: serde_json::Error,
    },
}

/// Writes a file.
///
/// # Errors
/// When the file system refuses.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<(), ReportError> {
    std::fs::write(path, content).map_err(|error| ReportError::Io { path: path.to_owned(), error })
}

/// Removes a file, where there is one.
pub(crate) fn remove(path: &Path) -> Result<(), ReportError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(ReportError::Io { path: path.to_owned(), error })
        }
        _ => Ok(()),
    }
}
