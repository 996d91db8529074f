//! What has surely stayed as it was: pixels that look exactly as in the static model, among others that do.
//!
//! To within what a calibration, a shadow and a warp may be wrong by, movers often agree with what they hide: where they touch it, and where
//! clothes are as dark. To within noise, and most pixels of a neighbourhood at once, they hardly ever do.

use super::static_model::ModelPoint;
use super::view::Pinhole;

/// Luma difference that noise explains, grey levels: two and a half standard deviations of shot noise and JPEG coding.
const LUMA_NOISE: f32 = 10.0;
/// Share of its depth by which a surface may be nearer than the model: less than calibration may be wrong by, as it is the same here in both.
const NEARER: f32 = 0.01;
/// Half of the side of a neighbourhood, working pixels.
const RADIUS: usize = 2;
/// Share of a neighbourhood that is most of it.
const MOST: f32 = 0.5;

/// Whether a pixel at depth `z`, metres, that agrees with the model's `point` in depth shows just that point; `luma`: how much brighter it
/// is, grey levels.
pub(crate) fn shows(point: &ModelPoint, z: f32, luma: f32) -> bool {
    point.certainty() >= 1.0 && luma.abs() < LUMA_NOISE && z > (1.0 - NEARER) * point.position[2]
}

/// Whether pixel `i` and most of those around it are `unchanged`.
pub(crate) fn is_among_its_like(camera: &Pinhole, unchanged: &[bool], i: usize) -> bool {
    if !unchanged[i] {
        return false;
    }
    let (u, v) = (i % camera.width, i / camera.width);
    let columns = u.saturating_sub(RADIUS)..(u + RADIUS + 1).min(camera.width);
    let rows = v.saturating_sub(RADIUS)..(v + RADIUS + 1).min(camera.height);
    let alike = rows.flat_map(|y| &unchanged[y * camera.width..][columns.clone()]).filter(|same| **same).count();
    alike as f32 > MOST * ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 12, height: 9, fx: 10.0, fy: 10.0, cx: 5.5, cy: 4.0 };

    #[test]
    fn what_shows_a_point_is_as_bright_and_no_nearer() {
        let point = |hits: f32| ModelPoint { position: [0.0, 0.0, 2.0], gray: 100.0, hits };
        assert!(shows(&point(10.0), 2.0, -9.0));
        assert!(!shows(&point(9.0), 2.0, 0.0), "it was not seen often");
        assert!(!shows(&point(10.0), 2.0, 11.0), "it is brighter");
        assert!(!shows(&point(10.0), 1.97, 0.0), "something touches it");
        assert!(shows(&point(10.0), 2.05, 0.0));
    }

    #[test]
    fn single_pixels_agree_by_chance() {
        let mut unchanged = vec![false; CAMERA.width * CAMERA.height];
        let at = |u: usize, v: usize| v * CAMERA.width + u;
        unchanged[at(2, 2)] = true;
        for v in 0..9 {
            (6..12).for_each(|u| unchanged[at(u, v)] = true);
        }
        unchanged[at(9, 4)] = false;
        let asked = [(2, 2), (5, 4), (6, 4), (8, 4), (9, 4)];
        let among = asked.map(|(u, v)| is_among_its_like(&CAMERA, &unchanged, at(u, v)));
        assert_eq!(among, [false, false, true, true, false]);
        assert!(
            !is_among_its_like(&CAMERA, &unchanged, at(11, 8)),
            "of a corner of the image nine pixels are not most of 25"
        );
    }
}
