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
        let in_part = moving as f32 > MOVING_PART * surface.pixels as f32;
        let curved = |rng| {
            let points = surfaces.sample(index as u32, is_still, camera, depth);
            planar_share(&points, noise, rng) < MAX_PLANAR
        };
        in_part && surface.is_thing(camera, THING_FRONT) && curved(&mut *rng)
    })
}
