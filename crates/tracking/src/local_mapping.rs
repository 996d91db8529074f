//! What happens to the map when a keyframe is added: new points, fused duplicates, culling.

use nalgebra::Point3;
use pfd_geometry::{Camera, DepthImage, Mask, Pose};
use slotmap::SecondaryMap;

use crate::config::TrackingConfig;
use crate::map::{Counts, Keyframe, KeyframeId, Map, MapPointId, Observation};
use crate::matching::{Match, match_by_projection, predict};
use crate::rolling_shutter::Shutter;

/// Neighbours with which the points of a new keyframe are fused.
const FUSE_NEIGHBOURS: usize = 10;
/// Search radius of fusion, pixels of the finest level.
const FUSE_RADIUS: f64 = 3.0;
/// Keyframes after which a point must have been seen often enough.
const PROBATION_KEYFRAMES: usize = 3;
/// Observations that a point must have after probation. Where a camera turns past walls with little on them, many are seen from two keyframes
/// only, and nothing else ties these to each other: without them a keyframe goes astray in the next adjustment.
const MIN_OBSERVATIONS: usize = 2;
/// Frames that must show free space where a point should be before it is given up.
const MIN_CONTRADICTIONS: u32 = 5;
/// A surface must lie this many standard deviations behind a point to contradict it.
const CONTRADICTION_SIGMAS: f64 = 6.0;
/// Frames that should have seen a point before its share of finds says something.
const MIN_VISIBLE: u32 = 10;

/// A change of the readout time (seconds) by less than this is not worth a correction: at 10 pixels per frame it
/// moves the first and the last row by 0.15 pixels.
const READOUT_TOLERANCE: f64 = 1e-3;
/// Keyframes that are corrected in one frame at most, so that a large map does not hold up tracking.
const REFRESHED: usize = 20;

/// Adds a keyframe with its matches and a new point for every unmatched feature with depth.
pub fn insert_keyframe(
    map: &mut Map,
    camera: &Camera,
    config: &TrackingConfig,
    keyframe: Keyframe,
    matches: &[Match],
) -> KeyframeId {
    let id = map.add_keyframe(keyframe);
    for m in matches {
        map.add_observation(m.point, Observation { keyframe: id, feature: m.feature });
    }
    create_points(map, camera, config, id);
    fuse_with_neighbours(map, camera, config, id);
    id
}

fn create_points(map: &mut Map, camera: &Camera, config: &TrackingConfig, id: KeyframeId) {
    let Some(keyframe) = map.keyframe(id) else { return };
    let from_camera = keyframe.T_camera_world.inverse();
    let new: Vec<(usize, Point3<f64>)> = (0..keyframe.features.len())
        .filter(|&feature| keyframe.points()[feature].is_none())
        .filter_map(|feature| Some((feature, keyframe.features.point_in_camera(feature, camera)?)))
        .filter(|(_, point)| point.z <= config.mapping.max_new_point_depth)
        .map(|(feature, point)| (feature, from_camera * point))
        .collect();
    for (feature, position) in new {
        map.add_point(position, Observation { keyframe: id, feature });
    }
}

/// Corrects the measurements of some keyframes that were made with another readout time.
pub fn refresh_shutters(map: &mut Map, camera: &Camera, readout: f64) {
    let differs = |k: &Keyframe| (k.features.shutter().readout - readout).abs() > READOUT_TOLERANCE;
    let stale: Vec<_> = map.keyframes().filter(|(_, k)| differs(k)).map(|(id, _)| id).take(REFRESHED).collect();
    for id in stale {
        let Some(keyframe) = map.keyframe(id) else { continue };
        let shutter = Shutter { readout, ..*keyframe.features.shutter() };
        set_shutter(map, camera, id, shutter);
    }
}

/// Corrects the measurements of a keyframe; points that only it sees follow.
pub fn set_shutter(map: &mut Map, camera: &Camera, id: KeyframeId, shutter: Shutter) {
    let Some(keyframe) = map.keyframe_mut(id) else { return };
    keyframe.features.set_shutter(camera, shutter);
    place_single_views(map, camera, id);
}

/// Puts the points that only this keyframe sees where it measures them.
pub fn place_single_views(map: &mut Map, camera: &Camera, id: KeyframeId) {
    let Some(keyframe) = map.keyframe(id) else { return };
    let from_camera = keyframe.T_camera_world.inverse();
    let is_alone = |point| map.point(point).is_some_and(|p| p.observations().len() == 1);
    let place = |(feature, point)| Some((point, from_camera * keyframe.features.point_in_camera(feature, camera)?));
    let moved: Vec<_> = keyframe.observed().filter(|(_, point)| is_alone(*point)).filter_map(place).collect();
    for (id, position) in moved {
        if let Some(point) = map.point_mut(id) {
            point.position = position;
        }
    }
}

/// Projects the points of a keyframe into its neighbours and theirs into it; what falls on the same feature is the same point.
fn fuse_with_neighbours(map: &mut Map, camera: &Camera, config: &TrackingConfig, id: KeyframeId) {
    let neighbours: Vec<_> = map.covisible(id).into_iter().take(FUSE_NEIGHBOURS).map(|(n, _)| n).collect();
    for &neighbour in &neighbours {
        fuse(map, camera, config, id, neighbour);
        fuse(map, camera, config, neighbour, id);
    }
}

/// Looks for the points of `source` in `target`.
pub fn fuse(map: &mut Map, camera: &Camera, config: &TrackingConfig, source: KeyframeId, target: KeyframeId) {
    let (Some(from), Some(into)) = (map.keyframe(source), map.keyframe(target)) else { return };
    let unseen = from.observed().filter_map(|(_, id)| {
        let point = map.point(id).filter(|p| p.observed_in(target).is_none())?;
        Some((id, point, predict(camera, &into.T_camera_world, point, config)?))
    });
    let agrees = |m: &Match| {
        map.point(m.point).is_some_and(|p| {
            let measured = into.features.measurement(m.feature);
            crate::residual::residual(camera, &into.T_camera_world, &p.position, measured)
                .is_some_and(|r| r.norm_squared() <= measured.chi2_threshold())
        })
    };
    let matches: Vec<_> = match_by_projection(unseen, &into.features, FUSE_RADIUS, config)
        .into_iter()
        .filter(agrees)
        .map(|m| (m, into.points()[m.feature]))
        .collect();
    for (m, occupied) in matches {
        match occupied {
            None => drop(map.add_observation(m.point, Observation { keyframe: target, feature: m.feature })),
            Some(other) => merge(map, m.point, other),
        }
    }
}

/// Joins two points; the one that more keyframes see stays.
fn merge(map: &mut Map, a: MapPointId, b: MapPointId) {
    let seen = |id| map.point(id).map_or(0, |p| p.observations().len());
    if seen(a) > seen(b) { map.merge_points(a, b) } else { map.merge_points(b, a) }
}

/// Removes points that were not seen again, are found too rarely, or stand where there is free space.
///
/// The last rule catches what the mask missed: a thing that moved away leaves points behind which the depth images contradict.
pub fn cull_points(map: &mut Map, config: &TrackingConfig, keyframes: &[KeyframeId]) {
    let positions: SecondaryMap<KeyframeId, usize> = keyframes.iter().enumerate().map(|(i, id)| (*id, i)).collect();
    let poor = |point: &crate::map::MapPoint| {
        let counts = point.counts;
        let contradicted = counts.contradicted >= MIN_CONTRADICTIONS && counts.contradicted > counts.found;
        let rare = counts.visible >= MIN_VISIBLE
            && f64::from(counts.found) < config.mapping.min_found_ratio * f64::from(counts.visible);
        let newest = point.observations().iter().filter_map(|seen| positions.get(seen.keyframe)).max();
        // Points of which the last sighting just left probation are judged once; older ones have proved themselves.
        let on_trial = newest.is_some_and(|n| n + PROBATION_KEYFRAMES == keyframes.len());
        contradicted || rare || (on_trial && point.observations().len() < MIN_OBSERVATIONS)
    };
    let poor: Vec<_> = map.points().filter(|(_, point)| poor(point)).map(|(id, _)| id).collect();
    for id in poor {
        map.remove_point(id);
    }
}

/// Records for every local point whether the frame should have shown it, did, or shows free space in its place. Returns how many it should
/// have shown and did not.
#[allow(non_snake_case)]
pub fn update_point_memory(
    map: &mut Map,
    camera: &Camera,
    config: &TrackingConfig,
    (depth, mask): (&DepthImage, Option<&Mask>),
    T_camera_world: &Pose,
    (local, found): (&[MapPointId], &[Match]),
) -> usize {
    for m in found {
        if let Some(point) = map.point_mut(m.point) {
            point.counts.add(Counts::FOUND);
        }
    }
    let mut found: Vec<_> = found.iter().map(|m| m.point).collect();
    found.sort_unstable();
    let mut missed = 0;
    for &id in local.iter().filter(|id| found.binary_search(id).is_err()) {
        let Some(point) = map.point(id) else { continue };
        let Some(seen) = predict(camera, T_camera_world, point, config) else { continue };
        let verdict = look_for(depth, mask, config, &seen);
        let Some(point) = map.point_mut(id) else { continue };
        match verdict {
            Sight::Hidden => {}
            Sight::Visible => {
                point.counts.add(Counts::MISSED);
                missed += 1;
            }
            Sight::FreeSpace => point.counts.add(Counts::CONTRADICTED),
        }
    }
    missed
}

/// What a frame says about a point that it should show.
enum Sight {
    /// Something is in front of it, or nothing is known.
    Hidden,
    /// The surface is there.
    Visible,
    /// The camera looks through the place.
    FreeSpace,
}

fn look_for(
    depth: &DepthImage,
    mask: Option<&Mask>,
    config: &TrackingConfig,
    seen: &crate::matching::Prediction,
) -> Sight {
    let (u, v) = (seen.pixel.x.round().max(0.0) as usize, seen.pixel.y.round().max(0.0) as usize);
    if mask.is_some_and(|m| m.is_dynamic(u, v)) {
        return Sight::Hidden;
    }
    // The nearest surface around the pixel, so that a depth edge does not look like free space.
    const REACH: usize = 2;
    let rows = v.saturating_sub(REACH)..=v + REACH;
    let around = rows.flat_map(|y| (u.saturating_sub(REACH)..=u + REACH).map(move |x| (x, y)));
    let nearest = around.filter_map(|(x, y)| depth.at(x, y)).fold(f32::INFINITY, f32::min);
    let (nearest, gap) = (f64::from(nearest), CONTRADICTION_SIGMAS * config.depth_noise.sigma(seen.depth));
    if nearest.is_infinite() || nearest < seen.depth - gap {
        Sight::Hidden
    } else if nearest > seen.depth + gap {
        Sight::FreeSpace
    } else {
        Sight::Visible
    }
}

/// Keyframes among `candidates` that add nothing: nearly all of their points are seen by three others at least as closely.
pub fn redundant_keyframes(map: &Map, config: &TrackingConfig, candidates: &[KeyframeId]) -> Vec<KeyframeId> {
    candidates.iter().copied().filter(|&id| is_redundant(map, config, id)).collect()
}

fn is_redundant(map: &Map, config: &TrackingConfig, id: KeyframeId) -> bool {
    const OTHERS: usize = 3;
    let Some(keyframe) = map.keyframe(id) else { return false };
    let (mut total, mut redundant) = (0_usize, 0_usize);
    for (feature, point) in keyframe.observed().filter_map(|(f, p)| Some((f, map.point(p)?))) {
        total += 1;
        let level = keyframe.features.feature(feature).level;
        let as_close = |seen: &&Observation| {
            seen.keyframe != id
                && map.keyframe(seen.keyframe).is_some_and(|k| k.features.feature(seen.feature).level <= level + 1)
        };
        if point.observations().iter().filter(as_close).take(OTHERS).count() == OTHERS {
            redundant += 1;
        }
    }
    total > 0 && redundant as f64 > config.mapping.redundant_share * total as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_features::ImageFeatures;
    use crate::residual::Measurement;
    use nalgebra::Point2;
    use pfd_geometry::Stamp;

    /// A map of so many keyframes with room for three points each.
    fn map_of(keyframes: usize) -> (Map, Vec<KeyframeId>) {
        let measured = Measurement { pixel: Point2::new(1.0, 1.0), sigma: 1.0, depth: Some((1.0, 0.01)) };
        let features = ImageFeatures::from_measurements((64, 64), vec![measured; 3]);
        let keyframe = || Keyframe::new(Stamp::default(), 0, Pose::identity(), features.clone());
        let mut map = Map::default();
        let order = (0..keyframes).map(|_| map.add_keyframe(keyframe())).collect();
        (map, order)
    }

    fn add_point(map: &mut Map, feature: usize, seen_by: &[KeyframeId]) -> MapPointId {
        let point = map.add_point(Point3::origin(), Observation { keyframe: seen_by[0], feature }).unwrap();
        for &keyframe in &seen_by[1..] {
            map.add_observation(point, Observation { keyframe, feature });
        }
        point
    }

    #[test]
    fn after_probation_points_stay_that_tie_two_keyframes_and_go_that_only_one_has_seen() {
        let (mut map, order) = map_of(1 + PROBATION_KEYFRAMES);
        let (tie, alone) = (add_point(&mut map, 0, &order[..2]), add_point(&mut map, 1, &order[1..2]));
        let remaining = |map: &Map| [tie, alone].map(|id| map.point(id).is_some());
        cull_points(&mut map, &TrackingConfig::default(), &order[..PROBATION_KEYFRAMES]);
        assert_eq!(remaining(&map), [true, true], "on probation");
        cull_points(&mut map, &TrackingConfig::default(), &order);
        assert_eq!(remaining(&map), [true, false]);
    }

    #[test]
    fn points_go_that_are_seldom_found_or_seen_through() {
        let (mut map, order) = map_of(2);
        let [good, rare, contradicted] = [0, 1, 2].map(|feature| add_point(&mut map, feature, &order));
        let mut count = |id, counts: Counts, times: u32| {
            (0..times).for_each(|_| map.point_mut(id).unwrap().counts.add(counts));
        };
        count(good, Counts::FOUND, MIN_VISIBLE);
        count(rare, Counts::MISSED, MIN_VISIBLE);
        count(contradicted, Counts::CONTRADICTED, MIN_CONTRADICTIONS);
        cull_points(&mut map, &TrackingConfig::default(), &order);
        assert_eq!([good, rare, contradicted].map(|id| map.point(id).is_some()), [true, false, false]);
    }
}
