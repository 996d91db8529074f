//! Absolute trajectory error.

use nalgebra::Point3;
use pfd_geometry::{Pose, Stamp, StampedPose, association};

use crate::{EvaluationError, MAX_TIME_DIFFERENCE, Statistics, alignment};

/// Result of [`ate`].
#[derive(Clone, Debug, PartialEq)]
pub struct Ate {
    /// Distances between ground truth and aligned estimate, metres.
    pub statistics: Statistics,
    /// `T_groundtruth_estimate`: world of the estimate to world of the ground truth.
    pub alignment: Pose,
    /// Compared poses, by time.
    pub pairs: Vec<AtePair>,
}

/// Two compared positions, both in the world of the ground truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtePair {
    /// Stamp of the estimated pose.
    pub stamp: Stamp,
    /// Ground truth, metres.
    pub ground_truth: Point3<f64>,
    /// Aligned estimate, metres.
    pub estimate: Point3<f64>,
}

impl AtePair {
    /// Distance, metres.
    pub fn error(&self) -> f64 {
        (self.ground_truth - self.estimate).norm()
    }
}

/// Absolute trajectory error (Sturm et al., IROS 2012, eq. 3): SE(3) alignment without scale, then distances.
///
/// Each pose of the trajectory with fewer poses is compared with the nearest in time of the other, within 0.02 s (as evo does;
/// the benchmark's `evaluate_ate.py` uses each pose at most once, which differs only where poses are denser than ground truth).
///
/// # Errors
/// [`EvaluationError::TooFewPairs`] with fewer than three pairs.
pub fn ate(ground_truth: &[StampedPose], estimate: &[StampedPose]) -> Result<Ate, EvaluationError> {
    let indices = pair_up(&stamps(ground_truth), &stamps(estimate));
    let position = |pose: &StampedPose| Point3::from(pose.pose.translation.vector);
    let points: Vec<_> = indices.iter().map(|&(i, j)| (position(&ground_truth[i]), position(&estimate[j]))).collect();
    let too_few = || EvaluationError::TooFewPairs {
        pairs: points.len(),
        estimate: estimate.len(),
        ground_truth: ground_truth.len(),
        max_difference: MAX_TIME_DIFFERENCE,
    };
    let alignment = alignment::align(&points).ok_or_else(too_few)?;
    let pairs: Vec<AtePair> = indices
        .iter()
        .zip(&points)
        .map(|(&(_, j), (a, b))| AtePair { stamp: estimate[j].stamp, ground_truth: *a, estimate: alignment * b })
        .collect();
    let statistics = Statistics::of(pairs.iter().map(AtePair::error)).ok_or_else(too_few)?;
    Ok(Ate { statistics, alignment, pairs })
}

/// Pairs of indices into ground truth and estimate.
fn pair_up(ground_truth: &[Stamp], estimate: &[Stamp]) -> Vec<(usize, usize)> {
    if estimate.len() <= ground_truth.len() {
        let pairs = association::nearest(estimate, ground_truth, MAX_TIME_DIFFERENCE);
        pairs.into_iter().map(|(j, i)| (i, j)).collect()
    } else {
        association::nearest(ground_truth, estimate, MAX_TIME_DIFFERENCE)
    }
}

pub(crate) fn stamps(poses: &[StampedPose]) -> Vec<Stamp> {
    poses.iter().map(|p| p.stamp).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn circle(stretch: f64) -> Vec<StampedPose> {
        let pose = |i: i64| {
            let angle = i as f64 * 0.1;
            let position = Vector3::new(angle.cos() * stretch, angle.sin(), 0.3 * angle);
            StampedPose { stamp: Stamp::from_nanos(i * 33_000_000), pose: Pose::new(position, Vector3::zeros()) }
        };
        (0..60).map(pose).collect()
    }

    #[test]
    fn another_world_frame_is_no_error() {
        let motion = Pose::new(Vector3::new(4.0, -1.0, 2.0), Vector3::new(0.3, 1.0, -0.4));
        let moved: Vec<_> = circle(1.0).iter().map(|p| StampedPose { pose: motion * p.pose, ..*p }).collect();
        let result = ate(&circle(1.0), &moved).unwrap();
        assert!(result.statistics.max < 1e-9);
        assert_eq!(result.statistics.pairs, 60);
        assert!((result.alignment * motion).translation.vector.norm() < 1e-9);
    }

    #[test]
    fn scale_is_an_error() {
        assert!(ate(&circle(1.0), &circle(1.5)).unwrap().statistics.rmse > 0.1);
    }

    #[test]
    fn different_recordings_are_refused() {
        let later: Vec<_> = circle(1.0).iter().map(|p| StampedPose { stamp: p.stamp.offset_by(100.0), ..*p }).collect();
        let error = ate(&circle(1.0), &later).unwrap_err();
        assert!(error.to_string().contains("only 0 poses of 60"), "{error}");
    }
}
