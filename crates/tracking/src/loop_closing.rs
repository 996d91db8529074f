//! Recognising a place that was seen long ago, and correcting the map (Mur-Artal et al., T-RO 2015, section VII).

use std::collections::BTreeMap;

use pfd_geometry::{Camera, Pose, pose};
use rand_pcg::Pcg32;

use crate::config::TrackingConfig;
use crate::local_mapping;
use crate::localization::{Localized, Localizer};
use crate::map::{KeyframeId, Map};
use crate::places::PlaceIndex;
use crate::pose_graph::{Edge, PoseGraph};
use crate::segments::Segments;

/// A place seen twice.
#[derive(Clone, Debug)]
#[allow(non_snake_case)]
pub(crate) struct Loop {
    /// The new keyframe.
    pub(crate) current: KeyframeId,
    /// The keyframe that shows the same place.
    pub(crate) earlier: KeyframeId,
    /// Pose of the new keyframe by the map around the earlier one.
    T_camera_world: Pose,
}

/// Candidates that are checked for each keyframe.
const CANDIDATES: usize = 3;
/// Shared points that make two keyframes neighbours in the pose graph (the essential graph of the paper).
const ESSENTIAL_POINTS: usize = 50;
/// Neighbours of both ends whose points are fused.
const FUSED_NEIGHBOURS: usize = 8;
/// Weight of the closing edge, in shared points, beside its inliers: it replaces many weak links.
const CLOSING_WEIGHT: f64 = 2.0;

/// Where earlier visits are looked for.
#[derive(Clone, Copy)]
pub(crate) struct Search<'a> {
    /// What places look like.
    pub(crate) places: &'a PlaceIndex,
    /// Keyframes in the order of their creation.
    pub(crate) order: &'a [KeyframeId],
    /// Parts of the map that are not joined yet.
    pub(crate) segments: &'a Segments,
}

/// Looks for an earlier visit of the place that `current` shows, among keyframes that share no points with it: old ones of its own
/// segment, and all of other segments.
pub(crate) fn detect(
    localizer: &Localizer<'_>,
    search: &Search<'_>,
    current: KeyframeId,
    rng: &mut Pcg32,
) -> Option<Loop> {
    let keyframe = localizer.map.keyframe(current)?;
    let old = &search.order[..search.order.len().saturating_sub(localizer.config.places.min_loop_gap)];
    let is_earlier = |id: &KeyframeId| old.contains(id) || !search.segments.are_joined(*id, current);
    let connected: Vec<_> = localizer.map.covisible(current).into_iter().map(|(id, _)| id).collect();
    let is_candidate = |id: &KeyframeId| *id != current && is_earlier(id) && !connected.contains(id);
    if !search.order.iter().any(is_candidate) {
        return None;
    }
    let scores = search.places.query(keyframe.features.descriptors());
    // A loop candidate must look at least as similar as the least similar neighbour.
    let score_of = |id: &KeyframeId| scores.iter().find(|(other, _)| other == id).map_or(0.0, |(_, score)| *score);
    let least = connected.iter().take(FUSED_NEIGHBOURS).map(score_of).reduce(f64::min).unwrap_or(0.0);
    scores.iter().filter(|(id, score)| *score >= least && is_candidate(id)).take(CANDIDATES).find_map(|(earlier, _)| {
        let located = localizer.locate_by_keyframe(&keyframe.features, *earlier, rng)?;
        let refined = settle(localizer, current, &located)?;
        Some(Loop { current, earlier: *earlier, T_camera_world: refined.T_camera_world })
    })
}

/// Refines the pose with all points around the earlier keyframe; `None` without enough support.
fn settle(localizer: &Localizer<'_>, current: KeyframeId, first: &Localized) -> Option<Localized> {
    let features = &localizer.map.keyframe(current)?.features;
    let settled = localizer.settle(features, first)?;
    (settled.matches.len() >= localizer.config.places.min_inliers).then_some(settled)
}

/// Corrects the map: pose graph over all keyframes, points moved along, both ends fused.
pub(crate) fn close(map: &mut Map, camera: &Camera, config: &TrackingConfig, order: &[KeyframeId], found: &Loop) {
    let corrected = optimize_graph(map, order, found);
    move_map(map, &corrected);
    fuse_ends(map, camera, config, found);
}

/// Moves a segment (the keyframes of `segment`, that of either end) as a whole to where the other end sees it, and fuses both ends.
pub(crate) fn merge(map: &mut Map, camera: &Camera, config: &TrackingConfig, segment: &[KeyframeId], found: &Loop) {
    move_segment(map, segment, found);
    fuse_ends(map, camera, config, found);
}

#[allow(non_snake_case)]
fn move_segment(map: &mut Map, segment: &[KeyframeId], found: &Loop) {
    let Some(current) = map.keyframe(found.current) else { return };
    let T_current_earlier = current.T_camera_world.inverse() * found.T_camera_world;
    let T_before_after = if segment.contains(&found.current) { T_current_earlier } else { T_current_earlier.inverse() };
    let moved = |id: &KeyframeId| Some((*id, map.keyframe(*id)?.T_camera_world * T_before_after));
    let corrected: BTreeMap<_, _> = segment.iter().filter_map(moved).collect();
    move_map(map, &corrected);
}

/// Joins what both ends of a closed loop see.
fn fuse_ends(map: &mut Map, camera: &Camera, config: &TrackingConfig, found: &Loop) {
    let around = |map: &Map, id| -> Vec<KeyframeId> {
        let neighbours = map.covisible(id).into_iter().take(FUSED_NEIGHBOURS).map(|(id, _)| id);
        std::iter::once(id).chain(neighbours).collect()
    };
    let (here, there) = (around(map, found.current), around(map, found.earlier));
    for &a in &here {
        for &b in &there {
            local_mapping::fuse(map, camera, config, a, b);
            local_mapping::fuse(map, camera, config, b, a);
        }
    }
}

/// New poses for all keyframes.
#[allow(non_snake_case)]
fn optimize_graph(map: &Map, order: &[KeyframeId], found: &Loop) -> BTreeMap<KeyframeId, Pose> {
    let nodes: Vec<_> = order.iter().filter_map(|id| Some((*id, map.keyframe(*id)?.T_camera_world))).collect();
    let index: BTreeMap<_, _> = nodes.iter().enumerate().map(|(i, (id, _))| (*id, i)).collect();
    let mut graph = PoseGraph { poses: nodes.iter().map(|(_, pose)| *pose).collect(), edges: Vec::new() };
    let relative = |graph: &PoseGraph, a: usize, b: usize| graph.poses[a] * graph.poses[b].inverse();
    for (b, (id, _)) in nodes.iter().enumerate() {
        let shared = map.covisible(*id);
        let strong = shared.iter().filter(|(_, points)| *points >= ESSENTIAL_POINTS);
        let mut linked: BTreeMap<usize, usize> =
            strong.filter_map(|(other, points)| Some((*index.get(other)?, *points))).filter(|(a, _)| *a < b).collect();
        if let Some(before) = b.checked_sub(1) {
            // The chain in time keeps the graph connected.
            linked.entry(before).or_insert(1);
        }
        for (a, points) in linked {
            graph.edges.push(Edge { a, b, T_a_b: relative(&graph, a, b), weight: points as f64 });
        }
    }
    if let (Some(&a), Some(&b)) = (index.get(&found.earlier), index.get(&found.current)) {
        let T_a_b = graph.poses[a] * found.T_camera_world.inverse();
        let strongest = graph.edges.iter().map(|e| e.weight).fold(1.0, f64::max);
        graph.edges.push(Edge { a, b, T_a_b, weight: CLOSING_WEIGHT * strongest });
    }
    graph.optimize();
    nodes.iter().map(|(id, _)| *id).zip(graph.poses).filter(|(_, pose)| pose::is_finite(pose)).collect()
}

/// Moves keyframes to their new poses and every point with the keyframe that saw it first.
fn move_map(map: &mut Map, corrected: &BTreeMap<KeyframeId, Pose>) {
    let moved = |map: &Map, id: &KeyframeId| {
        let (old, new) = (map.keyframe(*id)?.T_camera_world, corrected.get(id)?);
        Some(new.inverse() * old)
    };
    let points: Vec<_> = map
        .points()
        .filter_map(|(id, point)| {
            let motion = moved(map, &point.observations().first()?.keyframe)?;
            Some((id, motion * point.position))
        })
        .collect();
    for (id, pose) in corrected {
        if let Some(keyframe) = map.keyframe_mut(*id) {
            keyframe.move_to(pose);
        }
    }
    for (id, position) in points {
        if let Some(point) = map.point_mut(id) {
            point.position = position;
        }
        map.update_point(id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_features::ImageFeatures;
    use crate::map::{Keyframe, Observation};
    use crate::residual::Measurement;
    use nalgebra::{Point2, Point3, Vector6};
    use pfd_geometry::Stamp;

    #[test]
    #[allow(non_snake_case)]
    fn either_segment_moves_to_where_the_other_end_sees_it() {
        let measured = Measurement { pixel: Point2::new(30.0, 30.0), sigma: 1.0, depth: Some((1.0, 0.01)) };
        let features = ImageFeatures::from_measurements((64, 64), vec![measured]);
        let pose = |x: f64| pose::exp(&Vector6::new(x, 0.1, -0.2, 0.1, 0.2, 0.3 * x));
        for moves_current in [true, false] {
            let mut map = Map::default();
            let mut add = |x| map.add_keyframe(Keyframe::new(Stamp::default(), 0, pose(x), features.clone()));
            let [earlier, beside_earlier, current, beside_current] = [0.0, 0.4, 5.0, 5.3].map(&mut add);
            let seen_by_earlier = Point3::new(0.1, 0.2, 1.0);
            let point = map.add_point(seen_by_earlier, Observation { keyframe: earlier, feature: 0 }).unwrap();
            let found = Loop { current, earlier, T_camera_world: pose(0.1) };
            let at = |map: &Map, id| map.keyframe(id).unwrap().T_camera_world;
            let before = map.clone();
            let relative = |map: &Map, a, b| at(map, a) * at(map, b).inverse();
            let (segment, still) = if moves_current {
                ([current, beside_current], [earlier, beside_earlier])
            } else {
                ([earlier, beside_earlier], [current, beside_current])
            };
            move_segment(&mut map, &segment, &found);
            assert!(still.iter().all(|&id| at(&map, id) == at(&before, id)), "the other one stays");
            let off = |a: Pose, b: Pose| pose::log(&(a * b.inverse())).norm();
            let closed = found.T_camera_world * at(&before, earlier).inverse();
            assert!(off(relative(&map, current, earlier), closed) < 1e-9, "as the place that was recognised has it");
            for (a, b) in [(current, beside_current), (earlier, beside_earlier)] {
                assert!(off(relative(&map, a, b), relative(&before, a, b)) < 1e-9, "each is rigid");
            }
            let seen = at(&map, earlier) * map.point(point).unwrap().position;
            assert!((seen - at(&before, earlier) * seen_by_earlier).norm() < 1e-9, "points move along");
        }
    }
}
