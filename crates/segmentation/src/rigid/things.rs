//! Which surfaces move as a whole: by the corners on them, or because a part of them moves.

use pfd_geometry::DepthNoise;
use rand_pcg::Pcg64Mcg;

use super::motion::CornerMove;
use super::objects::Objects;
use super::planes::planar_share;
use super::regions::BACKGROUND;
use super::surfaces::Surfaces;
use super::view::Pinhole;
use super::votes::Votes;

/// Share of a thing that must be seen to move for all of it to count as moving: about an arm of a person.
const MOVING_PART: f32 = 0.12;
/// A thing of which most corners move stands before its surroundings on at least this share of its border; …
const MOVER_FRONT: f32 = 0.75;
/// … more is asked where only a part moves: a mover that touches a desk connects with it, and a desk stands before much, too.
const THING_FRONT: f32 = 0.9;
/// Furniture is mostly planar and people are not: a still part with more than this share on one plane is what a mover touches.
const MAX_PLANAR: f32 = 0.8;
/// Of what a mover merely touches less than this share is taken for moving: a thing of which more moves does so as a whole, planar or not.
const MOSTLY_MOVING: f32 = 0.5;

/// For each surface, whether it is a thing on which most corners move on their own.
pub(crate) fn that_move(surfaces: &Surfaces, camera: &Pinhole, corners: &[CornerMove]) -> Vec<bool> {
    let mut votes = vec![Votes::default(); surfaces.list.len()];
    for (surface, chi2) in corners.iter().filter_map(|c| Some((surfaces.labels[c.to], c.chi2?))) {
        if let Some(votes) = votes.get_mut(surface as usize) {
            votes.add(chi2);
        }
    }
    votes
        .iter()
        .zip(&surfaces.list)
        .map(|(votes, surface)| votes.agree_on_motion(surface.pixels) && surface.is_thing(camera, MOVER_FRONT))
        .collect()
}

/// For each surface the label of the object that it belongs to as a whole, or [`BACKGROUND`].
pub(crate) fn owners(
    objects: &Objects,
    surfaces: &Surfaces,
    (camera, noise, depth): (&Pinhole, &DepthNoise, &[f32]),
    rng: &mut Pcg64Mcg,
) -> Vec<u16> {
    let is_still = |i: usize| objects.labels[i] == BACKGROUND;
    objects.owners(surfaces, |index, moving| {
        let surface = &surfaces.list[index];
        let share = moving as f32 / surface.pixels.max(1) as f32;
        let curved = |rng| {
            let points = surfaces.sample(index as u32, is_still, camera, depth);
            planar_share(&points, noise, rng) < MAX_PLANAR
        };
        let whole = |rng| share > MOSTLY_MOVING || curved(rng);
        share > MOVING_PART && surface.is_thing(camera, THING_FRONT) && whole(&mut *rng)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::regions::Component;
    use rand::SeedableRng;

    const CAMERA: Pinhole = Pinhole { width: 40, height: 20, fx: 40.0, fy: 40.0, cx: 19.5, cy: 9.5 };

    /// Whether a flat plate before a wall, of which the left `columns` of twenty were found to move, moves as a whole.
    fn plate_moves(columns: usize) -> bool {
        let on_plate = |i: usize| (10..30).contains(&(i % 40)) && (4..16).contains(&(i / 40));
        let depth: Vec<f32> = (0..800).map(|i| if on_plate(i) { 1.0 } else { 2.0 }).collect();
        let moving: Vec<u32> = (0..800).filter(|&i| on_plate(i) && i % 40 < 10 + columns).map(|i| i as u32).collect();
        let mut objects = Objects::default();
        objects.clear(800);
        objects.update(vec![Component { pixels: moving }], &[0.0; 800], 0.0);
        let mut surfaces = Surfaces::default();
        surfaces.find(&CAMERA, &DepthNoise::default(), &depth);
        surfaces.describe(&CAMERA, &depth, |i| (objects.labels[i] == BACKGROUND).then_some(0.5));
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let owners = owners(&objects, &surfaces, (&CAMERA, &DepthNoise::default(), &depth), &mut rng);
        owners[surfaces.labels[10 * 40 + 25] as usize] != BACKGROUND
    }

    #[test]
    fn a_flat_thing_moves_as_a_whole_when_most_of_it_does() {
        assert!(!plate_moves(6), "this may be a desk that somebody touches");
        assert!(plate_moves(12));
    }
}
