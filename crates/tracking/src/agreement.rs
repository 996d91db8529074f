//! Whether what is seen agrees with the map as well as usual.

use pfd_geometry::Stamp;

/// Share of a new frame in what is usual.
const RATE: f64 = 0.05;
/// Agreement is unusual when it falls this far below what is usual.
const DROP: f64 = 0.1;
/// What stays unusual for so long has become usual, seconds.
const PATIENCE: f64 = 0.2;

/// The share of associations that agree with the refined pose, of those that agreed with the pose before it, over time. (Counted among all
/// associations it tells no more: ATE without masks +5 %, with masks the same.)
///
/// Somebody who stood in the map and starts to move takes the camera along: before a far wall, a small translation with the opposite
/// rotation explains them as well. Until their mask comes, a few frames later, only the associations that no longer agree tell.
#[derive(Clone, Debug, Default)]
pub(crate) struct Agreement {
    usual: Option<f64>,
    low_since: Option<Stamp>,
}

impl Agreement {
    /// Records the share of a frame, 0 to 1.
    pub(crate) fn observe(&mut self, stamp: Stamp, consensus: f64) {
        let usual = self.usual.get_or_insert(consensus);
        if consensus < *usual - DROP {
            self.low_since.get_or_insert(stamp);
        } else {
            self.low_since = None;
        }
        *usual += RATE * (consensus - *usual);
    }

    /// Whether agreement broke off a short time before `stamp`.
    pub(crate) fn broke_off(&self, stamp: Stamp) -> bool {
        self.low_since.is_some_and(|since| stamp.seconds_since(since) < PATIENCE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stamps at 30 Hz.
    fn at(frame: usize) -> Stamp {
        Stamp::default().offset_by(frame as f64 / 30.0)
    }

    /// In which frames after a second of `usual` agreement with `now` it has broken off.
    fn low_frames(usual: f64, now: f64, frames: usize) -> Vec<bool> {
        let mut agreement = Agreement::default();
        (0..30).for_each(|i| agreement.observe(at(i), usual));
        let mut observe = |i| {
            agreement.observe(at(i), now);
            agreement.broke_off(at(i))
        };
        (30..30 + frames).map(&mut observe).collect()
    }

    #[test]
    fn a_drop_is_noticed_at_once_and_becomes_usual() {
        let low = low_frames(0.98, 0.7, 15);
        assert_eq!(low, (0..15).map(|i| i < 6).collect::<Vec<_>>(), "a fifth of a second");
    }

    #[test]
    fn agreement_that_is_always_poor_or_varies_is_usual() {
        assert!(low_frames(0.6, 0.6, 15).iter().all(|low| !low));
        assert!(low_frames(0.9, 0.85, 15).iter().all(|low| !low));
        assert!(low_frames(0.6, 0.95, 15).iter().all(|low| !low));
    }

    #[test]
    fn one_frame_that_agrees_ends_it() {
        let mut agreement = Agreement::default();
        agreement.observe(at(0), 0.95);
        agreement.observe(at(1), 0.6);
        assert!(agreement.broke_off(at(1)));
        agreement.observe(at(2), 0.95);
        assert!(!agreement.broke_off(at(2)));
    }
}
