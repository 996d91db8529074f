//! Algorithm 1: the transformation between frames by GMS and optical flow (paper, section 3.1).

mod difference;
pub mod gms;
mod matching;

use nalgebra::Matrix3;
use pfd_geometry::GrayImage;
use pfd_vision::VisionError;
use pfd_vision::corners::strongest_corners;
use pfd_vision::features::{Feature, FeatureExtractor, FeatureOptions};
use pfd_vision::optical_flow::{FlowOptions, FlowPyramid, track_points};
use pfd_vision::two_view::{epipolar_distance, fundamental, homography};

pub(crate) use difference::difference;
use gms::GmsOptions;

use crate::config::PaperConfig;

/// Positions of the same points in both frames.
#[derive(Clone, Debug, Default)]
struct Pairs {
    previous: Vec<[f32; 2]>,
    current: Vec<[f32; 2]>,
}

impl Pairs {
    /// The pairs for which `keep` holds, and the others.
    fn split(self, keep: impl Fn(usize) -> bool) -> (Self, Self) {
        let (mut kept, mut others) = (Self::default(), Self::default());
        for (k, pair) in self.previous.into_iter().zip(self.current).enumerate() {
            let target = if keep(k) { &mut kept } else { &mut others };
            target.previous.push(pair.0);
            target.current.push(pair.1);
        }
        (kept, others)
    }
}

/// What algorithm 1 finds.
#[derive(Clone, Debug)]
pub(crate) struct Transformation {
    /// Previous pixels to current pixels, if enough points agree on one.
    pub(crate) homography: Option<Matrix3<f64>>,
    /// Points from which it was estimated.
    pub(crate) inliers: usize,
    /// Points of the current frame that do not follow the camera.
    pub(crate) rejected: Vec<[f32; 2]>,
}

/// Corners of `goodFeaturesToTrack` that are followed besides the matches.
const CORNERS: usize = 300;
/// Weakest corner relative to the strongest, and least distance in pixels: the usual values of `goodFeaturesToTrack`.
const CORNER_QUALITY: f64 = 0.01;
const CORNER_DISTANCE: f64 = 10.0;
/// Reprojection threshold of the homography, pixels.
const HOMOGRAPHY_THRESHOLD: f64 = 3.0;

/// Runs algorithm 1 from frame to frame.
pub(crate) struct InterFrame {
    config: PaperConfig,
    extractor: FeatureExtractor,
    flow: FlowOptions,
    features: Vec<Feature>,
    previous: FlowPyramid,
    current: FlowPyramid,
    corners: Vec<[f32; 2]>,
}

impl std::fmt::Debug for InterFrame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("InterFrame").field("features", &self.features.len()).finish_non_exhaustive()
    }
}

impl InterFrame {
    pub(crate) fn new(config: PaperConfig) -> Self {
        let options = FeatureOptions { count: config.features, levels: 8, scale: 1.2, threshold: 20, low_threshold: 7 };
        Self {
            config,
            extractor: FeatureExtractor::new(options),
            flow: FlowOptions { window: 21, ..FlowOptions::default() },
            features: Vec::new(),
            previous: FlowPyramid::default(),
            current: FlowPyramid::default(),
            corners: Vec::new(),
        }
    }

    /// The transformation from the previous frame to `gray`; `None` for the first frame and where too few points match.
    pub(crate) fn step(&mut self, gray: &GrayImage) -> Result<Option<Transformation>, VisionError> {
        self.extractor.load(gray)?;
        let features = self.extractor.extract(None, 0)?; // step 0
        self.current.rebuild(gray, &self.flow)?;
        let found = if self.previous.is_empty() { None } else { self.relate(&features, gray.size())? };
        std::mem::swap(&mut self.previous, &mut self.current);
        self.features = features;
        self.corners = strongest_corners(gray, CORNERS, CORNER_QUALITY, CORNER_DISTANCE)?;
        Ok(found)
    }

    fn relate(&self, features: &[Feature], size: (usize, usize)) -> Result<Option<Transformation>, VisionError> {
        let (previous, current) = matching::brute_force(&self.features, features);
        let options = GmsOptions { rotation: true, scale: true };
        let good = gms::filter(&previous, &current, [size, size], options);
        let (matches, _) = Pairs { previous, current }.split(|k| good[k]); // step 1: M
        let limit = self.config.epipolar_distance;
        let Some(f) = fundamental(&matches.previous, &matches.current, limit)? else { return Ok(None) };
        let (matches, outliers) = matches.split(|k| f.inliers.get(k).copied().unwrap_or(false)); // step 2: M'
        let (mut matches, slipped) = self.three_sigma(matches)?; // steps 3 and 4
        // Estimated anew from what is left: the points that were used for the first estimate all agree with it.
        let f = fundamental(&matches.previous, &matches.current, limit)?.unwrap_or(f);
        self.add_corners(&mut matches)?;
        let on_line = |k: usize| epipolar_distance(&f.matrix, matches.previous[k], matches.current[k]) <= limit;
        let keep: Vec<bool> = (0..matches.previous.len()).map(on_line).collect();
        let (kept, off_line) = matches.split(|k| keep[k]); // step 5: M''
        let homography = homography(&kept.previous, &kept.current, HOMOGRAPHY_THRESHOLD)?.map(|h| h.matrix); // step 6
        let rejected = [outliers.current, slipped.current, off_line.current].concat();
        Ok(Some(Transformation { homography, inliers: kept.previous.len(), rejected }))
    }

    /// Drops matches whose matched and tracked positions differ by more than three standard deviations from the mean.
    fn three_sigma(&self, matches: Pairs) -> Result<(Pairs, Pairs), VisionError> {
        let tracked = track_points(&self.previous, &self.current, &matches.previous, None, &self.flow)?;
        let distance = |k: usize| {
            let (t, m) = (tracked[k]?, matches.current[k]);
            Some(f64::from((t[0] - m[0]).hypot(t[1] - m[1])))
        };
        let distances: Vec<Option<f64>> = (0..tracked.len()).map(distance).collect();
        let known: Vec<f64> = distances.iter().flatten().copied().collect();
        let limit = upper_limit(&known, self.config.flow_sigmas);
        Ok(matches.split(|k| distances[k].is_some_and(|d| d <= limit)))
    }

    /// Adds the corners of `goodFeaturesToTrack`, followed by optical flow.
    fn add_corners(&self, pairs: &mut Pairs) -> Result<(), VisionError> {
        let tracked = track_points(&self.previous, &self.current, &self.corners, None, &self.flow)?;
        for (corner, position) in self.corners.iter().zip(tracked) {
            if let Some(position) = position {
                pairs.previous.push(*corner);
                pairs.current.push(position);
            }
        }
        Ok(())
    }
}

/// Mean plus `sigmas` standard deviations.
fn upper_limit(values: &[f64], sigmas: f64) -> f64 {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n;
    mean + sigmas * variance.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_sigma_limit_of_known_values() {
        // Mean 2, standard deviation 1.
        assert!((upper_limit(&[1.0, 3.0, 1.0, 3.0], 3.0) - 5.0).abs() < 1e-12);
        assert_eq!(upper_limit(&[], 3.0), 0.0);
    }
}
