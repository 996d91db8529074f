//! Where the camera is in the map: followed from the last frame, with or without the mask, or recognised.

use nalgebra::Vector6;
use pfd_geometry::Stamp;

use super::{Candidate, Tracker};
use crate::active::Active;
use crate::image_features::ImageFeatures;
use crate::localization::{Localized, Localizer};
use crate::mask_check;
use crate::motion_filter::UncertainPose;
use crate::result::{TrackingError, TrackingState};

impl Tracker {
    fn localizer(&self) -> Localizer<'_> {
        Localizer::new(&self.camera, &self.config, self.mapper.map())
    }

    /// The pose of the candidate: with the mask, where that leaves too little without, and at last by recognising the place.
    pub(super) fn localize(&mut self, candidate: &mut Candidate<'_>) -> Result<Option<Localized>, TrackingError> {
        if self.active.is_none() {
            self.see_enough_to_start(candidate)?;
            return Ok(None);
        }
        if self.can_be_followed(candidate.frame.stamp())
            && let Some(followed) = self.follow_with_or_without_mask(candidate)?
        {
            // A camera that was out of sight for a few frames only goes on.
            self.state = TrackingState::Ok;
            return Ok(Some(followed));
        }
        // Also for a frame that could not be followed the camera may be found in the map as a whole.
        self.state = TrackingState::Lost;
        let found = self.relocalize(&candidate.features);
        if found.is_some() || !self.leaves_little(candidate) {
            return Ok(found);
        }
        self.see_enough_to_start(candidate)?;
        Ok(self.relocalize(&candidate.features))
    }

    /// Whether the camera is still near where it was last seen: it is not lost, or has been for so short a time that its motion is known.
    fn can_be_followed(&self, stamp: Stamp) -> bool {
        self.state != TrackingState::Lost || self.active.as_ref().is_some_and(|active| active.motion.reaches(stamp))
    }

    /// Whether a mask leaves little to go by.
    fn leaves_little(&self, candidate: &Candidate<'_>) -> bool {
        let few = candidate.features.with_depth() < self.config.pose.min_initial_points;
        candidate.mask.is_some_and(|mask| few || mask.fraction() > self.config.pose.doubtful_mask)
    }

    /// A map starts, or is found again, without a mask that leaves too little for it, or covers much: nothing is known yet that could
    /// contradict it, and as long as it stays, little else would ever be tracked. What moves is found out by [`Self::begin_anew`].
    fn see_enough_to_start(&mut self, candidate: &mut Candidate<'_>) -> Result<(), TrackingError> {
        if self.leaves_little(candidate) {
            candidate.mask = None;
            candidate.features = self.extract(candidate.frame, None)?;
        }
        Ok(())
    }

    /// Makes the most of a pose that was found: see [`Refinement`](crate::refinement::Refinement).
    #[allow(non_snake_case)]
    pub(super) fn refine(&mut self, features: &mut ImageFeatures, found: Localized) -> Localized {
        let Some(active) = &self.active else { return found };
        let velocity = match self.state {
            // A camera that was lost may be anywhere.
            TrackingState::Lost => Vector6::zeros(),
            _ => active.motion.velocity_at(self.last_stamp.unwrap_or_default(), &found.T_camera_world),
        };
        // Not `self.localizer()`, which would borrow the refinement as well.
        let localizer = Localizer::new(&self.camera, &self.config, self.mapper.map());
        self.refinement.refine(&localizer, velocity, features, found)
    }

    /// Follows the camera by what the mask leaves. Where that is too little, or the mask covers much and the map is seen behind it,
    /// the mask is given up.
    fn follow_with_or_without_mask(
        &mut self,
        candidate: &mut Candidate<'_>,
    ) -> Result<Option<Localized>, TrackingError> {
        let Some(active) = &self.active else { return Ok(None) };
        let masked = self.follow(active, candidate);
        let Some(mask) = candidate.mask else { return Ok(masked) };
        let enough = masked.as_ref().is_some_and(|l| l.matches.len() >= self.config.pose.min_unmasked_inliers);
        if enough && mask.fraction() < self.config.pose.doubtful_mask {
            return Ok(masked);
        }
        let unmasked_features = self.extract(candidate.frame, None)?;
        let masked_features = std::mem::replace(&mut candidate.features, unmasked_features);
        let unmasked = self.active.as_ref().and_then(|active| self.follow(active, candidate));
        let model = (&self.camera, &self.config);
        let Some(found) = unmasked else {
            candidate.features = masked_features;
            return Ok(masked);
        };
        let map = self.mapper.map();
        let agrees =
            !enough || masked.as_ref().is_none_or(|masked| mask_check::agree(map, &self.camera, masked, &found));
        let contradicted = agrees && mask_check::is_contradicted(map, model, mask, &candidate.features, &found);
        if contradicted || !enough && masked.as_ref().is_none_or(|masked| found.surpasses(masked)) {
            candidate.mask = None;
            return Ok(Some(found));
        }
        candidate.features = masked_features;
        Ok(masked)
    }

    fn follow(&self, active: &Active, candidate: &Candidate<'_>) -> Option<Localized> {
        let (stamp, features) = (candidate.frame.stamp(), &candidate.features);
        let (localizer, expectation) = (self.localizer(), active.expectation(stamp));
        let found = localizer.follow(features, &expectation, &mut self.rng.clone())?;
        let pose = UncertainPose::found(found.T_camera_world, &found.covariance);
        if !active.motion.is_unlikely(stamp, &pose) {
            return Some(found);
        }
        let found = localizer.reconsider(features, &expectation, found, &mut self.rng.clone());
        let Some(prior) = active.motion.prior(stamp) else { return Some(found) };
        Some(localizer.guided(features, &expectation, prior, found))
    }

    fn relocalize(&mut self, features: &ImageFeatures) -> Option<Localized> {
        if !self.config.places.relocalization {
            return None;
        }
        let ids = self.mapper.place_candidates(features.descriptors());
        let mut rng = self.rng.clone();
        let found = self.localizer().relocalize(features, ids.into_iter(), self.config.places.min_inliers, &mut rng);
        self.rng = rng;
        found
    }
}
