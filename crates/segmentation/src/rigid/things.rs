//! Which surfaces move as a whole: by the corners on them, because a part of them moves, or because they are rigid.

use pfd_geometry::DepthNoise;
use rand_pcg::Pcg64Mcg;

use super::motion::CornerMove;
use super::objects::Objects;
use super::planes::planar_share;
use super::regions::BACKGROUND;
use super::surfaces::{Standing, Surface, Surfaces};
use super::view::Pinhole;
use super::votes::Votes;

/// Share of a thing that must be seen to move for all of it to count as moving: about an arm of a person.
const MOVING_PART: f32 = 0.12;
/// How a thing of which most corners move stands; …
const MOVER: Standing = Standing { front: 0.75, touching: 0.05 };
/// … more is asked of its front where only a part moves: a mover that touches furniture connects with it, and furniture stands before
/// much, too.
const PARTLY_MOVING: Standing = Standing { front: 0.9, touching: 0.4 };
/// Furniture is mostly planar and people are not: a still part with more than this share on one plane is what a mover touches.
const MAX_PLANAR: f32 = 0.8;
/// Of what a mover merely touches less than this share is taken for moving: a thing of which more moves does so as a whole, planar or not.
/// Of a large plane, which is rigid, the rest does not move either.
const MOSTLY_MOVING: f32 = 0.5;

/// For each surface, whether it may be a thing on which most corners move on their own; whether it is a thing, [`are_things`] says.
pub(crate) fn elect(surfaces: &Surfaces, corners: &[CornerMove]) -> Vec<bool> {
    let mut votes = vec![Votes::default(); surfaces.list.len()];
    for (surface, chi2) in corners.iter().filter_map(|c| Some((surfaces.labels[c.to], c.chi2?))) {
        if let Some(votes) = votes.get_mut(surface as usize) {
            votes.add(chi2);
        }
    }
    votes.iter().zip(&surfaces.list).map(|(votes, surface)| votes.agree_on_motion(surface.pixels)).collect()
}

/// For each surface, whether `holds` for more than half of the corners with depth on it.
pub(crate) fn majority(surfaces: &Surfaces, corners: &[CornerMove], holds: impl Fn(&CornerMove) -> bool) -> Vec<bool> {
    let mut lead = vec![0_i32; surfaces.list.len()];
    for corner in corners.iter().filter(|c| c.chi2.is_some()) {
        if let Some(lead) = lead.get_mut(surfaces.labels[corner.to] as usize) {
            *lead += if holds(corner) { 1 } else { -1 };
        }
    }
    lead.into_iter().map(|lead| lead > 0).collect()
}

/// Of the surfaces elected, those that are things.
pub(crate) fn are_things(surfaces: &Surfaces, camera: &Pinhole, elected: &mut [bool]) {
    for (elected, surface) in elected.iter_mut().zip(&surfaces.list) {
        *elected = *elected && surface.is_thing(camera, MOVER);
    }
}

/// Lets large planes move as a whole or not at all: as a whole if most of one was found to move, all of it `speaks_for_motion`, and it is
/// no wider than a thing.
pub(crate) fn settle_planes(
    objects: &mut Objects,
    surfaces: &Surfaces,
    camera: &Pinhole,
    speaks_for_motion: impl Fn(u32) -> bool,
) {
    let mut moving = vec![0_u32; surfaces.list.len()];
    for &i in objects.list.iter().flat_map(|o| &o.pixels) {
        if let Some(count) = moving.get_mut(surfaces.labels[i as usize] as usize) {
            *count += 1;
        }
    }
    let mostly = |index: usize, moving: u32| moving as f32 > MOSTLY_MOVING * surfaces.list[index].pixels as f32;
    let still: Vec<bool> = moving
        .iter()
        .enumerate()
        .map(|(index, &moving)| surfaces.list[index].on_plane && !mostly(index, moving))
        .collect();
    objects.give_back(|_, i| still.get(surfaces.labels[i] as usize).is_some_and(|s| *s));
    let owners = objects.owners(surfaces, |index, moving| {
        let surface = &surfaces.list[index];
        surface.on_plane && surface.is_narrow(camera) && mostly(index, moving) && speaks_for_motion(index as u32)
    });
    objects.extend(surfaces, &owners);
}

/// For each surface, whether so much of it moves that all of it may.
pub(crate) fn candidates(objects: &Objects, surfaces: &Surfaces) -> Vec<bool> {
    let owners = objects.owners(surfaces, |index, moving| moves_in_part(&surfaces.list[index], moving));
    owners.into_iter().map(|owner| owner != BACKGROUND).collect()
}

fn moves_in_part(surface: &Surface, moving: u32) -> bool {
    moving as f32 > MOVING_PART * surface.pixels as f32
}

/// For each surface the label of the object that it belongs to as a whole, or [`BACKGROUND`]. How its [`candidates`] stand must be known.
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
        moves_in_part(surface, moving) && surface.is_thing(camera, PARTLY_MOVING) && whole(&mut *rng)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::regions::Component;
    use crate::rigid::surfaces::Relief;
    use rand::SeedableRng;

    const CAMERA: Pinhole = Pinhole { width: 40, height: 20, fx: 40.0, fy: 40.0, cx: 19.5, cy: 9.5 };

    /// A flat plate before a wall, of which the left `columns` of twenty were found to move, and its surfaces; with `planes` both are large
    /// planes.
    fn plate(columns: usize, planes: bool) -> (Objects, Surfaces, Vec<f32>) {
        let on_plate = |i: usize| (10..30).contains(&(i % 40)) && (4..16).contains(&(i / 40));
        let depth: Vec<f32> = (0..800).map(|i| if on_plate(i) { 1.0 } else { 2.0 }).collect();
        let moving: Vec<u32> = (0..800).filter(|&i| on_plate(i) && i % 40 < 10 + columns).map(|i| i as u32).collect();
        let mut objects = Objects::default();
        objects.clear(800);
        objects.update(vec![Component { pixels: moving }], &[0.0; 800], 0.0);
        let labels: Vec<u16> = (0..800).map(|i| u16::from(planes) * (1 + u16::from(on_plate(i)))).collect();
        let relief = Relief::new(&DepthNoise::default(), &depth, &labels);
        let mut surfaces = Surfaces::default();
        surfaces.find(&CAMERA, &relief);
        surfaces.describe(&CAMERA, &relief, &candidates(&objects, &surfaces), |i| {
            (objects.labels[i] == BACKGROUND).then_some(0.5)
        });
        (objects, surfaces, depth)
    }

    #[test]
    fn a_flat_thing_moves_as_a_whole_when_most_of_it_does() {
        let moves = |columns| {
            let (objects, surfaces, depth) = plate(columns, false);
            let mut rng = Pcg64Mcg::seed_from_u64(1);
            let owners = owners(&objects, &surfaces, (&CAMERA, &DepthNoise::default(), &depth), &mut rng);
            owners[surfaces.labels[10 * 40 + 25] as usize] != BACKGROUND
        };
        assert!(!moves(6), "this may be a desk that somebody touches");
        assert!(moves(12));
    }

    #[test]
    fn a_large_plane_moves_as_a_whole_or_not_at_all() {
        let moving = |(columns, speaks_for_motion)| {
            let (mut objects, surfaces, _) = plate(columns, true);
            settle_planes(&mut objects, &surfaces, &CAMERA, |_| speaks_for_motion);
            assert_eq!(objects.list.iter().map(|o| o.pixels.len()).sum::<usize>(), on_objects(&objects));
            on_objects(&objects)
        };
        assert_eq!([(9, true), (11, true), (11, false)].map(moving), [0, 20 * 12, 11 * 12]);
    }

    #[test]
    fn the_majority_is_counted_on_each_surface() {
        let (_, surfaces, _) = plate(20, false);
        let corner =
            |to: usize, chi2| CornerMove { from: to, to, displacement: [0.0; 2], residual: [0.0; 2], slide: 0.0, chi2 };
        // On the plate three, of which two hold; on the wall two, of which one does, and one without depth.
        let corners: Vec<CornerMove> = [(412, Some(1.0)), (415, Some(1.0)), (418, Some(1.0)), (2, Some(1.0))]
            .into_iter()
            .chain([(36, Some(1.0)), (38, None)])
            .map(|(to, chi2)| corner(to, chi2))
            .collect();
        let most = majority(&surfaces, &corners, |c| c.to != 412 && c.to != 2);
        assert_eq!([most[surfaces.labels[415] as usize], most[surfaces.labels[2] as usize]], [true, false]);
    }

    fn on_objects(objects: &Objects) -> usize {
        objects.labels.iter().filter(|l| **l != BACKGROUND).count()
    }
}
