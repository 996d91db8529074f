//! `report.json`: the figures of one run.

use std::path::Path;

use pfd_evaluation::statistics::quantile;
use pfd_evaluation::{EvaluationError, Rpe, Statistics, ate, rpe};
use pfd_geometry::StampedPose;
use serde::{Deserialize, Serialize};

use crate::{FrameRow, ReportError};

/// The interval of the relative error, seconds: drift is stated per second.
pub const RPE_INTERVAL: f64 = 1.0;

/// What a report says where it has no errors to state.
pub const NO_ERRORS: &str = "No errors to state: no ground truth, or too few poses beside it";

/// Content of `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the sequence.
    pub sequence: String,
    /// Frames processed.
    pub frames: usize,
    /// Share of the frames with a valid pose.
    pub tracked: f64,
    /// Frames left out because an image could not be read, or was not of the camera's size.
    #[serde(default)]
    pub skipped: usize,
    /// Colour images left out because no depth image is near.
    #[serde(default)]
    pub unpaired: usize,
    /// Errors of `trajectory.txt`, metres; `null` without ground truth.
    pub ate: Option<Statistics>,
    /// Errors of the poses as they were while running, metres.
    #[serde(default)]
    pub ate_live: Option<Statistics>,
    /// Drift, metres per second.
    pub rpe_translation: Option<Statistics>,
    /// Drift, degrees per second.
    pub rpe_rotation_deg: Option<Statistics>,
    /// Time per frame.
    pub timing_ms: Timing,
    /// Time per stage, in the order in which they run.
    #[serde(default)]
    pub stages_ms: Vec<StageTiming>,
    /// Keyframes of the map at the end; `null` where only the files of the nodes are known.
    #[serde(default)]
    pub keyframes: Option<usize>,
    /// Points of the map at the end; `null` where only the files of the nodes are known.
    #[serde(default)]
    pub map_points: Option<usize>,
    /// How moving things were found.
    pub mode: String,
    /// Seed of all random choices.
    pub seed: u64,
    /// The effective configuration.
    pub config: serde_json::Value,
}

/// Time per frame, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// For the mask.
    pub segmentation: Percentiles,
    /// For the pose.
    pub tracking: Percentiles,
    /// For both.
    pub total: Percentiles,
}

/// Time of a named stage, milliseconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageTiming {
    /// Name of the stage.
    pub stage: String,
    /// Over the frames in which it ran.
    #[serde(flatten)]
    pub percentiles: Percentiles,
}

/// Median and extremes of a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Half of the frames are faster.
    pub median: f64,
    /// Mean.
    pub mean: f64,
    /// 99 of 100 frames are faster.
    pub p99: f64,
    /// The slowest.
    pub max: f64,
}

impl Percentiles {
    /// Summarises times; zeros for an empty list.
    pub fn of(times: &[f64]) -> Self {
        let at = |q| quantile(times, q).unwrap_or_default();
        let mean = times.iter().sum::<f64>() / times.len().max(1) as f64;
        Self { median: at(0.5), mean, p99: at(0.99), max: at(1.0) }
    }
}

impl Summary {
    /// What follows mode and seed in a text: whether they are those of the run.
    pub fn settings_note(&self) -> &'static str {
        // The files of the nodes tell neither their configuration nor the size of their map.
        if self.keyframes.is_some() { "" } else { " (as given to `report`)" }
    }
}

impl Timing {
    /// Summarises the times of all frames.
    pub fn of(frames: &[FrameRow]) -> Self {
        let of = |time: fn(&FrameRow) -> f64| Percentiles::of(&frames.iter().map(time).collect::<Vec<_>>());
        Self { segmentation: of(|f| f.segmentation_ms), tracking: of(|f| f.tracking_ms), total: of(|f| f.total_ms) }
    }
}

/// Errors of a trajectory, where there is ground truth.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// Absolute.
    pub ate: Option<pfd_evaluation::Ate>,
    /// Relative, per second.
    pub rpe: Option<Rpe>,
}

impl Errors {
    /// Compares with the ground truth. A trajectory too short to compare has no errors.
    pub fn of(ground_truth: Option<&[StampedPose]>, trajectory: &[StampedPose]) -> Self {
        let Some(truth) = ground_truth else { return Self::default() };
        let absolute: Result<_, EvaluationError> = ate(truth, trajectory);
        Self { ate: absolute.ok(), rpe: rpe(truth, trajectory, RPE_INTERVAL) }
    }
}

impl Summary {
    /// Writes `report.json`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let json =
            serde_json::to_string_pretty(self).map_err(|error| ReportError::Json { path: path.to_owned(), error })?;
        crate::error::write(path, json + "\n")
    }

    /// Reads `report.json`.
    ///
    /// # Errors
    /// When the file cannot be read or is no report.
    pub fn read(path: &Path) -> Result<Self, ReportError> {
        let text = std::fs::read_to_string(path).map_err(|error| ReportError::Io { path: path.to_owned(), error })?;
        serde_json::from_str(&text).map_err(|error| ReportError::Json { path: path.to_owned(), error })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_by_hand() {
        let p = Percentiles::of(&[1.0, 2.0, 3.0, 4.0, 100.0]);
        assert_eq!((p.median, p.mean, p.max), (3.0, 22.0, 100.0));
        assert_eq!(Percentiles::of(&[]), Percentiles::default());
    }

    #[test]
    fn without_ground_truth_there_are_no_errors() {
        let errors = Errors::of(None, &[]);
        assert!(errors.ate.is_none() && errors.rpe.is_none());
        assert!(Errors::of(Some(&[]), &[]).ate.is_none());
    }
}
