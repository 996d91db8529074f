//! The first frames, tracked once more when it is known what moves in them.
//!
//! Nothing tells movers from the room in the first frame, so the first map holds points on both, and the first poses follow a mix
//! of camera and movers. A few frames later the masks are reliable: a map that starts there holds the room alone, and the frames
//! before are localised in it backwards in time.

use pfd_geometry::{Pose, Stamp};

use crate::image_features::ImageFeatures;
use crate::localization::Localizer;
use crate::map::MapPointId;

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
}

impl FirstFrames {
    /// Keeps a frame, the newest last.
    pub(crate) fn push(&mut self, stamp: Stamp, features: ImageFeatures) {
        self.frames.push(EarlyFrame { stamp, features });
    }

    /// Number of frames kept.
    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }

    /// Poses (world to camera) of the kept frames, oldest first, in a map with the points `points` that a camera at `start`
    /// sees one frame after the last of them. `None` when one of them cannot be found there.
    pub(crate) fn localize(
        &self,
        localizer: &Localizer<'_>,
        points: &[MapPointId],
        start: &Pose,
    ) -> Option<Vec<(Stamp, Pose)>> {
        let mut poses = Vec::with_capacity(self.frames.len());
        let mut pose = *start;
        for frame in self.frames.iter().rev() {
            let first = localizer.from_prediction(&frame.features, points, &pose)?;
            let radius = localizer.config.matching.local_map_radius;
            let found = localizer.in_local_map(&frame.features, &first, radius).unwrap_or(first);
            pose = found.T_camera_world;
            poses.push((frame.stamp, pose));
        }
        poses.reverse();
        Some(poses)
    }
}
