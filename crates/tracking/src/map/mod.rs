//! The map: keyframes and map points in arenas with typed ids, joined by observations.
//!
//! An observation is recorded at both ends: the map point knows keyframe and feature, the keyframe's feature knows the map
//! point. Every change goes through [`Map`], which keeps both ends equal ([`Map::check`]).

mod keyframe;
mod map_point;

use std::collections::BTreeMap;

use nalgebra::Point3;
use slotmap::SlotMap;

pub use keyframe::Keyframe;
pub use map_point::{Counts, MapPoint};

slotmap::new_key_type! {
    /// Identifies a keyframe, for as long as the map exists.
    pub struct KeyframeId;
    /// Identifies a map point, for as long as the map exists.
    pub struct MapPointId;
}

/// Where a map point was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Observation {
    /// In which keyframe.
    pub keyframe: KeyframeId,
    /// As which of its features.
    pub feature: usize,
}

/// Keyframes that must have seen a point for it to count as part of the static scene, if there are so many.
const ESTABLISHED: usize = 3;

/// Rotations differ from length one by no more than rounding errors.
pub(crate) const UNIT_TOLERANCE: f64 = 1e-12;

/// Keyframes, map points, and who saw what.
#[derive(Clone, Debug, Default)]
pub struct Map {
    keyframes: SlotMap<KeyframeId, Keyframe>,
    points: SlotMap<MapPointId, MapPoint>,
}

impl Map {
    /// Number of keyframes.
    pub fn keyframe_count(&self) -> usize {
        self.keyframes.len()
    }

    /// Number of map points.
    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// A keyframe, unless it was removed.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&Keyframe> {
        self.keyframes.get(id)
    }

    /// A keyframe to change; its observations stay as they are.
    pub fn keyframe_mut(&mut self, id: KeyframeId) -> Option<&mut Keyframe> {
        self.keyframes.get_mut(id)
    }

    /// A map point, unless it was removed.
    pub fn point(&self, id: MapPointId) -> Option<&MapPoint> {
        self.points.get(id)
    }

    /// A map point, if it is part of the static scene as far as can be told: three keyframes have seen it, or all there are that show
    /// its surroundings.
    pub fn established(&self, id: MapPointId) -> Option<&MapPoint> {
        let point = self.point(id)?;
        let observer = self.keyframe(point.observations().first()?.keyframe)?;
        let enough = ESTABLISHED.min(1 + observer.covisible().len());
        (point.observations().len() >= enough).then_some(point)
    }

    /// A map point to change; its observations stay as they are.
    pub fn point_mut(&mut self, id: MapPointId) -> Option<&mut MapPoint> {
        self.points.get_mut(id)
    }

    /// All keyframes, in arena order.
    pub fn keyframes(&self) -> impl Iterator<Item = (KeyframeId, &Keyframe)> {
        self.keyframes.iter()
    }

    /// All map points, in arena order.
    pub fn points(&self) -> impl Iterator<Item = (MapPointId, &MapPoint)> {
        self.points.iter()
    }

    /// Adds a keyframe that observes nothing yet.
    pub fn add_keyframe(&mut self, keyframe: Keyframe) -> KeyframeId {
        self.keyframes.insert(keyframe)
    }

    /// Adds a map point at `position`, seen as `feature` of `keyframe`. `None` when that feature does not exist or already
    /// shows a point.
    pub fn add_point(&mut self, position: Point3<f64>, seen: Observation) -> Option<MapPointId> {
        let keyframe = self.keyframes.get(seen.keyframe)?;
        if keyframe.points().get(seen.feature)?.is_some() || !position.coords.iter().all(|x| x.is_finite()) {
            return None;
        }
        let id = self.points.insert(MapPoint::new(position, keyframe.features.color(seen.feature)));
        self.add_observation(id, seen);
        Some(id)
    }

    /// Records that `point` was seen. Ignored when the feature already shows a point or the keyframe already sees the point.
    pub fn add_observation(&mut self, point: MapPointId, seen: Observation) -> bool {
        let (Some(keyframe), Some(map_point)) = (self.keyframes.get_mut(seen.keyframe), self.points.get_mut(point))
        else {
            return false;
        };
        let free = keyframe.points().get(seen.feature).is_some_and(Option::is_none);
        if !free || map_point.observed_in(seen.keyframe).is_some() {
            return false;
        }
        keyframe.set_point(seen.feature, Some(point));
        let others: Vec<_> = map_point.observations().iter().map(|other| other.keyframe).collect();
        map_point.add_observation(seen);
        for other in others {
            self.link(seen.keyframe, other);
        }
        self.update_point(point);
        true
    }

    /// Forgets that `keyframe` saw `point`; a point that nobody sees is removed.
    pub fn remove_observation(&mut self, point: MapPointId, keyframe: KeyframeId) {
        let Some(map_point) = self.points.get_mut(point) else { return };
        let Some(feature) = map_point.remove_observation(keyframe) else { return };
        let others: Vec<_> = map_point.observations().iter().map(|other| other.keyframe).collect();
        if let Some(keyframe) = self.keyframes.get_mut(keyframe) {
            keyframe.set_point(feature, None);
        }
        if others.is_empty() {
            self.points.remove(point);
            return;
        }
        for other in others {
            self.unlink(keyframe, other);
        }
        self.update_point(point);
    }

    /// Two keyframes share one more point.
    fn link(&mut self, a: KeyframeId, b: KeyframeId) {
        for (one, other) in [(a, b), (b, a)] {
            if let Some(keyframe) = self.keyframes.get_mut(one) {
                keyframe.share_point_with(other);
            }
        }
    }

    /// Two keyframes share one point less.
    fn unlink(&mut self, a: KeyframeId, b: KeyframeId) {
        for (one, other) in [(a, b), (b, a)] {
            if let Some(keyframe) = self.keyframes.get_mut(one) {
                keyframe.unshare_point_with(other);
            }
        }
    }

    /// Removes a map point and every observation of it.
    pub fn remove_point(&mut self, point: MapPointId) {
        let Some(map_point) = self.points.remove(point) else { return };
        let observations = map_point.observations();
        for (i, seen) in observations.iter().enumerate() {
            if let Some(keyframe) = self.keyframes.get_mut(seen.keyframe) {
                keyframe.set_point(seen.feature, None);
            }
            for other in &observations[..i] {
                self.unlink(seen.keyframe, other.keyframe);
            }
        }
    }

    /// Removes a keyframe; points that only it saw go as well.
    pub fn remove_keyframe(&mut self, id: KeyframeId) {
        let Some(keyframe) = self.keyframes.get(id) else { return };
        let points: Vec<_> = keyframe.points().iter().flatten().copied().collect();
        for point in points {
            self.remove_observation(point, id);
        }
        self.keyframes.remove(id);
    }

    /// Joins two points that turned out to be the same: `keep` takes over the observations of `drop`.
    pub fn merge_points(&mut self, keep: MapPointId, drop: MapPointId) {
        if keep == drop || !self.points.contains_key(keep) {
            return;
        }
        let Some(dropped) = self.points.get(drop) else { return };
        let (observations, counts) = (dropped.observations().to_vec(), dropped.counts);
        self.remove_point(drop);
        for seen in observations {
            self.add_observation(keep, seen);
        }
        if let Some(point) = self.points.get_mut(keep) {
            point.counts.add(counts);
        }
    }

    /// How many map points each other keyframe shares with `id`, most first.
    pub fn covisible(&self, id: KeyframeId) -> Vec<(KeyframeId, usize)> {
        self.keyframes.get(id).map_or_else(Vec::new, |keyframe| sorted_by_count(keyframe.covisible().clone()))
    }

    /// How many of `points` each keyframe sees, most first.
    pub fn observers(&self, points: impl Iterator<Item = MapPointId>) -> Vec<(KeyframeId, usize)> {
        sorted_by_count(self.count_observers(points))
    }

    fn count_observers(&self, points: impl Iterator<Item = MapPointId>) -> BTreeMap<KeyframeId, usize> {
        let mut counts = BTreeMap::new();
        for point in points.filter_map(|id| self.points.get(id)) {
            for seen in point.observations() {
                *counts.entry(seen.keyframe).or_insert(0) += 1;
            }
        }
        counts
    }

    /// Recomputes what a map point derives from its observations: descriptor, viewing direction, scale.
    pub fn update_point(&mut self, id: MapPointId) {
        if let Some(point) = self.points.get_mut(id) {
            point.update(&self.keyframes);
        }
    }

    /// Checks that both ends of every observation agree, that the counts of shared points are right, and that poses are rotations.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub fn check(&self) -> Result<(), String> {
        for (id, point) in &self.points {
            if point.observations().is_empty() {
                return Err(format!("{id:?} is seen by nobody"));
            }
            for seen in point.observations() {
                let there = self.keyframes.get(seen.keyframe).and_then(|k| *k.points().get(seen.feature)?);
                if there != Some(id) {
                    return Err(format!("{id:?} says it is seen as {seen:?}, which shows {there:?}"));
                }
            }
        }
        for (id, keyframe) in &self.keyframes {
            let length = keyframe.T_camera_world.rotation.norm();
            if length.is_nan() || (length - 1.0).abs() > UNIT_TOLERANCE {
                return Err(format!("the rotation of {id:?} has length {length}"));
            }
            for (feature, point) in keyframe.points().iter().enumerate() {
                let Some(point) = point else { continue };
                let there = self.points.get(*point).and_then(|p| p.observed_in(id));
                if there != Some(feature) {
                    return Err(format!("feature {feature} of {id:?} shows {point:?}, which says {there:?}"));
                }
            }
            let mut shared = self.count_observers(keyframe.points().iter().flatten().copied());
            shared.remove(&id);
            if shared != *keyframe.covisible() {
                return Err(format!("{id:?} shares {shared:?}, but says {:?}", keyframe.covisible()));
            }
        }
        Ok(())
    }
}

fn sorted_by_count(counts: BTreeMap<KeyframeId, usize>) -> Vec<(KeyframeId, usize)> {
    let mut sorted: Vec<_> = counts.into_iter().collect();
    sorted.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_features::ImageFeatures;
    use crate::residual::Measurement;
    use nalgebra::Point2;
    use pfd_geometry::{Pose, Stamp};
    use proptest::prelude::*;

    fn keyframe(features: usize) -> Keyframe {
        let measured = Measurement { pixel: Point2::new(1.0, 1.0), sigma: 1.0, depth: Some((1.0, 0.01)) };
        let features = ImageFeatures::from_measurements((64, 64), vec![measured; features]);
        Keyframe::new(Stamp::default(), 0, Pose::identity(), features)
    }

    proptest! {
        #[test]
        fn both_ends_agree_after_any_operations(
            operations in prop::collection::vec((0..6_u8, 0..5_usize, 0..8_usize, 0..12_usize), 1..120),
        ) {
            let mut map = Map::default();
            let mut keyframes: Vec<_> = (0..5).map(|_| map.add_keyframe(keyframe(8))).collect();
            let mut points = [MapPointId::default(); 12];
            for (operation, k, feature, p) in operations {
                let seen = Observation { keyframe: keyframes[k], feature };
                match operation {
                    0 => points[p] = map.add_point(Point3::new(0.0, 0.0, 1.0), seen).unwrap_or(points[p]),
                    1 => drop(map.add_observation(points[p], seen)),
                    2 => map.remove_observation(points[p], keyframes[k]),
                    3 => map.remove_point(points[p]),
                    4 => map.merge_points(points[p], points[(p + 1 + feature) % 12]),
                    _ => {
                        map.remove_keyframe(keyframes[k]);
                        keyframes[k] = map.add_keyframe(keyframe(8));
                    }
                }
                prop_assert_eq!(map.check(), Ok(()));
            }
        }
    }

    #[test]
    fn covisibility_counts_shared_points() {
        let mut map = Map::default();
        let [a, b, c] = [(); 3].map(|()| map.add_keyframe(keyframe(4)));
        for feature in 0..3 {
            let point = map.add_point(Point3::origin(), Observation { keyframe: a, feature }).unwrap();
            map.add_observation(point, Observation { keyframe: b, feature });
            if feature == 0 {
                map.add_observation(point, Observation { keyframe: c, feature });
            }
        }
        assert_eq!(map.covisible(a), vec![(b, 3), (c, 1)]);
    }

    #[test]
    fn a_point_is_established_when_three_or_all_that_can_see_it_have() {
        let mut map = Map::default();
        let [a, b, c, apart] = [(); 4].map(|()| map.add_keyframe(keyframe(2)));
        let add = |map: &mut Map, seen_by: &[KeyframeId], feature| {
            let point = map.add_point(Point3::origin(), Observation { keyframe: seen_by[0], feature }).unwrap();
            for &keyframe in &seen_by[1..] {
                map.add_observation(point, Observation { keyframe, feature });
            }
            point
        };
        let (by_all, by_two, alone) =
            (add(&mut map, &[a, b, c], 0), add(&mut map, &[a, b], 1), add(&mut map, &[apart], 0));
        assert_eq!([by_all, by_two, alone].map(|id| map.established(id).is_some()), [true, false, true]);
    }
}
