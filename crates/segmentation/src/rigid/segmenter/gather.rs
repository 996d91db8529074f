//! What a frame says for and against motion: beside earlier frames, beside the static model, and by its corners.

use super::RigidSegmenter;
use crate::rigid::evidence::{Cue, Earlier, Field, STRIDE, Scene, Tolerance, depth_shift};
use crate::rigid::model_alignment::Alignment;
use crate::rigid::motion::{CornerMove, MotionEstimate};
use crate::rigid::reference::{FrameMotion, Reference, depth_range};
use crate::rigid::regions::BACKGROUND;
use crate::rigid::surfaces::Relief;
use crate::rigid::territories::{self, Verdict};
use crate::rigid::things;
use crate::rigid::view::{Motion, Pinhole};

/// Evidence of a corner that moves on its own.
const CORNER: f32 = 1.0;
/// Squared normalised residual from which a corner moves on its own (3 degrees of freedom, far beyond 99.9 %).
const CORNER_CHI2: f32 = 30.0;
/// A corner speaks for the pixels this far around it.
const CORNER_RADIUS: usize = 2;
/// Evidence per pixel of a thing that moves by these votes: as much as one clear difference of texture.
const MOVING_THING: f32 = 0.3;
/// The same around corners that move together, …
const MOVING_CORNERS: f32 = 0.3;
/// … and where there is only one frame to compare with.
const MOVING_CORNERS_ALONE: f32 = 1.0;
/// Evidence against motion per pixel around a still corner beside a mover.
const STILL_CORNER: f32 = 0.2;
/// Uncertainty of a place in another frame, working pixels: interpolation and pose, …
const WARP_SIGMA: f32 = 0.35;
/// … plus this share of the image motion, for rolling shutter, blur and stamps of colour and depth that differ.
const WARP_SIGMA_PER_PIXEL: f32 = 0.05;

impl RigidSegmenter {
    /// Evidence from earlier frames, the static model, corners and memory.
    pub(super) fn gather(&mut self, estimate: &MotionEstimate, dt: f64, time: f64) {
        let camera = self.view.camera;
        self.field.clear(camera.pixels());
        self.flow = estimate.flow;
        let forward = Motion::from(&estimate.motion.T_earlier_current.inverse());
        let caused = |i: usize| self.view.camera.displacement(&forward, i, self.previous.depth.pixels()[i]);
        self.objects.update_velocities(&estimate.corners, caused, dt);
        self.objects.carry(&camera, &self.noise, (&self.previous, &self.current), dt);
        let motion = self.anchor(&estimate.motion);
        for reference in &mut self.history {
            reference.motion = reference.motion.then(&motion);
        }
        if self.config.temporal {
            self.look_back(&motion);
        }
        self.compare_earlier(estimate.flow, time);
        if self.config.static_model {
            self.compare_model(&motion);
        }
        self.find_surfaces();
        if self.config.whole_things {
            self.blame_things(&estimate.corners);
        }
        if self.config.moving_corners {
            self.blame_territories(&estimate.corners);
        }
        for corner in estimate.corners.iter().filter(|c| c.chi2.is_some_and(|x| x > CORNER_CHI2)) {
            splat(&camera, corner.to, &mut self.field);
        }
    }

    /// The camera motion, corrected by the static model: see [`Alignment`].
    fn anchor(&self, motion: &FrameMotion) -> FrameMotion {
        if !self.config.static_model || !self.config.anchored_motion {
            return *motion;
        }
        let (camera, points, carried) = (&self.view.camera, self.model.points(), self.objects.carried());
        let (pixel_sigma, shift) = (pixel_sigma(self.flow), self.shift_to_model());
        let alignment = Alignment { camera, noise: &self.noise, frame: &self.current, points, pixel_sigma, shift };
        let corrected = alignment.correct(&motion.T_earlier_current.inverse(), |i| carried[i] != BACKGROUND);
        FrameMotion { T_earlier_current: corrected.inverse(), ..*motion }
    }

    /// Finds the doubts of the last frame about what this one sees.
    fn look_back(&mut self, motion: &FrameMotion) {
        let b = &mut self.buffers;
        motion.warp().places(&self.view.camera, &self.view.rays, &b.filled, &mut b.places);
        self.objects.look_back(&b.places);
    }

    /// Parts the frame into surfaces; large planes are surfaces of their own.
    fn find_surfaces(&mut self) {
        let (camera, depth) = (&self.view.camera, self.current.depth.pixels());
        if self.config.rigid_planes {
            self.planes.find(camera, &self.noise, depth);
        } else {
            self.planes.clear(depth.len());
        }
        self.surfaces.find(camera, &Relief::new(&self.noise, depth, &self.planes.labels));
    }

    /// Adds evidence over the whole of things on which most corners move on their own: two frames suffice for that.
    fn blame_things(&mut self, corners: &[CornerMove]) {
        let mut moves = things::elect(&self.surfaces, corners);
        // In most frames there is no such surface.
        if !moves.contains(&true) {
            return;
        }
        let (camera, relief) =
            (&self.view.camera, Relief::new(&self.noise, self.current.depth.pixels(), &self.planes.labels));
        self.surfaces.describe(camera, &relief, &moves, |_| Some(1.0));
        things::are_things(&self.surfaces, camera, &mut moves);
        let apart = things::majority(&self.surfaces, corners, |c| self.field.stands_apart(c.to));
        for (i, &surface) in self.surfaces.labels.iter().enumerate() {
            if moves.get(surface as usize).is_some_and(|m| *m) {
                self.field.blame(i, MOVING_THING, apart[surface as usize]);
            }
        }
    }

    /// Adds evidence around corners that move together, and against motion around the still ones beside them. The fewer earlier
    /// frames there are to compare with, the more corners say.
    fn blame_territories(&mut self, corners: &[CornerMove]) {
        let camera = self.view.camera;
        let sigma = territories::corner_sigma(corners, pixel_sigma(self.flow));
        if !territories::enough_move(corners, sigma) {
            return;
        }
        let span = self.history.front().zip(self.history.back()).map_or(0.0, |(new, old)| new.time - old.time);
        let unknown = (1.0 - span / self.config.older_reference_age).clamp(0.0, 1.0) as f32;
        let moving = MOVING_CORNERS + (MOVING_CORNERS_ALONE - MOVING_CORNERS) * unknown;
        self.territories.divide(&camera, &self.noise, &self.current, corners);
        let verdicts = self.territories.verdicts(corners, sigma);
        for (corner, pixels) in self.territories.owned(&camera) {
            match verdicts[corner] {
                Verdict::Silent => {}
                Verdict::Moving => {
                    let limit = self.behind(corners[corner].to);
                    let depth = self.current.depth.pixels();
                    for i in pixels {
                        self.field.blame(i, moving, depth[i] > limit);
                    }
                }
                Verdict::Still => pixels.iter().for_each(|&i| self.field.add_static(i, STILL_CORNER)),
            }
        }
    }

    /// Depth beyond which a surface is behind that of a corner, metres. None is, as far as is known, if the corner has no depth or shows
    /// what the static model does: it may have set off just now from where the model has it.
    fn behind(&self, corner: usize) -> f32 {
        let z = self.current.depth.pixels()[corner];
        if z > 0.0 && self.field.stands_apart(corner) { z + self.tolerance().at(z) } else { f32::INFINITY }
    }

    /// See [`depth_shift`]. Its points come from many frames, which are taken to have moved as this one does.
    fn shift_to_model(&self) -> f32 {
        depth_shift(self.flow, self.flow)
    }

    fn tolerance(&self) -> Tolerance {
        Tolerance::new(&self.noise, self.config.significance as f32)
    }

    fn scene(&self) -> Scene<'_> {
        Scene {
            camera: &self.view.camera,
            rays: &self.view.rays,
            inside: &self.view.inside,
            noise: &self.noise,
            frame: &self.current,
            appearance: &self.appearance,
            gradient: &self.buffers.gradient,
            filled: &self.buffers.filled,
            carried: self.objects.carried(),
            significance: self.config.significance as f32,
            tolerance: self.tolerance(),
        }
    }

    fn compare_earlier(&mut self, flow: f32, time: f64) {
        let mut field = std::mem::take(&mut self.field);
        let age_wanted = self.config.older_reference_age;
        let mut earlier: Vec<Earlier<'_>> = self
            .references(time)
            .into_iter()
            .map(|reference| Earlier {
                appearance: &reference.appearance,
                warp: reference.motion.warp(),
                pixel_sigma: pixel_sigma(flow),
                shift: depth_shift(flow, reference.flow),
                exposure: 0.0,
                trust: ((time - reference.time) / age_wanted).clamp(0.0, 1.0) as f32,
            })
            .collect();
        let scene = self.scene();
        for e in &mut earlier {
            e.exposure = scene.exposure_since(e);
            e.pixel_sigma = scene.warp_sigma(e);
        }
        scene.compare_earlier(&earlier, self.frames % (STRIDE * STRIDE), &mut field);
        drop(earlier);
        self.field = field;
    }

    /// The frames of the configured age and of half that age, and the previous one.
    fn references(&self, time: f64) -> Vec<&Reference> {
        let nearest = |age: f64| {
            let error = |r: &Reference| ((time - r.time) - age).abs();
            self.history.iter().enumerate().min_by(|a, b| error(a.1).total_cmp(&error(b.1)))
        };
        let age = self.config.older_reference_age;
        let older = [age, age / 2.0].into_iter().filter(|_| self.config.older_reference).filter_map(nearest);
        let mut chosen: Vec<(usize, &Reference)> = older.chain(self.history.front().map(|r| (0, r))).collect();
        chosen.dedup_by_key(|c| c.0);
        chosen.into_iter().map(|(_, r)| r).collect()
    }

    fn compare_model(&mut self, motion: &FrameMotion) {
        let camera = self.view.camera;
        self.model.advance(&camera, &Motion::from(&motion.T_earlier_current.inverse()));
        let b = &mut self.buffers;
        b.model_depth.clear();
        b.model_depth.extend(self.model.points().iter().map(|p| if p.is_believed() { p.position[2] } else { 0.0 }));
        b.model_near.resize(camera.pixels(), 0.0);
        b.model_far.resize(camera.pixels(), 0.0);
        depth_range(camera.width, &b.model_depth, &mut b.range, &mut b.model_near, &mut b.model_far);
        let mut field = std::mem::take(&mut self.field);
        let range = [&self.buffers.model_near[..], &self.buffers.model_far];
        self.scene().compare_model(self.model.points(), range, self.shift_to_model(), &mut field);
        self.field = field;
    }
}

/// Uncertainty of a warp, and of a corner under it, working pixels, that is expected at most when the image moves by `flow` pixels.
fn pixel_sigma(flow: f32) -> f32 {
    WARP_SIGMA + WARP_SIGMA_PER_PIXEL * flow
}

fn splat(camera: &Pinhole, centre: usize, field: &mut Field) {
    let (u, v) = (centre % camera.width, centre / camera.width);
    for y in v.saturating_sub(CORNER_RADIUS)..(v + CORNER_RADIUS + 1).min(camera.height) {
        for x in u.saturating_sub(CORNER_RADIUS)..(u + CORNER_RADIUS + 1).min(camera.width) {
            field.add_motion(y * camera.width + x, Cue::OwnMotion, CORNER);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SegmentationConfig;
    use crate::rigid::view::ViewFrame;
    use pfd_geometry::{Camera, Distortion, Image};

    #[test]
    fn what_is_behind_a_corner_is_known_only_of_corners_that_stand_before_the_static_model() {
        let camera = Camera::new((320, 240), [260.0, 260.0, 159.5, 119.5], Distortion::default()).unwrap();
        let mut segmenter = RigidSegmenter::new(&camera, &SegmentationConfig::default(), 0);
        segmenter.current = ViewFrame { gray: Image::filled(320, 240, 0), depth: Image::filled(320, 240, 2.0) };
        segmenter.field.clear(320 * 240);
        segmenter.field.changed[7] = Some(true);
        assert!((2.03..2.15).contains(&segmenter.behind(7)), "{}", segmenter.behind(7));
        assert_eq!(segmenter.behind(8), f32::INFINITY);
    }
}
