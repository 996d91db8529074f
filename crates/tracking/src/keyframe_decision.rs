//! When a frame becomes a keyframe.

use crate::config::TrackingConfig;
use crate::image_features::ImageFeatures;
use crate::map::{KeyframeId, Map};
use crate::matching::Match;

/// A frame beside the map.
pub(crate) struct Situation<'a> {
    pub(crate) frame_index: usize,
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
    let gap = newest.map_or(usize::MAX, |k| situation.frame_index.saturating_sub(k.frame_index));
    // Points from pixels that may move must not enter the map.
    let without_mask = !situation.is_masked && matches.len() < config.pose.min_unmasked_inliers;
    if gap < config.mapping.min_keyframe_gap || without_mask {
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
