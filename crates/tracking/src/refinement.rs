//! The last step of localisation: from where the detector puts corners in a rolling image to where they belong.

use nalgebra::Vector6;

use crate::alignment;
use crate::image_features::ImageFeatures;
use crate::localization::{Localized, Localizer};
use crate::matching::Match;
use crate::rolling_shutter::{Placement, Readout, Shutter, Sighting};

/// Refines poses, and learns the readout time of the camera from them.
#[derive(Debug)]
pub(crate) struct Refinement {
    readout: Readout,
}

impl Refinement {
    /// With a first guess of the readout time, seconds.
    pub(crate) fn new(readout: f64) -> Self {
        Self { readout: Readout::new(readout) }
    }

    /// The readout time by what was seen so far, seconds.
    pub(crate) fn readout(&self) -> f64 {
        self.readout.seconds()
    }

    /// Places the corners that show known points to a fraction of a pixel, refers all measurements to the time of the middle row by
    /// the camera's `velocity` (see [`Shutter`]), and estimates the pose again. The readout time is learnt from what is left.
    pub(crate) fn refine(
        &mut self,
        localizer: &Localizer<'_>,
        velocity: Vector6<f64>,
        features: &mut ImageFeatures,
        found: Localized,
    ) -> Localized {
        let (camera, config) = (localizer.camera, localizer.config);
        if config.alignment.enabled {
            alignment::align(localizer, &found.T_camera_world, &found.matches, features);
        }
        features.set_shutter(camera, Shutter { velocity, readout: self.readout() });
        let again = localizer.solve(features, found.matches.clone(), &found.T_camera_world, config.pose.min_inliers);
        let Some(refined) = again.filter(|r| 2 * r.matches.len() > found.matches.len()) else {
            // Then it is not the velocity that the camera has.
            features.set_shutter(camera, Shutter::default());
            return found;
        };
        if config.rolling_shutter.estimate {
            self.learn(localizer, features, &refined);
        }
        Localized { sought: found.sought, ..refined }
    }

    fn learn(&mut self, localizer: &Localizer<'_>, features: &ImageFeatures, refined: &Localized) {
        let sighting = |m: &Match| {
            let point = localizer.map.point(m.point)?;
            let placement = Placement::of(localizer.map, localizer.camera, point);
            Some(Sighting { point: point.position, feature: m.feature, placement })
        };
        let seen = refined.matches.iter().filter_map(sighting);
        self.readout.observe(localizer.camera, &refined.T_camera_world, features, seen);
    }
}
