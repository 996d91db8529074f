//! What is known of the camera from frame to frame, while (and after) a map exists.

use pfd_geometry::Stamp;

use crate::agreement::Agreement;
use crate::clarity::Clarity;
use crate::localization::{Expectation, Localized};
use crate::map::{KeyframeId, MapPointId};
use crate::motion::Motion;
use crate::motion_filter::UncertainPose;

/// The camera as it was in the last frame.
pub(crate) struct Active {
    pub(crate) motion: Motion,
    /// The keyframe that shares most points with the last frame.
    pub(crate) reference: KeyframeId,
    /// Map points that the last frame showed.
    pub(crate) last_points: Vec<MapPointId>,
    /// When the camera was found again or the stream went on after a gap, if it did.
    pub(crate) resumed: Option<Stamp>,
    pub(crate) agreement: Agreement,
    pub(crate) clarity: Clarity,
}

impl Active {
    /// At the keyframe `reference`, which shows `last_points`.
    pub(crate) fn new(motion: Motion, reference: KeyframeId, last_points: Vec<MapPointId>) -> Self {
        let (agreement, clarity) = (Agreement::default(), Clarity::default());
        Self { motion, reference, last_points, resumed: None, agreement, clarity }
    }

    /// What to look for in a frame at `stamp`.
    pub(crate) fn expectation(&self, stamp: Stamp) -> Expectation<'_> {
        Expectation {
            predicted: self.motion.predict(stamp),
            last: *self.motion.T_camera_world(),
            last_points: &self.last_points,
            reference: self.reference,
        }
    }

    /// Takes over the pose that was found at `stamp`. A camera that `was_lost` may be anywhere, at any speed.
    pub(crate) fn accept(&mut self, stamp: Stamp, found: &Localized, reference: Option<KeyframeId>, was_lost: bool) {
        if was_lost || self.motion.is_interrupted_by(stamp) {
            self.resumed = Some(stamp);
        }
        if was_lost {
            let Localized { T_camera_world, covariance, .. } = *found;
            self.motion.restart(stamp, &UncertainPose { T_camera_world, covariance });
        } else {
            self.motion.update(stamp, found.T_camera_world);
        }
        self.agreement.observe(stamp, found.consensus);
        self.last_points = found.matches.iter().map(|m| m.point).collect();
        self.reference = reference.unwrap_or(self.reference);
    }
}
