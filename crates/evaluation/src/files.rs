//! Trajectory files.

use std::path::Path;

use pfd_geometry::{StampedPose, trajectory};

use crate::EvaluationError;

/// Reads lines `stamp tx ty tz qx qy qz qw`.
///
/// # Errors
/// When the file cannot be read or a line is malformed, with its number.
pub fn read_trajectory(path: &Path) -> Result<Vec<StampedPose>, EvaluationError> {
    let text = std::fs::read_to_string(path).map_err(|error| EvaluationError::Io { path: path.to_owned(), error })?;
    trajectory::parse(&text).map_err(|error| EvaluationError::Trajectory { path: path.to_owned(), error })
}

/// Writes lines `stamp tx ty tz qx qy qz qw`.
///
/// # Errors
/// When the file cannot be written.
pub fn write_trajectory(path: &Path, poses: &[StampedPose]) -> Result<(), EvaluationError> {
    std::fs::write(path, trajectory::to_text(poses))
        .map_err(|error| EvaluationError::Io { path: path.to_owned(), error })
}
