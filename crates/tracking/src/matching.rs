//! Association of map points with features.

use nalgebra::{Point2, Point3};
use pfd_geometry::{Camera, Pose};
use pfd_vision::features::Descriptor;

use crate::config::TrackingConfig;
use crate::image_features::ImageFeatures;
use crate::map::{MapPoint, MapPointId};

/// A map point and the feature that shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Match {
    /// Which point.
    pub point: MapPointId,
    /// Index of the feature.
    pub feature: usize,
    /// Differing bits.
    pub distance: u32,
}

/// Where and how large a map point should appear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Pixel.
    pub pixel: Point2<f64>,
    /// Depth, metres.
    pub depth: f64,
    /// Pyramid level.
    pub level: u8,
}

/// Cosine of the largest angle between the current and the mean viewing direction: 60 degrees.
const MIN_VIEWING_COSINE: f64 = 0.5;
/// Features may lie on levels that differ by this much from the prediction.
const LEVEL_TOLERANCE: u8 = 1;

/// Predicts where `point` appears; `None` outside the image, behind the camera, or seen from too different a direction.
#[allow(non_snake_case)]
pub fn predict(
    camera: &Camera,
    T_camera_world: &Pose,
    point: &MapPoint,
    config: &TrackingConfig,
) -> Option<Prediction> {
    let in_camera = T_camera_world * point.position;
    let pixel = camera.project(&in_camera).filter(|p| camera.contains(p, 0.0))?;
    let centre = T_camera_world.inverse_transform_point(&Point3::origin());
    let ray = point.position - centre;
    let distance = ray.norm();
    if ray.dot(point.viewing_direction()) < MIN_VIEWING_COSINE * distance {
        return None;
    }
    let level = point.predict_level(distance, config.features.scale, config.features.levels);
    Some(Prediction { pixel, depth: in_camera.z, level })
}

/// Matches predicted points with features within `radius` pixels (of the finest level, growing with the level).
///
/// Every feature is used once and every point once; the pairs with the smallest distance come first.
pub fn match_by_projection<'a>(
    candidates: impl Iterator<Item = (MapPointId, &'a MapPoint, Prediction)>,
    features: &ImageFeatures,
    radius: f64,
    config: &TrackingConfig,
) -> Vec<Match> {
    let mut proposals = Vec::new();
    for (id, point, prediction) in candidates {
        if let Some((feature, distance)) = best_feature(point.descriptor(), &prediction, features, radius, config) {
            proposals.push(Match { point: id, feature, distance });
        }
    }
    one_to_one(proposals, features.len())
}

/// The feature near the prediction that looks most like `descriptor`, if it looks alike enough and clearly more so than others.
fn best_feature(
    descriptor: &Descriptor,
    prediction: &Prediction,
    features: &ImageFeatures,
    radius: f64,
    config: &TrackingConfig,
) -> Option<(usize, u32)> {
    let scaled = radius * config.features.options().level_scale(prediction.level);
    let mut best: Option<(usize, u32)> = None;
    let mut second: Option<(usize, u32)> = None;
    for index in features.near(&prediction.pixel, scaled) {
        let feature = features.feature(index);
        if feature.level.abs_diff(prediction.level) > LEVEL_TOLERANCE {
            continue;
        }
        let distance = descriptor.distance(&feature.descriptor);
        if best.is_none_or(|(_, least)| distance < least) {
            second = best.replace((index, distance));
        } else if second.is_none_or(|(_, less)| distance < less) {
            second = Some((index, distance));
        }
    }
    // The same corner often shows on two levels with like descriptors: only a rival on the same level makes the best doubtful.
    let (index, distance) = best?;
    let level = |index: usize| features.feature(index).level;
    let rival = second.filter(|(other, _)| level(*other) == level(index)).map_or(u32::MAX, |(_, distance)| distance);
    is_distinct(distance, rival, config).then_some((index, distance))
}

fn is_distinct(best: u32, second: u32, config: &TrackingConfig) -> bool {
    best <= config.matching.max_distance && f64::from(best) <= config.matching.max_ratio * f64::from(second)
}

/// Keeps the best proposals such that every feature appears once.
fn one_to_one(mut proposals: Vec<Match>, features: usize) -> Vec<Match> {
    proposals.sort_by_key(|m| (m.distance, m.feature, m.point));
    let mut taken = vec![false; features];
    proposals.retain(|m| !std::mem::replace(&mut taken[m.feature], true));
    proposals
}

/// Matches descriptors regardless of position: mutual nearest neighbours that pass the distance and ratio tests.
///
/// Returns index pairs `(query, train)`.
pub fn match_descriptors(
    query: &[(usize, Descriptor)],
    train: &[(usize, Descriptor)],
    config: &TrackingConfig,
) -> Vec<(usize, usize)> {
    let descriptors = |of: &[(usize, Descriptor)]| of.iter().map(|(_, d)| *d).collect::<Vec<_>>();
    let (queries, trains) = (descriptors(query), descriptors(train));
    let nearest = |from: &Descriptor, to: &[Descriptor]| {
        from.nearest(to).filter(|found| is_distinct(found.distance, found.second, config)).map(|found| found.index)
    };
    let mutual = |(position, descriptor): (usize, &Descriptor)| {
        let other = nearest(descriptor, &trains)?;
        (nearest(&trains[other], &queries) == Some(position)).then_some((query[position].0, train[other].0))
    };
    queries.iter().enumerate().filter_map(mutual).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn random_descriptors(count: usize, seed: u64) -> Vec<(usize, Descriptor)> {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(seed);
        (0..count).map(|i| (i, Descriptor(std::array::from_fn(|_| rng.random())))).collect()
    }

    #[test]
    fn shuffled_descriptors_find_each_other() {
        let train = random_descriptors(100, 1);
        let mut query: Vec<_> = train.iter().rev().map(|&(i, d)| (i + 1000, d)).collect();
        for (_, descriptor) in &mut query {
            descriptor.0[0] ^= 0b1011;
        }
        let matches = match_descriptors(&query, &train, &TrackingConfig::default());
        assert_eq!(matches.len(), 100);
        assert!(matches.iter().all(|(q, t)| q - 1000 == *t));
    }

    #[test]
    fn unrelated_descriptors_do_not_match() {
        let matches =
            match_descriptors(&random_descriptors(100, 1), &random_descriptors(100, 2), &TrackingConfig::default());
        assert!(matches.len() <= 2, "{matches:?}");
    }

    #[test]
    fn a_feature_is_used_once() {
        let proposal = |feature, distance| Match { point: MapPointId::default(), feature, distance };
        let kept = one_to_one(vec![proposal(3, 20), proposal(3, 10), proposal(1, 30)], 5);
        assert_eq!(kept, vec![proposal(3, 10), proposal(1, 30)]);
    }
}
