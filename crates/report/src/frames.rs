//! `frames.csv`: one line a frame.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::ReportError;

/// One line of `frames.csv`. Times are wall-clock milliseconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameRow {
    /// Stamp of the colour image, seconds.
    pub stamp: String,
    /// State of tracking: `NOT_INITIALIZED`, `OK`, `LOST`, `RELOCALIZED`; empty where nothing is tracked.
    pub state: String,
    /// Time for the mask.
    pub segmentation_ms: f64,
    /// Time for the pose.
    pub tracking_ms: f64,
    /// Time for both.
    pub total_ms: f64,
    /// Features found outside the mask.
    pub features: u32,
    /// Features that agree with the pose.
    pub inliers: u32,
    /// Share of the image that is masked, 0 to 1.
    pub mask_fraction: f64,
    /// Number of moving objects.
    pub objects: usize,
}

impl FrameRow {
    /// Whether the frame has a valid pose.
    pub fn is_tracked(&self) -> bool {
        matches!(self.state.as_str(), "OK" | "RELOCALIZED")
    }
}

/// Fills the segmentation columns of `frames`, written by `tracking_node`, from those of `segmentation_node` with the same stamp.
pub fn merge(frames: &mut [FrameRow], masks: &[FrameRow]) {
    let by_stamp: std::collections::HashMap<&str, &FrameRow> = masks.iter().map(|m| (m.stamp.as_str(), m)).collect();
    for frame in frames {
        if let Some(mask) = by_stamp.get(frame.stamp.as_str()) {
            frame.segmentation_ms = mask.segmentation_ms;
            frame.mask_fraction = mask.mask_fraction;
            frame.objects = mask.objects;
            frame.total_ms = frame.segmentation_ms + frame.tracking_ms;
        }
    }
}

/// Reads a table with a header line.
///
/// # Errors
/// When the file cannot be read or a line does not fit; the error names the line.
pub fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<Vec<T>, ReportError> {
    let fail = |error| ReportError::Csv { path: path.to_owned(), error };
    csv::Reader::from_path(path).map_err(fail)?.deserialize().collect::<Result<_, _>>().map_err(fail)
}

/// Writes a table with a header line.
///
/// # Errors
/// When the file cannot be written.
pub fn write<T: Serialize>(path: &Path, rows: &[T]) -> Result<(), ReportError> {
    let fail = |error| ReportError::Csv { path: path.to_owned(), error };
    let mut writer = csv::Writer::from_path(path).map_err(fail)?;
    for row in rows {
        writer.serialize(row).map_err(fail)?;
    }
    writer.flush().map_err(|error| ReportError::Io { path: path.to_owned(), error })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(stamp: &str) -> FrameRow {
        FrameRow {
            stamp: stamp.to_owned(),
            state: "OK".to_owned(),
            segmentation_ms: 0.0,
            tracking_ms: 2.0,
            total_ms: 2.0,
            features: 900,
            inliers: 300,
            mask_fraction: 0.0,
            objects: 0,
        }
    }

    #[test]
    fn the_header_is_the_documented_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.csv");
        write(&path, &[row("1.5")]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let header = "stamp,state,segmentation_ms,tracking_ms,total_ms,features,inliers,mask_fraction,objects";
        assert_eq!(text.lines().next(), Some(header));
        assert_eq!(read::<FrameRow>(&path).unwrap(), [row("1.5")]);
        std::fs::write(&path, format!("{header}\n1.5,OK,x,1,1,1,1,1,1\n")).unwrap();
        assert!(read::<FrameRow>(&path).unwrap_err().to_string().contains("line: 2"));
    }

    #[test]
    fn masks_are_merged_by_stamp() {
        let mut frames = [row("1.5"), row("2.5")];
        merge(&mut frames, &[FrameRow { segmentation_ms: 7.0, objects: 2, ..row("2.5") }]);
        assert_eq!((frames[0].total_ms, frames[1].total_ms, frames[1].objects), (2.0, 9.0, 2));
    }
}
