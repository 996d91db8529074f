//! Whether the surfaces of a frame are seen again where a camera motion puts them: what a motion is asked on which few corners agree.

use pfd_geometry::DepthNoise;

use super::luma;
use super::view::{Motion, Pinhole, ViewFrame};

/// Every how many pixels of the previous frame one is looked for. Odd, so that not only some columns are.
const SAMPLING: usize = 37;
/// Standard deviations by which the depth of what is seen again may differ, …
const DEPTH_SIGMAS: f32 = 3.5;
/// … and what this adds, relative to depth: few corners leave the motion inexact.
const RELATIVE_ERROR: f32 = 0.03;
/// Grey levels by which it may differ from what is seen within a pixel: shading and noise.
const LUMA_TOLERANCE: f32 = 20.0;

/// Share of the surfaces of the previous frame for which `counts` holds that the current one shows at the same depth and as bright, of those
/// that lie in its view and where it has depth.
pub(crate) fn seen_again(
    camera: &Pinhole,
    noise: &DepthNoise,
    (previous, current): (&ViewFrame, &ViewFrame),
    motion: &Motion,
    counts: impl Fn(usize) -> bool,
) -> f32 {
    let is_seen = |i: usize| {
        let z = previous.depth.pixels()[i];
        let moved = (z > 0.0 && counts(i)).then(|| motion.apply(camera.point(i, z))).filter(|p| p[2] > 0.0)?;
        let j = camera.nearest(camera.project(moved))?;
        let measured = current.depth.pixels()[j];
        let tolerance = DEPTH_SIGMAS * noise.difference_sigma(moved[2]) + RELATIVE_ERROR * moved[2];
        let is_as_bright = || {
            let beside = luma::range(camera, j, |j| Some(f32::from(current.gray.pixels()[j])));
            let gray = f32::from(previous.gray.pixels()[i]);
            beside.is_some_and(|[low, high]| (gray - gray.clamp(low, high)).abs() < LUMA_TOLERANCE)
        };
        (measured > 0.0).then(|| (measured - moved[2]).abs() < tolerance && is_as_bright())
    };
    let seen: Vec<bool> = (0..camera.pixels()).step_by(SAMPLING).filter_map(is_seen).collect();
    seen.iter().filter(|same| **same).count() as f32 / seen.len().max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::{Image, Pose, pose};

    const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 131.0, fy: 131.0, cx: 79.5, cy: 59.5 };

    /// A wall at 2 m with stripes of half a metre, from a camera that stands `x` metres to the right, and before its left half something at
    /// 1 m if it is `hidden`.
    fn wall(x: f32, hidden: bool) -> ViewFrame {
        let column = |i: usize| i % CAMERA.width;
        let luma = |i: usize| if ((CAMERA.point(i, 2.0)[0] + x) / 0.25).floor() as i32 % 2 == 0 { 50 } else { 200 };
        let depth = |i: usize| if hidden && column(i) < CAMERA.width / 2 { 1.0 } else { 2.0 };
        let all = 0..CAMERA.pixels();
        ViewFrame {
            gray: Image::from_vec(CAMERA.width, CAMERA.height, all.clone().map(luma).collect()).unwrap(),
            depth: Image::from_vec(CAMERA.width, CAMERA.height, all.map(depth).collect()).unwrap(),
        }
    }

    fn share(to_the_right: f64, current: &ViewFrame, counts: impl Fn(usize) -> bool) -> f32 {
        let motion: Pose = pose::exp(&nalgebra::Vector6::new(-to_the_right, 0.0, 0.0, 0.0, 0.0, 0.0));
        seen_again(&CAMERA, &DepthNoise::default(), (&wall(0.0, false), current), &Motion::from(&motion), counts)
    }

    #[test]
    fn the_right_motion_shows_everything_again_and_a_wrong_one_does_not() {
        let moved = wall(0.125, false);
        assert!(share(0.125, &moved, |_| true) > 0.95);
        assert!((0.5..0.7).contains(&share(0.0, &moved, |_| true)), "half of each stripe, and its rims");
        assert!(share(-0.125, &moved, |_| true) < 0.25, "but the rims");
    }

    #[test]
    fn what_is_hidden_is_not_seen_again_and_known_movers_do_not_count() {
        assert!((share(0.0, &wall(0.0, true), |_| true) - 0.5).abs() < 0.05);
        assert_eq!(share(0.0, &wall(0.0, true), |i| i % CAMERA.width >= CAMERA.width / 2), 1.0);
        assert_eq!(share(0.0, &wall(0.0, true), |_| false), 0.0);
    }
}
