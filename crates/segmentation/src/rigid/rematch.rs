//! Camera motion from descriptors, where corners cannot be followed: after a jerk, a blurred frame or a gap what is seen lies too far from
//! where it was. Features of both frames are matched without regard to where they are; their motion is then a guess from which corners are
//! followed as usual.

use pfd_geometry::{DepthNoise, Image, Pose};
use pfd_vision::VisionError;
use pfd_vision::features::{Feature, FeatureExtractor, FeatureOptions};
use rand_pcg::Pcg64Mcg;

use super::corners::{Correspondence, with_depth};
use super::ego_motion;
use super::view::{Pinhole, ViewFrame};

/// Features of a frame.
const OPTIONS: FeatureOptions = FeatureOptions { count: 600, levels: 3, scale: 1.2, threshold: 20, low_threshold: 7 };
/// Bits in which the descriptors of one place differ at most, of 256.
const MAX_DISTANCE: u32 = 64;
/// A match is unique if no other one is nearer than it by less than this ratio (Lowe, IJCV 2004, section 7.1).
const UNIQUE: f32 = 0.8;

/// A guess of `T_current_previous` that owes nothing to a prediction. Pixels of the previous frame count by `trust`.
pub(crate) fn guess(
    camera: &Pinhole,
    noise: &DepthNoise,
    (previous, current): (&ViewFrame, &ViewFrame),
    trust: impl Fn(usize) -> f32,
    rng: &mut Pcg64Mcg,
) -> Result<Option<Pose>, VisionError> {
    let mut extractor = FeatureExtractor::new(OPTIONS);
    let mut features = |frame: &ViewFrame| {
        extractor.load(&frame.gray)?;
        extractor.extract(None, 0)
    };
    let (then, now) = (features(previous)?, features(current)?);
    let found = matches(&then, &now);
    let tracks = tracks(camera, &found, [&previous.depth, &current.depth], trust);
    let estimate = ego_motion::estimate(camera, noise, &tracks, &Pose::identity(), rng);
    Ok(estimate.map(|ego| ego.T_current_previous))
}

fn tracks(
    camera: &Pinhole,
    found: &[Correspondence],
    [previous, current]: [&Image<f32>; 2],
    trust: impl Fn(usize) -> f32,
) -> Vec<ego_motion::Track> {
    with_depth(camera, found, previous, current, trust).into_iter().map(|(_, track)| track).collect()
}

/// Pairs of features of which each is the other's nearest, and by far.
fn matches(then: &[Feature], now: &[Feature]) -> Vec<Correspondence> {
    let forward: Vec<Option<usize>> = then.iter().map(|f| nearest(f, now)).collect();
    let backward: Vec<Option<usize>> = now.iter().map(|f| nearest(f, then)).collect();
    let pairs = forward.into_iter().enumerate().filter_map(|(i, j)| Some((i, j?)));
    let mutual = pairs.filter(|&(i, j)| backward[j] == Some(i));
    mutual.map(|(i, j)| Correspondence { from: [then[i].u, then[i].v], to: [now[j].u, now[j].v] }).collect()
}

/// The feature with the nearest descriptor, if it is near and no other is nearly as near.
fn nearest(feature: &Feature, among: &[Feature]) -> Option<usize> {
    let (mut best, mut second) = ((u32::MAX, 0), u32::MAX);
    for (j, other) in among.iter().enumerate() {
        let distance = feature.descriptor.distance(&other.descriptor);
        if distance < best.0 {
            (second, best) = (best.0, (distance, j));
        } else {
            second = second.min(distance);
        }
    }
    (best.0 <= MAX_DISTANCE && (best.0 as f32) < UNIQUE * second as f32).then_some(best.1)
}
