//! Poses of all frames, relative to keyframes, so that later corrections of the map reach them.

use std::collections::{BTreeMap, BTreeSet};

use pfd_geometry::{Pose, Stamp, StampedPose};

use crate::map::{KeyframeId, Map};

/// A frame relative to its reference keyframe.
#[derive(Clone, Copy, Debug)]
#[allow(non_snake_case)]
struct Entry {
    stamp: Stamp,
    reference: KeyframeId,
    T_camera_reference: Pose,
}

/// The tracked frames so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct TrajectoryLog {
    entries: Vec<Entry>,
    /// Removed keyframes: which one stands in, and `T_removed_standin`. Not a map by arena slot: those are used again.
    removed: BTreeMap<KeyframeId, (KeyframeId, Pose)>,
}

#[allow(non_snake_case)]
impl TrajectoryLog {
    /// Adds a frame with its pose (world to camera).
    pub(crate) fn push(&mut self, map: &Map, stamp: Stamp, reference: KeyframeId, T_camera_world: &Pose) {
        if let Some(keyframe) = map.keyframe(reference) {
            let T_camera_reference = T_camera_world * keyframe.T_camera_world.inverse();
            self.entries.push(Entry { stamp, reference, T_camera_reference });
        }
    }

    /// Notes, before `keyframe` is removed, that `standin` takes its place.
    pub(crate) fn replace(&mut self, map: &Map, keyframe: KeyframeId, standin: KeyframeId) {
        if let (Some(old), Some(new)) = (map.keyframe(keyframe), map.keyframe(standin)) {
            let relative = old.T_camera_world * new.T_camera_world.inverse();
            // Those for which the removed one stood in follow it, so that no pose ever depends on more than one stand-in.
            for (former, pose) in self.removed.values_mut().filter(|(former, _)| *former == keyframe) {
                (*former, *pose) = (standin, *pose * relative);
            }
            self.removed.insert(keyframe, (standin, relative));
        }
    }

    /// The last `count` poses (camera to world) by the present state of the map.
    pub(crate) fn recent(&self, map: &Map, count: usize) -> Vec<StampedPose> {
        let recent = &self.entries[self.entries.len().saturating_sub(count)..];
        recent.iter().filter_map(|entry| self.place(map, entry)).map(|(_, pose)| pose).collect()
    }

    /// All poses (camera to world) near one of `keyframes`.
    pub(crate) fn near(&self, map: &Map, keyframes: &BTreeSet<KeyframeId>) -> Vec<StampedPose> {
        let placed = self.entries.iter().filter_map(|entry| self.place(map, entry));
        placed.filter(|(id, _)| keyframes.contains(id)).map(|(_, pose)| pose).collect()
    }

    /// The pose of a frame and the living keyframe from which it follows.
    fn place(&self, map: &Map, entry: &Entry) -> Option<(KeyframeId, StampedPose)> {
        let (id, pose) = match self.removed.get(&entry.reference) {
            Some((standin, relative)) => (*standin, entry.T_camera_reference * relative),
            None => (entry.reference, entry.T_camera_reference),
        };
        let T_camera_world = pose * map.keyframe(id)?.T_camera_world;
        Some((id, StampedPose { stamp: entry.stamp, pose: T_camera_world.inverse() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_features::ImageFeatures;
    use crate::map::Keyframe;
    use nalgebra::Vector6;
    use pfd_geometry::pose;

    /// World to camera, `i` decimetres along.
    fn pose_at(i: i64) -> Pose {
        pose::exp(&Vector6::new(0.1 * i as f64, 0.0, 0.0, 0.0, 0.0, 0.0))
    }

    #[test]
    fn frames_keep_their_poses_when_keyframes_are_removed_and_their_slots_used_again() {
        let (mut map, mut log) = (Map::default(), TrajectoryLog::default());
        let add = |map: &mut Map, log: &mut TrajectoryLog, i: i64| {
            let (stamp, pose) = (Stamp::from_nanos(i), pose_at(i));
            let id = map.add_keyframe(Keyframe::new(stamp, i as usize, pose, ImageFeatures::default()));
            log.push(map, stamp, id, &pose);
            id
        };
        let first = add(&mut map, &mut log, 0);
        let mut earlier = add(&mut map, &mut log, 1);
        for i in 2..6 {
            // Each stands in for the one before, and the first for the last of them.
            let id = add(&mut map, &mut log, i);
            log.replace(&map, earlier, id);
            map.remove_keyframe(earlier);
            earlier = id;
        }
        log.replace(&map, earlier, first);
        map.remove_keyframe(earlier);
        let poses = log.recent(&map, usize::MAX);
        assert_eq!(poses.len(), 6);
        assert_eq!(log.recent(&map, 2), poses[4..]);
        let other = add(&mut map, &mut log, 6);
        assert_eq!(log.near(&map, &BTreeSet::from([first])), poses, "those for which the first stands in as well");
        assert_eq!(log.near(&map, &BTreeSet::from([other])).len(), 1);
        for (i, found) in poses.iter().enumerate() {
            let error = pose::log(&(found.pose * pose_at(i as i64)));
            assert!(error.norm() < 1e-9, "frame {i}: {error}");
        }
    }
}
