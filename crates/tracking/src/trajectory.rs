//! Poses of all frames, relative to keyframes, so that later corrections of the map reach them.

use pfd_geometry::{Pose, Stamp, StampedPose};
use slotmap::SecondaryMap;

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
    /// Removed keyframes: which one stands in, and `T_removed_standin`.
    removed: SecondaryMap<KeyframeId, (KeyframeId, Pose)>,
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
            self.removed.insert(keyframe, (standin, relative));
        }
    }

    /// All poses (camera to world) by the present state of the map.
    pub(crate) fn poses(&self, map: &Map) -> Vec<StampedPose> {
        let place = |entry: &Entry| {
            let (mut id, mut pose) = (entry.reference, entry.T_camera_reference);
            while let Some((standin, relative)) = self.removed.get(id) {
                pose *= relative;
                id = *standin;
            }
            let T_camera_world = pose * map.keyframe(id)?.T_camera_world;
            Some(StampedPose { stamp: entry.stamp, pose: T_camera_world.inverse() })
        };
        self.entries.iter().filter_map(place).collect()
    }
}
