//! Relative pose error.

use pfd_geometry::{Pose, Stamp, StampedPose, association};

use crate::ate::stamps;
use crate::statistics::quantile;
use crate::{MAX_TIME_DIFFERENCE, Statistics};

/// Result of [`rpe`].
#[derive(Clone, Debug, PartialEq)]
pub struct Rpe {
    /// Translational drift as the benchmark's `evaluate_rpe.py` composes it, metres per `delta`.
    pub translation: Statistics,
    /// Translational drift as the equation has it, and evo: in the frame of the end instead of the start of the interval.
    pub translation_evo: Statistics,
    /// Rotational drift, degrees per `delta`.
    pub rotation_deg: Statistics,
    /// The single errors, by time.
    pub pairs: Vec<RpePair>,
}

/// Drift over one interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RpePair {
    /// Stamp of the first estimated pose of the interval.
    pub start: Stamp,
    /// Metres, as the benchmark's script composes it.
    pub translation: f64,
    /// Metres, as evo composes it.
    pub translation_evo: f64,
    /// Degrees.
    pub rotation_deg: f64,
}

/// Relative pose error over intervals of `delta` seconds (Sturm et al., IROS 2012, eq. 2); `None` when there is no interval.
///
/// The intervals are those of `evaluate_rpe.py --fixed_delta --delta_unit s`: each estimated pose is paired with the estimated
/// pose nearest to `delta` later, unless that is the last one (beyond the end every pose would be paired with the last). Both
/// are compared with the ground truth nearest in time; intervals without ground truth near both ends are left out. Near is
/// within twice the ground truth's usual interval, as in that tool, and within 0.02 s. Of poses with the same stamp the last
/// counts.
pub fn rpe(ground_truth: &[StampedPose], estimate: &[StampedPose], delta: f64) -> Option<Rpe> {
    let (truth, estimate) = (last_of_equal(ground_truth), last_of_equal(estimate));
    let (truth_stamps, stamps) = (stamps(&truth), stamps(&estimate));
    let limit = nearness(&truth_stamps);
    let truth_at = |stamp: Stamp| {
        let nearest = &truth[association::nearest_index(&truth_stamps, stamp)?];
        (nearest.stamp.seconds_since(stamp).abs() <= limit).then_some(nearest.pose)
    };
    let pair = |first: &StampedPose| {
        let end = association::nearest_index(&stamps, first.stamp.offset_by(delta))?;
        let second = (end + 1 < estimate.len()).then(|| estimate[end])?;
        let true_motion = relative(&truth_at(second.stamp)?, &truth_at(first.stamp)?);
        let motion = relative(&second.pose, &first.pose);
        let error = relative(&motion, &true_motion);
        Some(RpePair {
            start: first.stamp,
            translation: error.translation.vector.norm(),
            translation_evo: (true_motion * motion.inverse()).translation.vector.norm(),
            rotation_deg: error.rotation.angle().to_degrees(),
        })
    };
    let pairs: Vec<RpePair> = estimate.iter().filter_map(pair).collect();
    Some(Rpe {
        translation: Statistics::of(pairs.iter().map(|p| p.translation))?,
        translation_evo: Statistics::of(pairs.iter().map(|p| p.translation_evo))?,
        rotation_deg: Statistics::of(pairs.iter().map(|p| p.rotation_deg))?,
        pairs,
    })
}

/// Largest time (seconds) between a pose and its ground truth.
fn nearness(truth: &[Stamp]) -> f64 {
    let intervals: Vec<f64> = truth.windows(2).map(|w| w[1].seconds_since(w[0])).collect();
    quantile(&intervals, 0.5).map_or(MAX_TIME_DIFFERENCE, |median| MAX_TIME_DIFFERENCE.min(2.0 * median))
}

fn last_of_equal(poses: &[StampedPose]) -> Vec<StampedPose> {
    let is_last = |i: usize| poses.get(i + 1).is_none_or(|next| next.stamp != poses[i].stamp);
    poses.iter().enumerate().filter(|&(i, _)| is_last(i)).map(|(_, pose)| *pose).collect()
}

/// Pose of `b` as seen from `a`, both in the same world.
fn relative(a: &Pose, b: &Pose) -> Pose {
    a.inverse() * b
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// Moves along x with `speed` m/s and turns about z with `turn` rad/s, for 3 s at 10 Hz.
    fn drive(speed: f64, turn: f64) -> Vec<StampedPose> {
        let pose = |i: i64| {
            let t = i as f64 * 0.1;
            let pose = Pose::new(Vector3::new(speed * t, 0.0, 0.0), Vector3::new(0.0, 0.0, turn * t));
            StampedPose { stamp: Stamp::from_nanos(i * 100_000_000), pose }
        };
        (0..30).map(pose).collect()
    }

    #[test]
    fn drift_is_measured_per_second() {
        let result = rpe(&drive(1.0, 0.0), &drive(1.1, 0.0), 1.0).unwrap();
        assert!((result.translation.rmse - 0.1).abs() < 1e-9);
        assert!(result.rotation_deg.max < 1e-6);
        let result = rpe(&drive(0.0, 0.0), &drive(0.0, 0.02), 1.0).unwrap();
        assert!((result.rotation_deg.mean - 0.02_f64.to_degrees()).abs() < 1e-9);
        // The last 11 poses have no partner but the last one.
        assert_eq!(result.pairs.len(), 19);
    }

    #[test]
    fn a_short_trajectory_has_no_interval() {
        assert!(rpe(&drive(1.0, 0.0), &drive(1.0, 0.0)[..5], 1.0).is_none());
        assert!(rpe(&[], &drive(1.0, 0.0), 1.0).is_none());
    }
}
