//! Finding the camera in the whole map, without a prediction.

use nalgebra::Point3;
use pfd_geometry::{Pose, alignment};
use rand::RngExt;
use rand_pcg::Pcg32;

use crate::image_features::ImageFeatures;
use crate::localization::{Localized, Localizer};
use crate::map::KeyframeId;
use crate::matching::Match;

/// Samples of three points that are tried.
const SAMPLES: usize = 100;
/// A sample's agreement, in standard deviations of the depth sensor.
const INLIER_SIGMAS: f64 = 4.0;
/// Agreement is not asked to be better than this (metres): map points have errors of their own.
const INLIER_FLOOR: f64 = 0.02;
/// Matches that a first pose must explain.
const MIN_MATCHES: usize = 12;

impl Localizer<'_> {
    /// Tries keyframes in turn and returns the first pose that enough of the map supports.
    pub fn relocalize(
        &self,
        features: &ImageFeatures,
        candidates: impl Iterator<Item = KeyframeId>,
        min_inliers: usize,
        rng: &mut Pcg32,
    ) -> Option<Localized> {
        candidates.take(self.config.places.candidates).find_map(|keyframe| {
            let first = self.locate_by_keyframe(features, keyframe, rng)?;
            let settled = self.settle(features, &first)?;
            (settled.matches.len() >= min_inliers).then_some(settled)
        })
    }

    /// The pose that most matches with one keyframe agree on.
    pub fn locate_by_keyframe(
        &self,
        features: &ImageFeatures,
        keyframe: KeyframeId,
        rng: &mut Pcg32,
    ) -> Option<Localized> {
        let matches = self.match_keyframe(features, keyframe);
        let initial = self.sample_consensus(features, &matches, rng)?;
        self.solve(features, matches, &initial, MIN_MATCHES)
    }

    /// RANSAC (Fischler and Bolles 1981) over rigid motions of three matches with depth. Returns world to camera.
    pub(crate) fn sample_consensus(
        &self,
        features: &ImageFeatures,
        matches: &[Match],
        rng: &mut Pcg32,
    ) -> Option<Pose> {
        let pairs: Vec<_> = matches.iter().filter_map(|m| self.point_pair(features, m)).collect();
        if pairs.len() < MIN_MATCHES {
            return None;
        }
        let agrees = |pose: &Pose, (in_camera, in_world): &(Point3<f64>, Point3<f64>)| {
            let tolerance = INLIER_FLOOR.max(INLIER_SIGMAS * self.config.depth_noise.sigma(in_camera.z));
            (pose * in_world - in_camera).norm() < tolerance
        };
        let mut best: Option<(usize, Pose)> = None;
        for _ in 0..SAMPLES {
            let sample: [_; 3] = std::array::from_fn(|_| pairs[rng.random_range(0..pairs.len())]);
            let Some(pose) = alignment::align(&sample) else { continue };
            let support = pairs.iter().filter(|pair| agrees(&pose, pair)).count();
            if best.is_none_or(|(most, _)| support > most) {
                best = Some((support, pose));
            }
        }
        best.filter(|(support, _)| *support >= MIN_MATCHES).map(|(_, pose)| pose)
    }

    /// A match as a point in the camera and in the world.
    fn point_pair(&self, features: &ImageFeatures, m: &Match) -> Option<(Point3<f64>, Point3<f64>)> {
        Some((features.point_in_camera(m.feature, self.camera)?, self.map.point(m.point)?.position))
    }
}
