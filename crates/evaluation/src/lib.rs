//! How good a trajectory or a mask is.
//!
//! * [`ate()`]: absolute trajectory error after rigid alignment, without scale (Sturm et al., IROS 2012, eq. 3).
//! * [`rpe()`]: relative pose error per second (Sturm et al., eq. 2).
//! * [`masks`]: precision, recall, intersection over union of motion masks.
//!
//! Trajectories are `T_world_camera`; the worlds of ground truth and estimate may differ.

pub use pfd_geometry::alignment;
pub mod ate;
pub mod files;
pub mod masks;
pub mod rpe;
pub mod statistics;

pub use ate::{Ate, ate};
pub use files::{read_trajectory, write_trajectory};
pub use masks::{MaskScore, MaskSummary};
pub use rpe::{Rpe, rpe};
pub use statistics::Statistics;

/// Poses farther apart in time than this (seconds) are not compared, as in the benchmark's tools.
pub const MAX_TIME_DIFFERENCE: f64 = 0.02;

/// Why there is no figure.
#[derive(Debug, thiserror::Error)]
pub enum EvaluationError {
    /// The file system refused.
    #[error("{}: {error}", path.display())]
    Io {
        /// The file.
        path: std::path::PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A trajectory file is malformed.
    #[error("{}:{}: {}", path.display(), error.line, error.reason)]
    Trajectory {
        /// The file.
        path: std::path::PathBuf,
        /// Line and reason.
        error: pfd_geometry::TrajectoryError,
    },
    /// Too few poses of both trajectories are close in time.
    #[error(
        "only {pairs} poses of {estimate} have one of {ground_truth} ground-truth poses within {max_difference} s: \
             are both files from the same recording?"
    )]
    TooFewPairs {
        /// Pairs found.
        pairs: usize,
        /// Poses in the estimate.
        estimate: usize,
        /// Poses in the ground truth.
        ground_truth: usize,
        /// Largest time difference allowed, seconds.
        max_difference: f64,
    },
    /// Two masks to be compared differ in size.
    #[error("the mask is {}x{}, the ground truth {}x{}", mask.0, mask.1, ground_truth.0, ground_truth.1)]
    MaskSize {
        /// Columns and rows.
        mask: (usize, usize),
        /// Columns and rows.
        ground_truth: (usize, usize),
    },
    /// A ground-truth mask has a value that means nothing.
    #[error(
        "the ground truth is {value} at column {column}, row {row}: 255 (moving), 128 (ignored) and 0 (static) are known"
    )]
    TruthValue {
        /// The value.
        value: u8,
        /// Column of the first such pixel, from 0.
        column: usize,
        /// Its row, from 0.
        row: usize,
    },
}
