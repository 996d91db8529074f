//! The first frames, tracked once more when it is known what moves in them.
//!
//! Nothing tells movers from the room in the first frame, so the first map holds points on both, and the first poses follow a mix
//! of camera and movers. A few frames later the masks are reliable: a map that starts there holds the room alone, and the frames
//! before are localised in it backwards in time. A mover that is found later still may have taken all of these along: then that is
//! done once more.

use pfd_geometry::{Camera, Pose, Stamp};

use crate::config::TrackingConfig;
use crate::image_features::ImageFeatures;
use crate::local_mapping;
use crate::localization::Localizer;
use crate::map::{Keyframe, Map};

/// A frame that may be tracked again.
#[derive(Clone, Debug)]
struct EarlyFrame {
    stamp: Stamp,
    features: ImageFeatures,
}

/// The frames since the first.
#[derive(Clone, Debug, Default)]
pub(crate) struct FirstFrames {
    frames: Vec<EarlyFrame>,
    judged: bool,
}

/// Which time it is that a mask judges the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Judgement {
    /// The first.
    First,
    /// A later one.
    Again,
}

impl FirstFrames {
    /// Keeps a frame, the newest last.
    pub(crate) fn push(&mut self, stamp: Stamp, features: ImageFeatures) {
        self.frames.push(EarlyFrame { stamp, features });
    }

    /// Notes that a mask judges the map.
    pub(crate) fn judge(&mut self) -> Judgement {
        if std::mem::replace(&mut self.judged, true) { Judgement::Again } else { Judgement::First }
    }

    /// Number of frames kept.
    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }

    /// Poses of the kept frames and then of `newest`, which follows them, in a map made of `newest` alone. The oldest camera is
    /// the origin; poses are world to camera. `None` when a frame cannot be found in that map.
    pub(crate) fn track_back_from(
        &self,
        newest: Keyframe,
        camera: &Camera,
        config: &TrackingConfig,
    ) -> Option<Vec<(Stamp, Pose)>> {
        let (stamp, pose) = (newest.stamp, newest.T_camera_world);
        let mut map = Map::default();
        let id = local_mapping::insert_keyframe(&mut map, camera, config, newest, &[]);
        let points: Vec<_> = map.keyframe(id)?.observed().map(|(_, point)| point).collect();
        let localizer = Localizer::new(camera, config, &map);
        let mut poses = vec![(stamp, pose)];
        let mut start = pose;
        for frame in self.frames.iter().rev() {
            let first = localizer.from_prediction(&frame.features, &points, &start)?;
            let found = localizer.in_local_map(&frame.features, &first, config.matching.local_map_radius);
            start = found.unwrap_or(first).T_camera_world;
            poses.push((frame.stamp, start));
        }
        poses.reverse();
        let world_from_oldest = poses[0].1.inverse();
        for (_, pose) in &mut poses {
            *pose *= world_from_oldest;
        }
        Some(poses)
    }
}
