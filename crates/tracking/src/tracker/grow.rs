//! What a frame whose pose is known means for the map.

use pfd_geometry::Pose;

use super::{Candidate, Tracker};
use crate::keyframe_decision;
use crate::local_mapping;
use crate::localization::Localized;
use crate::map::Keyframe;

impl Tracker {
    /// What a frame whose pose is known means for the map. Returns whether it became a keyframe.
    pub(super) fn update_map(&mut self, candidate: Candidate<'_>, localized: &Localized) -> bool {
        if !self.config.mapping.enabled {
            return false;
        }
        if self.begin_anew(&candidate, localized) {
            return true;
        }
        self.remember(&candidate, localized);
        if !self.keyframe_is_due(&candidate, localized) || self.mapper.is_busy() {
            return false;
        }
        self.take_over_adjustment();
        self.add_keyframe(candidate, localized);
        true
    }

    fn remember(&mut self, candidate: &Candidate<'_>, localized: &Localized) {
        let missed = local_mapping::update_point_memory(
            self.mapper.map_mut(),
            &self.camera,
            &self.config,
            (candidate.frame.depth(), candidate.mask),
            &localized.T_camera_world,
            (&localized.sought, &localized.matches),
        );
        let found = localized.matches.len();
        // A pose by descriptors alone says nothing of what else is in view.
        if let Some(active) = self.active.as_mut().filter(|_| !localized.sought.is_empty()) {
            active.clarity.observe(candidate.frame.stamp(), (found, found + missed));
        }
    }

    fn keyframe_is_due(&self, candidate: &Candidate<'_>, localized: &Localized) -> bool {
        let Some(active) = &self.active else { return false };
        let situation = keyframe_decision::Situation {
            stamp: candidate.frame.stamp(),
            resumed: active.resumed,
            agreement_broke_off: active.agreement.broke_off(candidate.frame.stamp()),
            is_poor: active.clarity.is_poor(),
            reference: active.reference,
            newest: self.mapper.newest(),
            features: &candidate.features,
            matches: &localized.matches,
            is_masked: candidate.mask.is_some(),
        };
        keyframe_decision::is_due(self.mapper.map(), &self.config, &situation)
    }

    fn add_keyframe(&mut self, candidate: Candidate<'_>, localized: &Localized) {
        // The adjustment that was just taken over may have moved the pose.
        let pose = self.active.as_ref().map_or(localized.T_camera_world, |a| *a.motion.T_camera_world());
        let keyframe = Keyframe::new(candidate.frame.stamp(), candidate.index, pose, candidate.features);
        let id = self.mapper.insert(keyframe, &localized.matches);
        self.mapper.cull(id);
        let closed = self.mapper.close_loop(id, &mut self.rng);
        self.loops += usize::from(closed);
        let last_points = self.mapper.points_of(id);
        if let Some(active) = &mut self.active {
            active.reference = id;
            active.last_points = last_points;
            if let Some(keyframe) = self.mapper.map().keyframe(id).filter(|_| closed) {
                active.motion.correct(keyframe.T_camera_world);
            }
        }
        self.mapper.start_adjustment(id, candidate.index);
    }

    /// The camera moves with its reference keyframe when the map is adjusted.
    pub(super) fn move_with_map(&mut self, moved: Option<Pose>) {
        if let (Some(moved), Some(active)) = (moved, &mut self.active) {
            active.motion.correct(active.motion.T_camera_world() * moved);
        }
    }

    /// Waits for background work and takes it over.
    pub fn finish(&mut self) {
        self.take_over_adjustment();
    }

    fn take_over_adjustment(&mut self) {
        let reference = self.active.as_ref().map(|active| active.reference);
        let moved = self.mapper.take_over(reference);
        self.move_with_map(moved);
    }
}
