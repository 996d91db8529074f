//! When a frame becomes a keyframe.

use pfd_geometry::Stamp;

use crate::config::TrackingConfig;
use crate::image_features::ImageFeatures;
use crate::map::{KeyframeId, Map};
use crate::matching::Match;

/// A frame beside the map.
pub(crate) struct Situation<'a> {
    pub(crate) stamp: Stamp,
    /// The keyframe that shares most points with the frame.
    pub(crate) reference: KeyframeId,
    pub(crate) newest: Option<KeyframeId>,
    pub(crate) features: &'a ImageFeatures,
    /// Features that agree with the map.
    pub(crate) matches: &'a [Match],
    /// Whether features on what moves were left out.
    pub(crate) is_masked: bool,
}

/// Mur-Artal and Tardós, T-RO 2017, section III-E: too little is left of the reference keyframe, or much new is in view.
pub(crate) fn is_due(map: &Map, config: &TrackingConfig, situation: &Situation<'_>) -> bool {
    let Situation { features, matches, .. } = situation;
    let Some(reference) = map.keyframe(situation.reference) else { return true };
    let newest = situation.newest.and_then(|id| map.keyframe(id));
    // Points from pixels that may move must not enter the map.
    let without_mask = !situation.is_masked && matches.len() < config.pose.min_unmasked_inliers;
    let elapsed = newest.map_or(f64::INFINITY, |k| situation.stamp.seconds_since(k.stamp));
    if elapsed < config.mapping.min_keyframe_interval || without_mask {
        return false;
    }
    let of_reference = reference.observed().filter(|(_, point)| map.established(*point).is_some()).count();
    let few = (matches.len() as f64) < config.mapping.keyframe_inlier_ratio * of_reference as f64;
    let with_depth = |m: &&Match| features.measurement(m.feature).depth.is_some();
    let matched_with_depth = matches.iter().filter(with_depth).count();
    let new = features.with_depth().saturating_sub(matched_with_depth);
    let wanted = config.mapping.wanted_points;
    few || (matched_with_depth < wanted && new > wanted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::Keyframe;
    use crate::residual::Measurement;
    use nalgebra::Point2;
    use pfd_geometry::Pose;

    /// Whether a frame that shows many unknown points becomes a keyframe so long after the last one, seconds.
    fn due_after(seconds: f64, is_masked: bool) -> bool {
        let measured = Measurement { pixel: Point2::new(30.0, 30.0), sigma: 1.0, depth: Some((1.0, 0.01)) };
        let features = ImageFeatures::from_measurements((64, 64), vec![measured; 300]);
        let mut map = Map::default();
        let start = Stamp::from_nanos(5_000_000_000);
        let reference = map.add_keyframe(Keyframe::new(start, 0, Pose::identity(), features.clone()));
        let stamp = start.offset_by(seconds);
        let situation =
            Situation { stamp, reference, newest: Some(reference), features: &features, matches: &[], is_masked };
        is_due(&map, &TrackingConfig::default(), &situation)
    }

    #[test]
    fn keyframes_come_at_every_third_frame_at_thirty_hertz_and_at_every_frame_at_ten() {
        assert_eq!([1.0 / 30.0, 2.0 / 30.0, 3.0 / 30.0].map(|t| due_after(t, true)), [false, false, true]);
    }

    #[test]
    fn a_frame_whose_mask_was_given_up_for_want_of_points_is_no_keyframe() {
        assert!(!due_after(1.0, false));
    }
}
