//! Files that the nodes write: one CSV line a frame, masks, trajectories.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use pfd_geometry::{Mask, Stamp, StampedPose, trajectory};

/// Columns of `frames.csv`, as `pfd-slam run` writes them.
const HEADER: &str = "stamp,state,segmentation_ms,tracking_ms,total_ms,features,inliers,mask_fraction,objects";

/// One line of `frames.csv`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameRecord {
    /// Of the colour image.
    pub stamp: Stamp,
    /// Tracking state; empty where the node does not track.
    pub state: String,
    /// Time for segmentation; 0 where the node does not segment.
    pub segmentation_ms: f64,
    /// Time for tracking; 0 where the node does not track.
    pub tracking_ms: f64,
    /// Features outside the mask.
    pub features: u32,
    /// Features that agree with the pose.
    pub inliers: u32,
    /// Share of the image that is masked.
    pub mask_fraction: f64,
    /// Moving objects.
    pub objects: usize,
}

impl FrameRecord {
    fn line(&self) -> String {
        format!(
            "{},{},{:.3},{:.3},{:.3},{},{},{:.6},{}",
            self.stamp,
            self.state,
            self.segmentation_ms,
            self.tracking_ms,
            self.segmentation_ms + self.tracking_ms,
            self.features,
            self.inliers,
            self.mask_fraction,
            self.objects
        )
    }
}

/// Writes what the parameters ask for.
#[derive(Debug, Default)]
pub struct Recorder {
    frames: Option<(PathBuf, BufWriter<File>)>,
    masks: Option<PathBuf>,
    /// The first thing that could not be written.
    failed: Option<anyhow::Error>,
}

impl Recorder {
    /// Opens the files; an empty name means none.
    ///
    /// # Errors
    /// When a file or folder cannot be made.
    pub fn new(frames_file: &str, mask_directory: &str) -> anyhow::Result<Self> {
        let frames = named(frames_file).map(|path| {
            let mut file = BufWriter::new(create(&path)?);
            writeln!(file, "{HEADER}").with_context(|| format!("frames_file {}", path.display()))?;
            anyhow::Ok((path, file))
        });
        let masks = named(mask_directory);
        if let Some(folder) = &masks {
            std::fs::create_dir_all(folder).with_context(|| format!("mask_directory {}", folder.display()))?;
        }
        Ok(Self { frames: frames.transpose()?, masks, failed: None })
    }

    /// Adds a frame and its mask. What cannot be written is said once and again by [`Self::finish`]: it must not stop the node.
    pub fn record(&mut self, record: &FrameRecord, mask: Option<&Mask>) {
        let mask_written = mask.map_or(Ok(()), |mask| self.add_mask(record.stamp, mask));
        let row_written = self.add(record);
        for error in [mask_written, row_written].into_iter().filter_map(Result::err) {
            if self.failed.is_none() {
                tracing::error!("{error:#}: what is recorded will be incomplete");
            }
            self.failed.get_or_insert(error);
        }
    }

    fn add(&mut self, record: &FrameRecord) -> anyhow::Result<()> {
        let Some((path, file)) = &mut self.frames else { return Ok(()) };
        writeln!(file, "{}", record.line()).with_context(|| format!("frames_file {}", path.display()))
    }

    /// Saves a mask as `<stamp>.png`.
    fn add_mask(&self, stamp: Stamp, mask: &Mask) -> anyhow::Result<()> {
        let Some(folder) = &self.masks else { return Ok(()) };
        let path = folder.join(format!("{stamp}.png"));
        let (width, height) = mask.image().size();
        let (width, height) = (width as u32, height as u32);
        image::save_buffer(&path, mask.image().pixels(), width, height, image::ExtendedColorType::L8)
            .with_context(|| format!("mask_directory: {}", path.display()))
    }

    /// Writes what is still in memory.
    ///
    /// # Errors
    /// When something cannot be written now, or could not be before.
    pub fn finish(&mut self) -> anyhow::Result<()> {
        if let Some((path, file)) = &mut self.frames {
            file.flush().with_context(|| format!("frames_file {}", path.display()))?;
        }
        self.failed.take().map_or(Ok(()), Err)
    }
}

/// Writes a trajectory in TUM format.
///
/// # Errors
/// When the file cannot be written.
pub fn save_trajectory(path: &Path, poses: &[StampedPose]) -> anyhow::Result<()> {
    let mut file = create(path)?;
    file.write_all(trajectory::to_text(poses).as_bytes()).with_context(|| path.display().to_string())
}

/// A file, with the folders that lead to it.
fn create(path: &Path) -> anyhow::Result<File> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    File::create(path).with_context(|| path.display().to_string())
}

/// The path, unless it is empty.
pub fn named(path: &str) -> Option<PathBuf> {
    (!path.is_empty()).then(|| path.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_hold_what_was_added() {
        let folder = tempfile::tempdir().unwrap();
        let (frames, masks) = (folder.path().join("a/frames.csv"), folder.path().join("masks"));
        let mut recorder = Recorder::new(frames.to_str().unwrap(), masks.to_str().unwrap()).unwrap();
        let stamp = Stamp::from_nanos(1_500_000_000);
        let record = FrameRecord { stamp, state: "OK".into(), tracking_ms: 2.0, inliers: 7, ..FrameRecord::default() };
        recorder.record(&record, Some(&Mask::empty(3, 2)));
        recorder.finish().unwrap();
        let text = std::fs::read_to_string(&frames).unwrap();
        assert_eq!(text, format!("{HEADER}\n1.500000,OK,0.000,2.000,2.000,0,7,0.000000,0\n"));
        assert!(masks.join("1.500000.png").exists());
    }

    #[test]
    fn nothing_is_written_unless_asked_for() {
        let mut recorder = Recorder::new("", "").unwrap();
        recorder.record(&FrameRecord::default(), Some(&Mask::empty(1, 1)));
        recorder.finish().unwrap();
        assert!(Recorder::new("/proc/none/frames.csv", "").is_err());
    }

    #[test]
    fn a_mask_that_cannot_be_written_costs_no_row_and_is_said_in_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let (frames, masks) = (folder.path().join("frames.csv"), folder.path().join("masks"));
        let mut recorder = Recorder::new(frames.to_str().unwrap(), masks.to_str().unwrap()).unwrap();
        std::fs::remove_dir(&masks).unwrap();
        recorder.record(&FrameRecord::default(), Some(&Mask::empty(1, 1)));
        recorder.record(&FrameRecord::default(), None);
        let error = recorder.finish().unwrap_err();
        assert!(format!("{error:#}").contains("mask_directory"), "{error:#}");
        assert_eq!(std::fs::read_to_string(&frames).unwrap().lines().count(), 3);
    }
}
