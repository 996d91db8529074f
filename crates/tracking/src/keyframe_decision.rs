//! When a frame becomes a keyframe.

use pfd_geometry::Stamp;

use crate::config::TrackingConfig;
use crate::image_features::ImageFeatures;
use crate::map::{KeyframeId, Map};
use crate::matching::Match;

/// A frame beside the map.
pub(crate) struct Situation<'a> {
    pub(crate) stamp: Stamp,
    /// When the camera was found again or the stream went on after a gap, if it did.
    pub(crate) resumed: Option<Stamp>,
    /// The keyframe that shares most points with the frame.
    pub(crate) reference: KeyframeId,
    pub(crate) newest: Option<KeyframeId>,
    pub(crate) features: &'a ImageFeatures,
    /// Features that agree with the map.
    pub(crate) matches: &'a [Match],
    /// Whether features on what moves were left out.
    pub(crate) is_masked: bool,
    /// Whether agreement with the map broke off a short time ago.
    pub(crate) agreement_broke_off: bool,
    /// Whether the frame shows much less of the map than those just before it.
    pub(crate) is_poor: bool,
}

/// Time without keyframes after an interruption, seconds: segmentation has to learn anew what moves, and masks nothing until then.
const QUIET: f64 = 0.2;

/// Mur-Artal and Tardós, T-RO 2017, section III-E: too little is left of the reference keyframe, or much new is in view.
pub(crate) fn is_due(map: &Map, config: &TrackingConfig, situation: &Situation<'_>) -> bool {
    let Situation { features, matches, .. } = situation;
    let Some(reference) = map.keyframe(situation.reference) else { return true };
    let newest = situation.newest.and_then(|id| map.keyframe(id));
    // Points from pixels that may move must not enter the map.
    let without_mask = !situation.is_masked && matches.len() < config.pose.min_unmasked_inliers;
    // The keyframes of a map that was loaded may be younger than the frame.
    let since =
        |stamp: Stamp| Some(situation.stamp.seconds_since(stamp)).filter(|s| *s >= 0.0).unwrap_or(f64::INFINITY);
    let too_soon = newest.is_some_and(|k| since(k.stamp) < config.mapping.min_keyframe_interval);
    let quiet = situation.resumed.is_some_and(|stamp| since(stamp) < QUIET);
    let wanted = config.mapping.wanted_points;
    // With fewer points than are wanted, a keyframe that may stand aside is better than none; with as many it can wait until it is clear
    // what the frame shows.
    let doubtful = (situation.agreement_broke_off || situation.is_poor) && matches.len() >= wanted;
    if too_soon || quiet || without_mask || doubtful {
        return false;
    }
    let of_reference = reference.observed().filter(|(_, point)| map.established(*point).is_some()).count();
    let few = (matches.len() as f64) < config.mapping.keyframe_inlier_ratio * of_reference as f64;
    let with_depth = |m: &&Match| features.measurement(m.feature).depth.is_some();
    let matched_with_depth = matches.iter().filter(with_depth).count();
    let new = features.with_depth().saturating_sub(matched_with_depth);
    few || (matched_with_depth < wanted && new > wanted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{Keyframe, MapPointId};
    use crate::residual::Measurement;
    use nalgebra::Point2;
    use pfd_geometry::Pose;

    /// Whether a frame that shows many unknown points becomes a keyframe so long after the last one, and so long after the camera was
    /// found again, seconds.
    fn due_after(seconds: f64, found_again: Option<f64>, is_masked: bool) -> bool {
        due(seconds, (found_again, is_masked), [false; 2], 0)
    }

    fn due(
        seconds: f64,
        (found_again, is_masked): (Option<f64>, bool),
        [agreement_broke_off, is_poor]: [bool; 2],
        matched: usize,
    ) -> bool {
        let measured = Measurement { pixel: Point2::new(30.0, 30.0), sigma: 1.0, depth: Some((1.0, 0.01)) };
        let mut measurements = vec![measured; 300];
        measurements.push(Measurement { depth: None, ..measured });
        let features = ImageFeatures::from_measurements((64, 64), measurements);
        let mut map = Map::default();
        let start = Stamp::from_nanos(5_000_000_000);
        let reference = map.add_keyframe(Keyframe::new(start, 0, Pose::identity(), features.clone()));
        // Matched is what has no depth, so that there is always much to gain from a keyframe.
        let matches = vec![Match { point: MapPointId::default(), feature: 300, distance: 0 }; matched];
        let stamp = start.offset_by(seconds);
        let resumed = found_again.map(|ago| stamp.offset_by(-ago));
        let situation = Situation {
            stamp,
            resumed,
            reference,
            newest: Some(reference),
            features: &features,
            matches: &matches,
            is_masked,
            agreement_broke_off,
            is_poor,
        };
        is_due(&map, &TrackingConfig::default(), &situation)
    }

    #[test]
    fn keyframes_come_at_every_third_frame_at_thirty_hertz() {
        // Stamps jitter by a millisecond or two.
        assert_eq!([0.035, 0.068, 0.098].map(|t| due_after(t, None, true)), [false, false, true]);
    }

    #[test]
    fn a_map_from_the_future_takes_keyframes() {
        assert!(due_after(-4.0, None, true));
    }

    #[test]
    fn there_are_none_just_after_an_interruption() {
        assert_eq!([0.0, 0.1, 0.25].map(|ago| due_after(1.0, Some(ago), true)), [false, false, true]);
    }

    #[test]
    fn there_are_none_while_agreement_has_just_broken_off_or_little_is_found() {
        let due = |doubts, matched| due(1.0, (None, true), doubts, matched);
        assert!(due([false; 2], 160));
        for doubts in [[true, false], [false, true]] {
            assert!(!due(doubts, 160));
            assert_eq!(
                [due(doubts, 100), due(doubts, 99)],
                [false, true],
                "rather a doubtful keyframe than to be lost"
            );
        }
    }

    #[test]
    fn a_frame_whose_mask_was_given_up_for_want_of_points_is_no_keyframe() {
        assert!(!due_after(1.0, None, false));
    }
}
