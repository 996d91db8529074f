//! Whether a region that continues no known object is a mover, judged as a whole.
//!
//! Pixel by pixel, evidence is a share of the information that there is, so that little of it can still mean much: that finds plain
//! things and, where the camera moves fast, others that are none. A region has pixels enough to ask how much speaks for motion and
//! how much against. Its log-odds are a sum over the cues, each of which saturates; the weights are those of a logistic regression
//! on regions of known truth (`cargo run --example fit_credibility`; the README has the figures). They say how far each test of motion
//! is to be trusted, nothing of what movers look like.

use super::evidence::Cue;

/// Mean weight per pixel at which a cue has half of its effect: a clear difference of depth on one to two pixels in ten.
const HALF: f32 = 0.2;
/// Log-odds of a region of which nothing is known.
const BIAS: f32 = -2.0;
/// Log-odds that each cue brings at most, in the order of [`Cue`]. Other luma says next to nothing: the weight was
/// found while it counted only where depth is missing, and reflections and the sensor's shadows have it there as often as movers.
const WEIGHTS: [f32; Cue::COUNT] = [2.2, 4.7, 0.2, 5.6, 4.4, -7.8, -9.9, -6.0];

/// Log-odds that a region which [`has_moved`] brings where it reaches the border of the image: what is new has come in somewhere. Of the
/// new regions of 36 sequences two thirds of the movers do and a ninth of the others. A regression gives 2, but says nothing of rooms
/// with other ways in; with all of it up to 6 instead of 3 % of a frame are masked where nothing moves.
const AT_BORDER: f32 = 1.0;

/// Log-odds from which a region is believed that particles or the static model support, …
const SUPPORTED: f32 = -0.3;
/// … any other, …
const ALONE: f32 = 0.5;
/// … and each where the camera motion is uncertain: particles gather on what that feigns as well.
const UNCERTAIN: f32 = 1.8;
/// Less than this share of the corners elsewhere follows the camera where its motion is uncertain: it turns so fast that rolling shutter
/// and blur bend the image.
const CERTAIN_AGREEMENT: f32 = 0.9;

/// Strength from which a cue of motion speaks: a clear difference on one pixel in a hundred.
const SPEAKS: f32 = 0.05;

/// Whether a region's depth says that it has moved, and not only its texture.
pub(crate) fn depth_speaks(strengths: &[f32; Cue::COUNT]) -> bool {
    [Cue::FreeSpace, Cue::BeforeModel].into_iter().any(|cue| strengths[cue as usize] > SPEAKS)
}

/// Whether depth or corners say that a region has moved, and not only its looks: light that changes has no part in these.
fn has_moved(strengths: &[f32; Cue::COUNT]) -> bool {
    depth_speaks(strengths) || strengths[Cue::OwnMotion as usize] > SPEAKS
}

/// What is known of a new region besides its cues.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Circumstances {
    /// Whether particles or the static model support it.
    pub(crate) supported: bool,
    /// Whether it reaches the border of the image.
    pub(crate) at_border: bool,
    /// Share of the corners beside all such regions and known movers that follow the camera.
    pub(crate) agreement: f32,
}

/// Whether a region with these [`strengths`] of the cues is believed to be a mover.
pub(crate) fn is_believed(strengths: &[f32; Cue::COUNT], region: Circumstances) -> bool {
    let entering = region.at_border && has_moved(strengths);
    log_odds(strengths) + if entering { AT_BORDER } else { 0.0 } > limit(region.supported, region.agreement)
}

/// Log-odds that a region with these [`strengths`] of the cues is a mover.
fn log_odds(strengths: &[f32; Cue::COUNT]) -> f32 {
    BIAS + WEIGHTS.iter().zip(strengths).map(|(weight, strength)| weight * strength).sum::<f32>()
}

/// Whether all cues on these pixels together speak for motion rather than against it.
pub(crate) fn speaks_for_motion(cues: &[[f32; Cue::COUNT]], pixels: &[u32]) -> bool {
    log_odds(&strengths(cues, pixels)) > BIAS
}

/// How strong each cue is on the region of `pixels`, 0 to 1, from the weights of the cues on each pixel of the view.
pub(crate) fn strengths(cues: &[[f32; Cue::COUNT]], pixels: &[u32]) -> [f32; Cue::COUNT] {
    let mut sums = [0.0; Cue::COUNT];
    for &i in pixels {
        for (sum, weight) in sums.iter_mut().zip(cues[i as usize]) {
            *sum += weight;
        }
    }
    sums.map(|sum| sum / (sum + HALF * pixels.len() as f32))
}

/// Log-odds from which a region is believed, if `agreement` is the share of the corners beside all such regions and known movers that
/// follow the camera.
fn limit(supported: bool, agreement: f32) -> f32 {
    match supported {
        _ if agreement < CERTAIN_AGREEMENT => UNCERTAIN,
        true => SUPPORTED,
        false => ALONE,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Log-odds of a region of which each pixel has these weights of cues.
    fn judged(cues: &[(Cue, f32)]) -> f32 {
        let mut pixel = [0.0; Cue::COUNT];
        for &(cue, weight) in cues {
            pixel[cue as usize] += weight;
        }
        log_odds(&strengths(&[pixel; 4], &[0, 1, 3]))
    }

    #[test]
    fn a_cue_has_half_of_its_effect_at_half_of_its_weight_and_saturates() {
        let cues = [[0.0; Cue::COUNT], [2.0 * HALF; Cue::COUNT]];
        assert_eq!(strengths(&cues, &[0, 1]), [0.5; Cue::COUNT], "the mean over the region counts");
        assert_eq!(strengths(&cues, &[0]), [0.0; Cue::COUNT]);
        assert!(strengths(&[[1e6; Cue::COUNT]], &[0]).iter().all(|s| (0.99..=1.0).contains(s)));
    }

    #[test]
    fn what_comes_in_with_other_texture_is_a_mover_and_what_looks_the_same_is_none() {
        let came_in = [(Cue::BeforeModel, 1.5), (Cue::FreeSpace, 1.0), (Cue::OtherTexture, 0.1)];
        assert!(judged(&came_in) > limit(false, 1.0));
        assert!(judged(&[(Cue::SameTexture, 0.2), (Cue::SamePlace, 0.1)]) < limit(true, 1.0));
        assert!(judged(&[(Cue::OtherTexture, 0.03)]) < limit(true, 1.0), "a trace of other texture is noise");
    }

    #[test]
    fn cues_speak_for_motion_or_against_it() {
        let speak = |cue: Cue| {
            let mut cues = [[0.0; Cue::COUNT]; 2];
            cues[1][cue as usize] = 0.1;
            speaks_for_motion(&cues, &[0, 1])
        };
        assert_eq!(
            [Cue::OwnMotion, Cue::BeforeModel, Cue::SameTexture, Cue::SamePlace].map(speak),
            [true, true, false, false]
        );
        assert!(!speaks_for_motion(&[[0.0; Cue::COUNT]], &[0]), "nothing is known");
    }

    #[test]
    fn depth_speaks_from_one_clear_pixel_in_a_hundred_on() {
        let speaks = |cue: Cue, pixels: usize| {
            let mut cues = [[0.0; Cue::COUNT]; 400];
            cues[..pixels].iter_mut().for_each(|c| c[cue as usize] = 1.0);
            let all: Vec<u32> = (0..400).collect();
            depth_speaks(&strengths(&cues, &all))
        };
        assert!(speaks(Cue::FreeSpace, 5) && speaks(Cue::BeforeModel, 5));
        assert!(!speaks(Cue::FreeSpace, 3) && !speaks(Cue::OwnMotion, 400));
    }

    #[test]
    fn looks_alone_are_no_motion() {
        let speaks = |cue: Cue| {
            let mut cues = [[0.0; Cue::COUNT]];
            cues[0][cue as usize] = 0.1;
            has_moved(&strengths(&cues, &[0]))
        };
        assert_eq!([Cue::FreeSpace, Cue::BeforeModel, Cue::OwnMotion].map(speaks), [true; 3]);
        assert_eq!([Cue::OtherTexture, Cue::OtherLuma, Cue::SamePlace].map(speaks), [false; 3]);
    }

    #[test]
    fn particles_tip_the_scales() {
        let corners = judged(&[(Cue::OwnMotion, 0.6), (Cue::OtherTexture, 0.05), (Cue::SameTexture, 0.1)]);
        assert!(corners > limit(true, 1.0) && corners < limit(false, 1.0), "{corners}");
    }

    #[test]
    fn where_the_camera_motion_is_uncertain_a_region_alone_needs_more() {
        let doubtful = judged(&[
            (Cue::FreeSpace, 0.4),
            (Cue::BeforeModel, 0.2),
            (Cue::OtherTexture, 0.05),
            (Cue::SameTexture, 0.05),
        ]);
        assert!(doubtful > limit(false, 0.95) && doubtful < limit(false, 0.7), "{doubtful}");
        assert_eq!(limit(true, 0.7), limit(false, 0.7), "particles gather on what the wrong motion feigns as well");
    }
}
