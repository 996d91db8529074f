//! Camera motion from descriptors, where corners cannot be followed: after a jerk, a blurred frame or a gap what is seen lies too far from
//! where it was. Features of both frames are matched without regard to where they are; their motion is then a guess from which corners are
//! followed as usual.

use pfd_geometry::{DepthNoise, Pose};
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
    let tracks = with_depth(camera, &found, &previous.depth, &current.depth, trust);
    let tracks: Vec<_> = tracks.into_iter().map(|(_, track)| track).collect();
    let estimate = ego_motion::estimate(camera, noise, &tracks, &Pose::identity(), rng);
    Ok(estimate.map(|ego| ego.T_current_previous))
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

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::{Image, pose};
    use rand::SeedableRng;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// Rows of blocks of random luma on a wall at 2 m that has moved to the left by `shift` pixels, and holds nothing that was there
    /// before if it is `another`.
    fn wall(shift: usize, another: bool) -> ViewFrame {
        let level = |i: usize| {
            let (u, v) = (i % CAMERA.width + shift, i / CAMERA.width);
            let cell = ((u / 7) as u32 * 0x9E37_79B1) ^ ((v / 7) as u32 * 0x85EB_CA77) ^ u32::from(another);
            ((cell ^ (cell >> 15)).wrapping_mul(0x2C1B_3C6D) >> 24) as u8
        };
        let gray = (0..CAMERA.pixels()).map(level).collect();
        ViewFrame {
            gray: Image::from_vec(CAMERA.width, CAMERA.height, gray).unwrap(),
            depth: Image::filled(CAMERA.width, CAMERA.height, 2.0),
        }
    }

    fn guessed(current: &ViewFrame, trust: impl Fn(usize) -> f32) -> Option<Pose> {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        guess(&CAMERA, &DepthNoise::default(), (&wall(0, false), current), trust, &mut rng).unwrap()
    }

    #[test]
    fn a_jerk_by_a_third_of_the_view_is_found() {
        let shift = 105;
        let found = guessed(&wall(shift, false), |_| 1.0).unwrap();
        let truth = pose::exp(&nalgebra::Vector6::new(-2.0 * shift as f64 / 262.0, 0.0, 0.0, 0.0, 0.0, 0.0));
        assert!(pose::log(&(found * truth.inverse())).norm() < 0.02, "{found}");
    }

    #[test]
    fn another_room_has_hardly_any_matches_and_known_movers_give_no_guess() {
        let features = |frame: &ViewFrame| {
            let mut extractor = FeatureExtractor::new(OPTIONS);
            extractor.load(&frame.gray).unwrap();
            extractor.extract(None, 0).unwrap()
        };
        let found = |current: &ViewFrame| matches(&features(&wall(0, false)), &features(current)).len();
        let (here, elsewhere) = (found(&wall(105, false)), found(&wall(0, true)));
        assert!(here > 60 && elsewhere < here / 10, "{here} {elsewhere}");
        assert_eq!(guessed(&wall(105, false), |_| 0.0), None);
    }
}
