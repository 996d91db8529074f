//! `rgb.txt` and `depth.txt`: which image was taken when.

use std::path::{Path, PathBuf};

use pfd_geometry::Stamp;

use crate::DatasetError;

/// One line of the list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListedImage {
    /// When the image was taken.
    pub stamp: Stamp,
    /// The file, relative to the sequence.
    pub path: PathBuf,
}

/// Reads a list file.
///
/// # Errors
/// When the file cannot be read, or [`parse`] refuses its text.
pub fn read(path: &Path) -> Result<Vec<ListedImage>, DatasetError> {
    let text = std::fs::read_to_string(path).map_err(DatasetError::io(path))?;
    parse(&text).map_err(|(line, reason)| DatasetError::Line { path: path.to_owned(), line, reason })
}

/// Parses lines `stamp file`, sorted by stamp; empty lines and comments (`#`) are skipped.
///
/// # Errors
/// Line number (from 1) and reason for a line that is malformed or not later than the one before.
pub fn parse(text: &str) -> Result<Vec<ListedImage>, (usize, String)> {
    let mut images: Vec<ListedImage> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let image = parse_line(line).map_err(|reason| (index + 1, reason))?;
        if let Some(last) = images.last().filter(|last| last.stamp >= image.stamp) {
            let reason = format!("stamp {} is not later than the one before, {}", image.stamp, last.stamp);
            return Err((index + 1, reason));
        }
        images.push(image);
    }
    Ok(images)
}

fn parse_line(line: &str) -> Result<ListedImage, String> {
    let (stamp, path) = line.split_once(char::is_whitespace).ok_or("`stamp file` expected")?;
    let stamp = stamp.parse().map_err(|e| format!("{e}"))?;
    Ok(ListedImage { stamp, path: PathBuf::from(path.trim()) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reads_the_benchmarks_files() {
        let text = "# color images\n# file: 'x.bag'\n1305031102.175304 rgb/1305031102.175304.png\n1305031102.211214 rgb/b.png\n";
        let images = parse(text).unwrap();
        assert_eq!(images.len(), 2);
        assert_eq!(images[0].stamp.as_nanos(), 1_305_031_102_175_304_000);
        assert_eq!(images[1].path, PathBuf::from("rgb/b.png"));
    }

    #[test]
    fn names_the_line() {
        assert_eq!(parse("1.0 a.png\n\n0.5 b.png\n").unwrap_err().0, 3);
        assert_eq!(parse("1.0 a.png\n1.0 b.png\n").unwrap_err().0, 2);
        assert_eq!(parse("1.0\n").unwrap_err(), (1, "`stamp file` expected".to_owned()));
        assert!(parse("# c\nabc a.png\n").unwrap_err().1.contains("not a time stamp"));
    }

    proptest! {
        #[test]
        fn any_text_parses_or_is_refused(text in "([0-9a-z./# \n-]{0,12}){0,12}") {
            if let Ok(images) = parse(&text) {
                prop_assert!(images.windows(2).all(|w| w[0].stamp < w[1].stamp));
            }
        }
    }
}
