//! Moving things through time: identity, image motion, rest.

use pfd_geometry::DepthNoise;

use super::luma;
use super::motion::CornerMove;
use super::regions::{BACKGROUND, Component};
use super::surfaces::{NO_SURFACE, Surfaces};
use super::view::{Pinhole, ViewFrame};

/// A moving thing.
#[derive(Clone, Debug)]
pub(crate) struct Object {
    /// Stays the same while the thing is followed.
    pub(crate) id: u32,
    /// Label of its pixels in the current label image.
    pub(crate) label: u16,
    /// Its working pixels.
    pub(crate) pixels: Vec<u32>,
    /// Image velocity, working pixels per second.
    pub(crate) velocity: [f32; 2],
    /// The part of it that the camera does not cause.
    own_velocity: [f32; 2],
    /// Time of the last motion seen, seconds.
    pub(crate) last_motion: f64,
    /// Whether depth was measured on it at some time since it is what it is.
    pub(crate) measured: bool,
    /// How well established it is, 0 to 1: what was seen to move for long is remembered for long.
    pub(crate) confidence: f32,
    /// Recent mean evidence of motion per pixel: how lively it is now.
    pub(crate) liveliness: f32,
    /// The highest confidence it had.
    pub(crate) peak: f32,
}

/// What a frame says of a pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fresh {
    /// Share of the information that speaks for motion, …
    pub(crate) share: f32,
    /// … and its amount.
    pub(crate) weight: f32,
    /// How surely the static model explains the pixel, 0 to 1.
    pub(crate) explained: f32,
}

/// How log-odds are updated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Policy {
    /// Share of evidence for motion at which it balances.
    pub(crate) threshold: f32,
    /// Whether the last frame's odds are the start.
    pub(crate) memory: bool,
}

/// The objects of the last frame, as labels in its view.
#[derive(Debug, Default)]
pub(crate) struct Objects {
    pub(crate) list: Vec<Object>,
    /// Label per working pixel of the last frame; [`BACKGROUND`] where nothing moves.
    pub(crate) labels: Vec<u16>,
    /// Labels carried into the current frame.
    carried: Vec<u16>,
    /// Log-odds of motion per working pixel.
    pub(crate) odds: Vec<f32>,
    /// Log-odds carried into the current frame.
    carried_odds: Vec<f32>,
    /// Log-odds from which pixels start that belong to no object.
    suspicion: Vec<f32>,
    next_id: u32,
    /// Confidence by label.
    confidences: Vec<f32>,
}

impl Objects {
    /// One more than the largest label; that of the background is 0.
    fn label_count(&self) -> usize {
        self.list.iter().map(|o| o.label as usize).max().unwrap_or(0) + 1
    }

    /// Labels carried into the current frame.
    pub(crate) fn carried(&self) -> &[u16] {
        &self.carried
    }

    /// Updates the log-odds of all pixels by fresh evidence. Where nothing moved, doubts of the last frame remain.
    /// What was established to move and is not explained by the static model is let go slowly, and what is explained at once: unless fresh
    /// evidence says so again, a mover has passed it.
    pub(crate) fn update_odds(&mut self, evidence: impl Iterator<Item = Fresh>, policy: Policy) {
        let before = self.carried.iter().zip(&self.carried_odds).zip(&self.suspicion);
        for ((odds, fresh), ((&label, &carried), &suspicion)) in self.odds.iter_mut().zip(evidence).zip(before) {
            let Fresh { share, weight, explained } = fresh;
            let change = GAIN * 2.0 * (share - policy.threshold) * weight / (weight + HALF_WEIGHT);
            let is_known = policy.memory && label != BACKGROUND;
            let remembered = if is_known { carried } else { suspicion };
            let doubt = if policy.memory { remembered } else { INITIAL_ODDS };
            let hold = if is_known && change < 0.0 {
                let confidence = self.confidences.get(label as usize).copied().unwrap_or(0.0);
                1.0 - HOLD * confidence * (1.0 - explained) * HOLD_WEIGHT / (HOLD_WEIGHT + weight)
            } else {
                1.0
            };
            let before = if doubt > 0.0 { doubt * (1.0 - explained) } else { doubt };
            *odds = (before + change * hold).clamp(-MAX_ODDS, MAX_ODDS);
        }
    }
}

/// Where a component comes from, by index of the last frame's object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Origin {
    /// It is that object.
    Same(usize),
    /// It has parted from that object, whose history is its own as well.
    PartOf(usize),
    New,
}

/// A surface keeps its label only where depth changed more slowly than this, metres per second: nothing in a room comes nearer as fast.
const MAX_APPROACH: f32 = 3.0;
/// Or, if that is more, than this many standard deviations of the difference of two measurements: that of a far surface is a decimetre.
const STEP_SIGMAS: f32 = 2.0;
/// Every how many pixels of an object it is asked how the camera moves them.
const SAMPLING: usize = 16;
/// A pixel without depth keeps its label only where luma changed by less than this, grey levels: shading and noise. Else something has left
/// it, or has come.
const MAX_LUMA_CHANGE: f32 = 20.0;
/// Log-odds of pixels that belong to an object only because the rest of its surface does.
const COMPLETED_ODDS: f32 = 0.8;
/// Liveliness from which weak evidence against motion counts fully: all of such an object is seen to move, what does not was
/// uncovered by it. Of the compared pixels, one in four, nearly half show it.
const LIVELY: f32 = 0.1;
/// Share of the newest frame in the liveliness: it spans some three frames.
const LIVELINESS_GAIN: f32 = 0.3;

/// One pixel in this many must be carried for a component to continue an object.
const CONTINUED_PART: usize = 4;
/// Log-odds of a pixel about which nothing is known: static.
const INITIAL_ODDS: f32 = -0.5;
/// Log-odds that the last frame leaves behind at most where it saw no object: evidence that comes again counts for more, and none alone
/// for long.
const MAX_SUSPICION: f32 = -0.2;
/// Largest change of the log-odds per frame.
const GAIN: f32 = 1.5;
/// Weight of evidence that has half that effect.
const HALF_WEIGHT: f32 = 0.05;
/// Log-odds saturate here: two clear frames outweigh any history.
const MAX_ODDS: f32 = 2.5;
/// Share of weak evidence against motion that is ignored for an established object that the static model does not explain.
const HOLD: f32 = 0.95;
/// Weight of evidence against motion that halves this indulgence.
const HOLD_WEIGHT: f32 = 0.3;
/// Mean evidence of motion per pixel, of which one in four is compared, from which an object counts as moving.
const MOVING_SHARE: f32 = 0.005;
/// Confidence gained per frame at most: an object is established after a third of a second.
const MAX_GAIN: f32 = 0.1;
/// Share of an object's pixels that depth is measured on, below which it counts as not measured.
const MEASURED_SHARE: f32 = 0.2;
/// Confidence lost per frame: a second without motion takes a third of it.
const FORGETTING: f32 = 0.01;

impl Objects {
    /// Forgets everything but the next identity.
    pub(crate) fn clear(&mut self, pixels: usize) {
        self.list.clear();
        for labels in [&mut self.labels, &mut self.carried] {
            labels.clear();
            labels.resize(pixels, BACKGROUND);
        }
        for odds in [&mut self.odds, &mut self.carried_odds, &mut self.suspicion] {
            odds.clear();
            odds.resize(pixels, INITIAL_ODDS);
        }
    }

    /// Remembers the doubts about what is static: `places` are the pixels of the last frame where that saw what each pixel shows, if it
    /// does not move; beyond the image where it did not.
    pub(crate) fn look_back(&mut self, places: &[u32]) {
        let (odds, labels) = (&self.odds, &self.labels);
        for (suspicion, &place) in self.suspicion.iter_mut().zip(places) {
            // What a mover uncovers inherits nothing from it.
            let before = match labels.get(place as usize) {
                Some(&BACKGROUND) => odds[place as usize],
                _ => INITIAL_ODDS,
            };
            *suspicion = before.clamp(INITIAL_ODDS, MAX_SUSPICION);
        }
    }

    /// Updates image velocities from how corners on the objects moved in `dt` seconds. `caused` is the image motion, pixels, of what a
    /// pixel of the last frame shows if it does not move; an object without corners goes on to move beside that as it did.
    pub(crate) fn update_velocities(
        &mut self,
        corners: &[CornerMove],
        caused: impl Fn(usize) -> Option<[f32; 2]>,
        dt: f64,
    ) {
        let per_second = 1.0 / dt as f32;
        for object in &mut self.list {
            let by_camera = mean(object.pixels.iter().step_by(SAMPLING).filter_map(|&i| caused(i as usize)));
            let by_camera = by_camera.map(|x| x * per_second);
            let on_it = corners.iter().filter(|c| self.labels[c.from] == object.label);
            let (mut dx, mut dy): (Vec<f32>, Vec<f32>) = on_it.map(|c| (c.displacement[0], c.displacement[1])).unzip();
            if let (Some(x), Some(y)) = (median(&mut dx), median(&mut dy)) {
                object.velocity = [x * per_second, y * per_second];
                object.own_velocity = [object.velocity[0] - by_camera[0], object.velocity[1] - by_camera[1]];
            } else {
                object.velocity = [object.own_velocity[0] + by_camera[0], object.own_velocity[1] + by_camera[1]];
            }
        }
    }

    /// Carries the labels into the current frame, `dt` seconds later: each object by its own image motion.
    pub(crate) fn carry(
        &mut self,
        camera: &Pinhole,
        noise: &DepthNoise,
        (previous, current): (&ViewFrame, &ViewFrame),
        dt: f64,
    ) {
        let largest_step = |z: f32| (MAX_APPROACH * dt as f32).max(STEP_SIGMAS * noise.difference_sigma(z));
        self.carried.fill(BACKGROUND);
        self.confidences.clear();
        self.confidences.resize(self.label_count(), 0.0);
        for object in &self.list {
            self.confidences[object.label as usize] = object.confidence * (1.0 - object.liveliness / LIVELY).max(0.0);
            let (dx, dy) = (object.velocity[0] * dt as f32, object.velocity[1] * dt as f32);
            for &i in &object.pixels {
                let (u, v) = ((i as usize % camera.width) as f32 + dx, (i as usize / camera.width) as f32 + dy);
                let Some(j) = camera.nearest([u, v]) else { continue };
                if may_show_the_same(camera, (previous, i as usize), (current, j), largest_step) {
                    self.carried[j] = object.label;
                    self.carried_odds[j] = self.odds[i as usize];
                }
            }
        }
    }

    /// Matches new components with the objects they continue.
    pub(crate) fn update(&mut self, components: Vec<Component>, motion: &[f32], now: f64) {
        let origins = self.origins(&components);
        let mut next = Vec::with_capacity(components.len());
        for (k, (component, origin)) in components.into_iter().zip(origins).enumerate() {
            let evidence: f32 = component.pixels.iter().map(|&i| motion[i as usize].min(1.0)).sum();
            let moving = evidence / component.pixels.len() as f32;
            next.push(self.continued(origin, component, k as u16 + 1, moving, now));
        }
        self.list = next;
        self.labels.fill(BACKGROUND);
        for object in &self.list {
            for &i in &object.pixels {
                self.labels[i as usize] = object.label;
            }
        }
    }

    /// The object that each surface belongs to: the first for which `belongs` holds, given the surface's index and how many of its
    /// pixels the object already has.
    pub(crate) fn owners(&self, surfaces: &Surfaces, mut belongs: impl FnMut(usize, u32) -> bool) -> Vec<u16> {
        let mut shares = vec![0_u32; surfaces.list.len()];
        let mut owners = vec![BACKGROUND; surfaces.list.len()];
        for object in &self.list {
            shares.fill(0);
            for surface in object.pixels.iter().map(|&i| surfaces.labels[i as usize]).filter(|&s| s != NO_SURFACE) {
                shares[surface as usize] += 1;
            }
            for (index, (owner, &share)) in owners.iter_mut().zip(&shares).enumerate() {
                if share > 0 && *owner == BACKGROUND && belongs(index, share) {
                    *owner = object.label;
                }
            }
        }
        owners
    }

    /// Extends each object over the surfaces of which it is the owner.
    pub(crate) fn extend(&mut self, surfaces: &Surfaces, owners: &[u16]) {
        if owners.iter().all(|owner| *owner == BACKGROUND) {
            return;
        }
        for (i, &surface) in surfaces.labels.iter().enumerate() {
            if self.labels[i] != BACKGROUND || surface == NO_SURFACE || owners[surface as usize] == BACKGROUND {
                continue;
            }
            let owner = owners[surface as usize];
            if let Some(object) = self.list.iter_mut().find(|o| o.label == owner) {
                self.labels[i] = owner;
                self.odds[i] = self.odds[i].max(COMPLETED_ODDS);
                object.pixels.push(i as u32);
            }
        }
    }

    /// Takes the pixels for which `is_still` holds from their objects, and drops those that keep none; odds stay.
    pub(crate) fn give_back(&mut self, is_still: impl Fn(&Object, usize) -> bool) {
        let labels = &mut self.labels;
        for object in &mut self.list {
            let mut pixels = std::mem::take(&mut object.pixels);
            pixels.retain(|&i| {
                let still = is_still(object, i as usize);
                if still {
                    labels[i as usize] = BACKGROUND;
                }
                !still
            });
            object.pixels = pixels;
        }
        self.list.retain(|object| !object.pixels.is_empty());
    }

    /// Gives pixels to the objects that `labels` names, and drops those that get none; odds stay.
    pub(crate) fn relabel(&mut self, labels: &[u16]) {
        self.labels.clone_from_slice(labels);
        for object in &mut self.list {
            object.pixels.clear();
        }
        for (i, &label) in labels.iter().enumerate().filter(|(_, l)| **l != BACKGROUND) {
            if let Some(object) = self.list.iter_mut().find(|o| o.label == label) {
                object.pixels.push(i as u32);
            }
        }
        self.list.retain(|object| !object.pixels.is_empty());
    }

    /// For each label whether its object goes on without depth: hardly anything of it is measured in `depth`, but that was once other. What
    /// parts from an object where nothing is measured is no such object: it may be a dark thing that a mover has passed.
    pub(crate) fn mark_unmeasured(&mut self, depth: &[f32]) -> Vec<bool> {
        let mut unmeasured = vec![false; self.label_count()];
        for object in &mut self.list {
            let measured = object.pixels.iter().filter(|&&i| depth[i as usize] > 0.0).count();
            let is_measured = measured as f32 > MEASURED_SHARE * object.pixels.len() as f32;
            object.measured |= is_measured;
            unmeasured[object.label as usize] = object.measured && !is_measured;
        }
        unmeasured
    }

    /// Removes and returns the objects for which `rested` holds.
    pub(crate) fn release(&mut self, rested: impl Fn(&Object) -> bool) -> Vec<Object> {
        let (out, keep) = std::mem::take(&mut self.list).into_iter().partition(|o| rested(o));
        self.list = keep;
        let out: Vec<Object> = out;
        for &i in out.iter().flat_map(|o| &o.pixels) {
            self.labels[i as usize] = BACKGROUND;
        }
        out
    }

    /// Whether a good part of the component was carried from an object of the last frame.
    pub(crate) fn continues(&self, component: &Component) -> bool {
        let carried = component.pixels.iter().filter(|&&i| self.carried[i as usize] != BACKGROUND).count();
        carried * CONTINUED_PART > component.pixels.len()
    }

    /// Where each component comes from: the old object that most of its carried pixels belong to. Of several the one with the most pixels
    /// is that object, the others were part of it.
    fn origins(&self, components: &[Component]) -> Vec<Origin> {
        let votes: Vec<Option<(usize, usize)>> = components.iter().map(|c| self.best_match(c)).collect();
        let winner = |object: usize| {
            let rivals = votes.iter().enumerate().filter(|(_, v)| v.is_some_and(|(m, _)| m == object));
            rivals.max_by_key(|(k, v)| (v.map(|(_, count)| count), std::cmp::Reverse(*k))).map(|(k, _)| k)
        };
        let origin = |(k, vote): (usize, &Option<(usize, usize)>)| match *vote {
            Some((object, _)) if winner(object) == Some(k) => Origin::Same(object),
            Some((object, _)) => Origin::PartOf(object),
            None => Origin::New,
        };
        votes.iter().enumerate().map(origin).collect()
    }

    /// The old object that most of the component's carried pixels belong to, and how many.
    fn best_match(&self, component: &Component) -> Option<(usize, usize)> {
        let mut votes = vec![0_usize; self.label_count()];
        for &i in &component.pixels {
            votes[self.carried[i as usize] as usize] += 1;
        }
        let of = self.list.iter().map(|object| votes[object.label as usize]).enumerate();
        of.filter(|(_, count)| *count > 0).max_by_key(|&(_, count)| count)
    }

    fn continued(&mut self, origin: Origin, c: Component, label: u16, moving: f32, now: f64) -> Object {
        let (old, id) = match origin {
            Origin::Same(m) => (Some(&self.list[m]), self.list[m].id),
            Origin::PartOf(m) => (Some(&self.list[m]), self.next_id),
            Origin::New => (None, self.next_id),
        };
        if id == self.next_id {
            self.next_id += 1;
        }
        let last_motion = if moving > MOVING_SHARE { now } else { old.map_or(now, |o| o.last_motion) };
        let confidence = (old.map_or(0.0, |o| o.confidence) + moving.min(MAX_GAIN) - FORGETTING).clamp(0.0, 1.0);
        let liveliness = old.map_or(moving, |o| o.liveliness + LIVELINESS_GAIN * (moving - o.liveliness));
        Object {
            liveliness,
            id,
            label,
            pixels: c.pixels,
            velocity: old.map_or([0.0; 2], |o| o.velocity),
            own_velocity: old.map_or([0.0; 2], |o| o.own_velocity),
            last_motion,
            measured: matches!(origin, Origin::Same(m) if self.list[m].measured),
            confidence,
            peak: old.map_or(0.0, |o| o.peak).max(confidence),
        }
    }
}

/// Whether two pixels of two frames may show the same: their depths differ by less than `largest_step` of the first, metres, or, where one
/// has none, luma is that of the first or of what is beside it.
fn may_show_the_same(
    camera: &Pinhole,
    (previous, i): (&ViewFrame, usize),
    (current, j): (&ViewFrame, usize),
    largest_step: impl Fn(f32) -> f32,
) -> bool {
    let (from, to) = (previous.depth.pixels()[i], current.depth.pixels()[j]);
    if from > 0.0 && to > 0.0 {
        return (from - to).abs() < largest_step(from);
    }
    let gray = f32::from(current.gray.pixels()[j]);
    let beside = luma::range(camera, i, |i| Some(f32::from(previous.gray.pixels()[i])));
    beside.is_some_and(|[low, high]| gray > low - MAX_LUMA_CHANGE && gray < high + MAX_LUMA_CHANGE)
}

/// The mean; zero of no values.
fn mean(values: impl Iterator<Item = [f32; 2]>) -> [f32; 2] {
    let ([x, y], count) = values.fold(([0.0; 2], 0.0_f32), |([x, y], n), [dx, dy]| ([x + dx, y + dy], n + 1.0));
    [x, y].map(|sum| sum / count.max(1.0))
}

/// The middle value; `None` for no values.
pub(crate) fn median(values: &mut [f32]) -> Option<f32> {
    let last = values.len().checked_sub(1)?;
    Some(nth(values, last / 2))
}

/// The value that a `share` of all lies below; `None` for no values.
pub(crate) fn quantile(values: &mut [f32], share: f32) -> Option<f32> {
    let last = values.len().checked_sub(1)?;
    Some(nth(values, ((share * values.len() as f32) as usize).min(last)))
}

fn nth(values: &mut [f32], index: usize) -> f32 {
    *values.select_nth_unstable_by(index, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::view::OUTSIDE;
    use pfd_geometry::Image;
    use std::ops::Range;

    const CAMERA: Pinhole = Pinhole { width: 10, height: 2, fx: 10.0, fy: 10.0, cx: 4.5, cy: 0.5 };

    /// A grey frame of these depths.
    fn view(depth: &[f32]) -> ViewFrame {
        let depth = Image::from_vec(CAMERA.width, CAMERA.height, depth.to_vec()).unwrap();
        ViewFrame { gray: Image::filled(CAMERA.width, CAMERA.height, 100), depth }
    }

    fn component(pixels: Range<u32>) -> Component {
        Component { pixels: pixels.collect() }
    }

    /// Log-odds of a pixel after so many frames with this share of evidence for motion.
    fn odds_after(frames: usize, share: f32, memory: bool) -> f32 {
        let mut objects = Objects::default();
        objects.clear(2);
        for _ in 0..frames {
            objects.look_back(&[0, 1]);
            let fresh = Fresh { share, weight: 0.2, explained: 0.0 };
            objects.update_odds([fresh; 2].into_iter(), Policy { threshold: 0.5, memory });
        }
        objects.odds[1]
    }

    #[test]
    fn quantiles_lie_where_so_many_values_lie_below() {
        let quantiles = |values: &[f32]| [0.0, 0.25, 0.7, 1.0].map(|share| quantile(&mut values.to_vec(), share));
        assert_eq!(quantiles(&[4.0, 2.0, 1.0, 3.0]), [Some(1.0), Some(2.0), Some(3.0), Some(4.0)]);
        assert_eq!(quantiles(&[]), [None; 4]);
        assert_eq!([median(&mut [4.0, 2.0, 1.0, 3.0]), median(&mut [])], [Some(2.0), None]);
    }

    #[test]
    fn evidence_that_comes_again_counts_for_more_and_weak_evidence_never_suffices() {
        assert!(odds_after(1, 0.6, true) < 0.0);
        assert!(odds_after(3, 0.6, true) > 0.0);
        assert!(odds_after(3, 0.6, false) < 0.0);
        assert!(odds_after(100, 0.55, true) < 0.0);
    }

    #[test]
    fn what_the_static_model_explains_is_let_go_at_once_unless_it_is_seen_to_move_again() {
        let odds = |explained: f32, share: f32| {
            let mut objects = Objects::default();
            objects.clear(1);
            objects.confidences = vec![0.0, 1.0];
            (objects.carried[0], objects.carried_odds[0]) = (1, MAX_ODDS);
            let fresh = Fresh { share, weight: 0.2, explained };
            objects.update_odds([fresh].into_iter(), Policy { threshold: 0.5, memory: true });
            objects.odds[0]
        };
        assert!(odds(0.0, 0.0) > 0.0 && odds(1.0, 0.0) < 0.0);
        assert!(odds(1.0, 0.9) > 0.0, "it slides along itself");
        assert!(odds(0.5, 0.5) < odds(0.0, 0.5));
    }

    #[test]
    fn the_largest_part_goes_on_and_the_others_keep_its_history() {
        let mut objects = Objects::default();
        objects.clear(20);
        (0..20).for_each(|_| {
            objects.carry(&CAMERA, &DepthNoise::default(), (&view(&[1.0; 20]), &view(&[1.0; 20])), 0.03);
            objects.update(vec![component(0..9)], &[1.0; 20], 1.0);
        });
        let whole = objects.list[0].clone();
        objects.carry(&CAMERA, &DepthNoise::default(), (&view(&[1.0; 20]), &view(&[1.0; 20])), 0.03);
        objects.update(vec![component(0..2), component(3..9), component(15..17)], &[0.0; 20], 2.0);
        let [small, large, new] = &objects.list[..] else { panic!("{:?}", objects.list) };
        assert_eq!((large.id, large.peak), (whole.id, whole.peak));
        assert_eq!((small.peak, small.last_motion), (whole.peak, whole.last_motion));
        assert!(new.peak < whole.peak && new.last_motion == 2.0);
        assert!(small.id != large.id && small.id != new.id);
    }

    #[test]
    fn an_object_without_corners_follows_the_camera() {
        let mut objects = Objects::default();
        objects.clear(20);
        objects.update(vec![component(2..5)], &[1.0; 20], 1.0);
        let corner =
            CornerMove { from: 3, to: 6, displacement: [3.0, 0.0], residual: [0.0; 2], slide: 0.0, chi2: None };
        let velocity = |objects: &Objects| objects.list[0].velocity[0];
        objects.update_velocities(&[corner], |_| Some([1.0, 0.0]), 0.5);
        assert_eq!(velocity(&objects), 6.0, "that of its corners");
        objects.update_velocities(&[], |_| Some([4.0, 0.0]), 0.5);
        assert_eq!(velocity(&objects), 12.0, "two pixels beside the four of the camera");
        objects.update_velocities(&[], |_| None, 0.5);
        assert_eq!(velocity(&objects), 4.0);
    }

    #[test]
    fn noise_of_far_surfaces_takes_no_label_away() {
        let carried = |z: f32, step: f32| {
            let mut objects = Objects::default();
            objects.clear(20);
            objects.update(vec![component(2..5)], &[1.0; 20], 1.0);
            objects.carry(&CAMERA, &DepthNoise::default(), (&view(&[z; 20]), &view(&[z + step; 20])), 1.0 / 60.0);
            objects.carried().iter().filter(|l| **l != BACKGROUND).count()
        };
        assert_eq!([carried(5.0, 0.15), carried(1.0, 0.15)], [3, 0]);
    }

    #[test]
    fn labels_stay_where_depth_or_else_luma_does() {
        let (near, far, none) = ([1.0; 20], [2.0; 20], [0.0; 20]);
        let carried = |before: &[f32], now: &[f32], gray: u8| {
            let mut objects = Objects::default();
            objects.clear(20);
            objects.update(vec![component(2..5)], &[1.0; 20], 1.0);
            let mut current = view(now);
            current.gray.pixels_mut()[3] = gray;
            objects.carry(&CAMERA, &DepthNoise::default(), (&view(before), &current), 0.03);
            objects.carried().iter().filter(|l| **l != BACKGROUND).count()
        };
        assert_eq!([100, 200].map(|gray| carried(&near, &near, gray)), [3, 3], "depth says that it is the same");
        assert_eq!([100, 200].map(|gray| carried(&near, &far, gray)), [0, 0]);
        assert_eq!([100, 115, 200, 30].map(|gray| carried(&near, &none, gray)), [3, 3, 2, 2]);
        assert_eq!([100, 200].map(|gray| carried(&none, &near, gray)), [3, 2]);
    }

    #[test]
    fn an_object_goes_on_without_depth_if_it_had_some_and_what_parts_from_it_then_does_not() {
        let mut objects = Objects::default();
        objects.clear(20);
        let mut step = |components: Vec<Component>, depth: [f32; 20]| {
            objects.carry(&CAMERA, &DepthNoise::default(), (&view(&depth), &view(&depth)), 0.03);
            objects.update(components, &[1.0; 20], 1.0);
            let unmeasured = objects.mark_unmeasured(&depth);
            objects.list.iter().map(|o| unmeasured[o.label as usize]).collect::<Vec<_>>()
        };
        assert_eq!(step(vec![component(0..9)], [0.0; 20]), [false], "it never had any");
        assert_eq!(step(vec![component(0..9)], [1.0; 20]), [false]);
        assert_eq!(step(vec![component(0..9)], [0.0; 20]), [true]);
        assert_eq!(step(vec![component(0..5), component(6..9)], [0.0; 20]), [true, false]);
    }

    #[test]
    fn what_comes_into_view_is_above_suspicion() {
        let mut objects = Objects::default();
        objects.clear(2);
        objects.odds.fill(2.0);
        objects.look_back(&[OUTSIDE, 0]);
        assert_eq!(objects.suspicion, [INITIAL_ODDS, MAX_SUSPICION]);
        objects.labels[0] = 1;
        objects.look_back(&[OUTSIDE, 0]);
        assert_eq!(objects.suspicion, [INITIAL_ODDS; 2], "so is what a mover uncovers");
    }
}
