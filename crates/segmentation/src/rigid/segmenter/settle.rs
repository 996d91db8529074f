//! From the odds of motion to objects and their mask.

use pfd_geometry::RgbImage;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{PRIOR, RigidSegmenter};
use crate::config::RegionShape;
use crate::result::NewRegion;
use crate::rigid::credibility::{self, Circumstances};
use crate::rigid::large_planes::NO_PLANE;
use crate::rigid::motion::MotionEstimate;
use crate::rigid::regions::{BACKGROUND, Component, components, fill_rectangle};
use crate::rigid::static_model::{ModelPoint, StaticModel};
use crate::rigid::surfaces::Relief;
use crate::rigid::things;
use crate::rigid::unchanged;
use crate::rigid::undecided::Findings;
use crate::rigid::view::{Pinhole, ViewFrame};

/// Regions start where the log-odds exceed this.
const HYSTERESIS: f32 = 0.3;
/// Particles gather on a region at this many times their mean density, …
const MIN_DENSITY: f64 = 4.0;
/// … or are at least this share of all.
const MAX_SUPPORT: f64 = 0.5;
/// A region of which this share surely stands before the static model has come in, whether or not particles have.
const INTRUSION: f32 = 0.4;
/// A region reaches the border of the image from this far, working pixels: outlines are not known better.
const BORDER: f32 = 3.0;
/// Something that hardly ever moved rests after this share of the time that an established mover takes.
const MIN_REST: f64 = 0.2;
/// What is left of a known object may be smaller than a new one, by this share: it leaves the view, or something hides it.
const KNOWN_AREA: f64 = 0.25;
/// Confidence from which an object is established: it has moved for a fifth of a second at least.
const ESTABLISHED: f32 = 0.5;
/// Holes of a mask up to this share of the image are filled.
const HOLE_SHARE: f64 = 0.002;

impl RigidSegmenter {
    /// What the cues say together of a component that continues no object. Less is asked where, if configured, many times the
    /// particles have gathered that chance would put there, or where a good part surely stands before the static model; and where it
    /// reaches the border of the image and depth or corners say that it has moved. What moves on a large plane that stays where it is
    /// is a reflection, or a picture on a screen.
    fn judge(&self, component: &Component, agreement: f32) -> NewRegion {
        let count = component.pixels.len();
        let gathered: u32 = component.pixels.iter().map(|&i| u32::from(self.support[i as usize])).sum();
        let share = count as f64 / self.view.camera.pixels() as f64;
        let density = if self.compares_first_two() { 1.0 } else { MIN_DENSITY };
        let expected = self.particles.count as f64 * (share * density).min(MAX_SUPPORT);
        let intruding: f32 = component.pixels.iter().map(|&i| self.field.intruding[i as usize]).sum();
        let supported =
            !self.config.particle_support || f64::from(gathered) > expected || intruding > INTRUSION * count as f32;
        let cues = credibility::strengths(&self.field.cues, &component.pixels);
        let flat = component.pixels.iter().filter(|&&i| self.planes.labels[i as usize] != NO_PLANE).count();
        let reflection = 2 * flat > count && !credibility::depth_speaks(&cues);
        let at_border = component.pixels.iter().any(|&i| self.view.is_at_border(i as usize, BORDER));
        let circumstances = Circumstances { supported, at_border, agreement };
        NewRegion {
            pixels: component.pixels.iter().map(|&i| self.view.to_camera(i as usize)).collect(),
            cues,
            at_border,
            believed: credibility::is_believed(&cues, circumstances) && !reflection,
        }
    }

    /// Whether there is one earlier frame only: nothing is known yet of what moves, and particles have made a single step.
    fn compares_first_two(&self) -> bool {
        self.history.len() == 1
    }

    /// Share of the corners that follow the camera, known movers and what may be new ones aside. Of the first two frames
    /// movers that have not been found yet have as much of a share in it as anything else, so that it counts as whole.
    fn agreement(&self, estimate: &MotionEstimate) -> f32 {
        if self.compares_first_two() {
            return 1.0;
        }
        let (labels, candidates) = (&self.objects.labels, &self.buffers.candidates);
        estimate.agreement(|c| labels[c.from] == BACKGROUND && !candidates[c.to])
    }

    /// Forms regions and continues objects.
    pub(super) fn extract(&mut self, estimate: &MotionEstimate, rgb: &RgbImage, time: f64) {
        let camera = self.view.camera;
        let b = &mut self.buffers;
        let min_pixels = self.config.min_area * camera.pixels() as f64;
        let min_known = ((min_pixels * KNOWN_AREA) as usize).max(1);
        let found = components(&camera, &self.objects.odds, (0.0, HYSTERESIS), min_known, &mut b.visited);
        let (mut found, mut new): (Vec<_>, Vec<_>) = found.into_iter().partition(|c| self.objects.continues(c));
        new.retain(|c| c.pixels.len() as f64 >= min_pixels);
        mark(&new, camera.pixels(), &mut b.candidates);
        let agreement = self.agreement(estimate);
        self.new_regions = new.iter().map(|component| self.judge(component, agreement)).collect();
        let believed = new.into_iter().zip(&self.new_regions).filter(|(_, judged)| judged.believed);
        found.extend(believed.map(|(component, _)| component));
        self.objects.update(found, &self.field.motion, time);
        self.give_back_unchanged();
        if self.config.rigid_planes {
            let (cues, surfaces) = (&self.field.cues, &self.surfaces);
            let speaks_for_motion = |surface| credibility::speaks_for_motion(cues, &surfaces.pixels(surface));
            things::settle_planes(&mut self.objects, &self.surfaces, &camera, speaks_for_motion);
        }
        self.complete();
        self.assign_undecided(rgb);
        self.release(time);
        self.draw_mask();
    }

    /// Takes from established objects what has surely stayed as it was: evidence from beside it has spread there. Of what sets off, the
    /// inside stays as it was for some frames.
    fn give_back_unchanged(&mut self) {
        let (camera, unchanged) = (&self.view.camera, &self.field.unchanged);
        self.objects.give_back(|object, i| {
            object.confidence >= ESTABLISHED && unchanged::is_among_its_like(camera, unchanged, i)
        });
    }

    /// Extends objects over things of which they hold a good part: whoever stands and gestures is more than arms.
    fn complete(&mut self) {
        if !self.config.whole_things || self.objects.list.is_empty() {
            return;
        }
        let candidates = things::candidates(&self.objects, &self.surfaces);
        if !candidates.contains(&true) {
            return;
        }
        let camera = self.view.camera;
        let (labels, cells, explained) = (&self.objects.labels, &self.field.cells, &self.field.explained);
        // What the static model explains is not in doubt, whatever evidence has come to it from a mover beside it.
        let share = |i: usize| (1.0 - explained[i]) * cells[i][0] / (cells[i][1] + PRIOR);
        let doubt = |i: usize| (labels[i] == BACKGROUND).then(|| share(i));
        let depth = self.current.depth.pixels();
        let relief = Relief::new(&self.noise, depth, &self.planes.labels);
        self.surfaces.describe(&camera, &relief, &candidates, doubt);
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed ^ self.frames as u64);
        let owners = things::owners(&self.objects, &self.surfaces, (&camera, &self.noise, depth), &mut rng);
        self.objects.extend(&self.surfaces, &owners);
    }

    /// Lets grey levels decide where depth is missing, and colours along outlines, where it is ragged.
    fn assign_undecided(&mut self, rgb: &RgbImage) {
        let claimed = &mut self.buffers.claimed;
        claimed.clear();
        if self.objects.list.is_empty() {
            claimed.resize(self.view.camera.pixels(), 0);
            return;
        }
        let (view, frame, changed) = (&self.view, &self.current, &self.field.changed);
        let unmeasured = self.objects.mark_unmeasured(frame.depth.pixels());
        let found = Findings { odds: &self.objects.odds, changed, unmeasured: &unmeasured };
        let mut labels = self.undecided.assign(&view.camera, frame, &self.objects.labels, found);
        claimed.extend(labels.iter().map(|&label| if label == BACKGROUND { 0 } else { 255 }));
        if self.config.refined_outlines {
            labels = self.colours.assign(view, (rgb, frame), changed, labels);
        }
        self.objects.relabel(labels);
    }

    /// Lets go of what has rested long enough: it becomes part of the static scene.
    fn release(&mut self, time: f64) {
        let rest = self.config.rest_time;
        let (camera, frame, model) = (&self.view.camera, &self.current, &mut self.model);
        let rested = self.objects.release(|o| time - o.last_motion > rest * f64::from(o.peak).max(MIN_REST));
        for i in rested.into_iter().flat_map(|o| o.pixels) {
            adopt(camera, frame, model, i as usize);
        }
    }

    fn draw_mask(&mut self) {
        let camera = self.view.camera;
        self.mask.fill(0);
        for object in &self.objects.list {
            for &i in &object.pixels {
                self.mask[i as usize] = 255;
            }
        }
        let max_hole = (HOLE_SHARE * camera.pixels() as f64) as usize;
        self.buffers.holes.fill(camera.width, &mut self.mask, max_hole);
        if self.config.region == RegionShape::Rectangle {
            for object in &self.objects.list {
                fill_rectangle(camera.width, &object.pixels, &mut self.mask);
            }
        }
    }
}

/// Marks the pixels of components.
fn mark(components: &[Component], pixels: usize, out: &mut Vec<bool>) {
    out.clear();
    out.resize(pixels, false);
    components.iter().flat_map(|c| &c.pixels).for_each(|&i| out[i as usize] = true);
}

fn adopt(camera: &Pinhole, frame: &ViewFrame, model: &mut StaticModel, i: usize) {
    let z = frame.depth.pixels()[i];
    if z > 0.0 {
        model.points_mut()[i] = ModelPoint::new(camera.point(i, z), f32::from(frame.gray.pixels()[i]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SegmentationConfig;
    use crate::rigid::evidence::Cue;
    use pfd_geometry::{Camera, Distortion};

    /// Whether a region of 20×20 pixels at this column is believed of which each pixel has this weight of a cue.
    fn believed_at(column: usize, (cue, weight): (Cue, f32)) -> bool {
        let camera = Camera::new((320, 240), [260.0, 260.0, 159.5, 119.5], Distortion::default()).unwrap();
        let mut segmenter = RigidSegmenter::new(&camera, &SegmentationConfig::default(), 0);
        let size = segmenter.view.camera.pixels();
        segmenter.field.clear(size);
        segmenter.support.resize(size, 0);
        segmenter.planes.clear(size);
        segmenter.field.cues.iter_mut().for_each(|cues| cues[cue as usize] = weight);
        let pixels = (0..400).map(|k| ((100 + k / 20) * 320 + column + k % 20) as u32).collect();
        segmenter.judge(&Component { pixels }, 1.0).believed
    }

    #[test]
    fn established_objects_give_back_what_has_stayed_as_it_was() {
        let camera = Camera::new((320, 240), [260.0, 260.0, 159.5, 119.5], Distortion::default()).unwrap();
        let mut segmenter = RigidSegmenter::new(&camera, &SegmentationConfig::default(), 0);
        let size = segmenter.view.camera.pixels();
        segmenter.field.clear(size);
        segmenter.objects.clear(size);
        // Rows 100 to 120, of which columns 50 to 60 have stayed.
        let pixels: Vec<u32> = (0..400).map(|k| (100 + k / 20) * 320 + 40 + k % 20).collect();
        for &i in pixels.iter().filter(|&&i| i % 320 >= 50) {
            segmenter.field.unchanged[i as usize] = true;
        }
        segmenter.objects.update(vec![Component { pixels }], &vec![1.0; size], 0.0);
        let kept = |segmenter: &mut RigidSegmenter| {
            segmenter.give_back_unchanged();
            segmenter.objects.list[0].pixels.len()
        };
        assert_eq!(kept(&mut segmenter), 400, "it has only just set off");
        segmenter.objects.list[0].confidence = ESTABLISHED;
        assert_eq!(kept(&mut segmenter), 200 + 4 * 3, "at a corner three pixels have other ones around them");
    }

    #[test]
    fn of_what_comes_in_at_the_border_less_is_asked_but_not_if_only_its_looks_have_changed() {
        let [came, looks] = [(Cue::BeforeModel, 0.2), (Cue::OtherTexture, 0.2)];
        assert_eq!([0, 300, 150].map(|column| believed_at(column, came)), [true, true, false]);
        assert_eq!([0, 300, 150].map(|column| believed_at(column, looks)), [false; 3]);
    }
}
