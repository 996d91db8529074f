//! Mode `pfd`: one frame after the other, in the working view.

mod gather;
mod settle;

use std::collections::VecDeque;

use pfd_geometry::{Camera, DepthNoise, RgbdFrame, StageTimes};
use pfd_vision::VisionError;

use super::colours::Colours;
use super::diffusion::{Conductance, EdgeScales};
use super::evidence::{Field, steepest_gradient};
use super::exposure::Exposure;
use super::large_planes::LargePlanes;
use super::missing_depth;
use super::motion::{MotionEstimate, MotionEstimator};
use super::objects::{Fresh, Object, Objects, Policy};
use super::reference::{Appearance, FrameMotion, RangeBuffers, Reference};
use super::regions::{BACKGROUND, HoleFiller, dilate};
use super::report;
use super::static_model::StaticModel;
use super::surfaces::Surfaces;
use super::territories::Territories;
use super::undecided::Undecided;
use super::view::{View, ViewFrame};
use crate::config::{Compensation, ParticleConfig, PfdConfig, SegmentationConfig};
use crate::particle_filter::{Particle, ParticleFilter};
use crate::result::{DynamicRegion, FailOpenReason, NewRegion};

/// What one step found.
pub(crate) enum Outcome {
    /// Nothing to compare with.
    First,
    /// The mask was not believed.
    Failed(FailOpenReason),
    /// Mask and objects are up to date.
    Done,
}

/// The engine.
#[derive(Debug)]
pub(crate) struct RigidSegmenter {
    config: PfdConfig,
    noise: DepthNoise,
    seed: u64,
    pub(crate) view: View,
    estimator: MotionEstimator,
    exposure: Exposure,
    current: ViewFrame,
    previous: ViewFrame,
    appearance: Appearance,
    /// Past frames, the newest first.
    history: VecDeque<Reference>,
    model: StaticModel,
    pub(crate) objects: Objects,
    last_time: f64,
    /// Image motion since the previous frame, pixels.
    flow: f32,
    /// Time of the last frame that was believed.
    believed: f64,
    /// Frames processed, which sets the pixels that are compared.
    frames: usize,
    buffers: Buffers,
    planes: LargePlanes,
    surfaces: Surfaces,
    territories: Territories,
    undecided: Undecided,
    colours: Colours,
    /// Follows the evidence (paper, section 3.2), in pixels of the camera image.
    filter: ParticleFilter,
    /// Looks for new objects: the same without the evidence on those that are known (algorithm 2, step 9), which would otherwise
    /// keep all particles.
    search: ParticleFilter,
    particles: ParticleConfig,
    /// Evidence of this frame.
    pub(crate) field: Field,
    /// Searching particles per working pixel.
    support: Vec<u16>,
    /// What this frame shows that may be a mover and continues none.
    pub(crate) new_regions: Vec<NewRegion>,
    /// 255 where something moves.
    pub(crate) mask: Vec<u8>,
}

/// Images that live as long as the segmenter.
#[derive(Debug, Default)]
struct Buffers {
    gradient: Vec<f32>,
    spare: Vec<f32>,
    filled: Vec<f32>,
    /// Where the last frame saw what each pixel shows.
    places: Vec<u32>,
    model_depth: Vec<f32>,
    model_near: Vec<f32>,
    model_far: Vec<f32>,
    conductance: Conductance,
    range: RangeBuffers,
    visited: Vec<bool>,
    /// Whether a pixel lies in a new region.
    candidates: Vec<bool>,
    holes: HoleFiller,
    spare_mask: Vec<u8>,
    /// 255 where a pixel was a mover's before colours decided: its depth is that of the mover, ragged as it may be.
    claimed: Vec<u8>,
}

/// Frames kept for comparison: at 30 Hz about half a second.
const HISTORY: usize = 16;
/// Frames kept over the age of the oldest that is compared with, at most: at 30 Hz each, of a faster camera some.
const SPACINGS: u8 = 12;
/// Time without a believable frame after which everything is forgotten, seconds: what is seen by then was not seen before.
const MAX_BLIND: f64 = 0.2;
/// Frames never lie closer in time than this, seconds.
const MIN_DT: f64 = 1e-3;
/// Confirmations of the static model that add to the trust in a corner.
const MAX_TRUST: f32 = 3.0;
/// Weight of the assumption "static" where nothing is known.
const PRIOR: f32 = 0.04;
/// Passes of the diffusion.
const DIFFUSION_PASSES: usize = 2;
/// Makes the random numbers of the search others than those of the filter.
const SEARCH_STREAM: u64 = 0x9E37_79B9_7F4A_7C15;
/// What stops the diffusion.
const EDGES: EdgeScales = EdgeScales { radius: 30.0, depth: 2.0, gray: 80.0 };

impl RigidSegmenter {
    pub(crate) fn new(camera: &Camera, config: &SegmentationConfig, seed: u64) -> Self {
        let view = View::new(camera);
        let mut segmenter = Self {
            config: config.pfd,
            noise: config.depth_noise,
            seed,
            estimator: MotionEstimator::new(&config.pfd, config.depth_noise, seed),
            exposure: Exposure::default(),
            current: ViewFrame::default(),
            previous: ViewFrame::default(),
            appearance: Appearance::default(),
            history: VecDeque::with_capacity(HISTORY),
            model: StaticModel::new(&view.camera),
            objects: Objects::default(),
            last_time: 0.0,
            flow: 0.0,
            believed: 0.0,
            frames: 0,
            buffers: Buffers::default(),
            planes: LargePlanes::default(),
            surfaces: Surfaces::default(),
            territories: Territories::default(),
            undecided: Undecided::default(),
            colours: Colours::default(),
            filter: ParticleFilter::new((camera.width, camera.height), config.particles, seed),
            search: ParticleFilter::new((camera.width, camera.height), config.particles, seed ^ SEARCH_STREAM),
            particles: config.particles,
            field: Field::default(),
            support: Vec::new(),
            new_regions: Vec::new(),
            mask: Vec::new(),
            view,
        };
        segmenter.reset();
        segmenter
    }

    /// Back to the state before the first frame.
    pub(crate) fn reset(&mut self) {
        self.estimator = MotionEstimator::new(&self.config, self.noise, self.seed);
        self.filter = ParticleFilter::new(self.view.source_size(), self.particles, self.seed);
        self.search = ParticleFilter::new(self.view.source_size(), self.particles, self.seed ^ SEARCH_STREAM);
        self.exposure = Exposure::default();
        self.history.clear();
        self.flow = 0.0;
        self.model.clear();
        self.objects.clear(self.view.camera.pixels());
        self.frames = 0;
        for mask in [&mut self.mask, &mut self.buffers.claimed] {
            mask.clear();
            mask.resize(self.view.camera.pixels(), 0);
        }
    }

    /// Processes one frame; `time` in seconds.
    pub(crate) fn step(
        &mut self,
        frame: &RgbdFrame,
        time: f64,
        timing: &mut StageTimes,
    ) -> Result<Outcome, VisionError> {
        self.new_regions.clear();
        timing.measure("prepare", || self.prepare(frame))?;
        if self.history.is_empty() {
            return timing.measure("remember", || self.begin(time));
        }
        let dt = (time - self.last_time).max(MIN_DT);
        let estimate = match timing.measure("ego_motion", || self.estimate(dt))? {
            Ok(estimate) => estimate,
            Err(reason) => {
                if self.is_blind(time) {
                    self.begin_anew(frame, time)?;
                }
                return Ok(Outcome::Failed(reason));
            }
        };
        timing.measure("evidence", || self.gather(&estimate, dt, time));
        timing.measure("diffusion", || self.diffuse());
        timing.measure("particles", || self.follow(dt));
        timing.measure("regions", || self.extract(&estimate, frame.rgb(), time));
        let flooded = self.flooded();
        if flooded.is_none() {
            timing.measure("model", || self.update_model());
        } else {
            self.disbelieve();
        }
        timing.measure("remember", || self.remember(time))?;
        if flooded.is_none() {
            self.believed = time;
        } else if self.is_blind(time) {
            self.begin_anew(frame, time)?;
        }
        Ok(flooded.map_or(Outcome::Done, Outcome::Failed))
    }

    /// Forgets what this frame seems to show: nothing of it enters the next.
    fn disbelieve(&mut self) {
        self.objects.clear(self.view.camera.pixels());
        self.mask.fill(0);
    }

    /// Takes the first frame, unless nothing in it can be followed.
    fn begin(&mut self, time: f64) -> Result<Outcome, VisionError> {
        self.update_model();
        self.remember(time)?;
        self.believed = time;
        let needed = self.config.min_inliers;
        if 2 * self.estimator.corners() < needed {
            self.reset();
            return Ok(Outcome::Failed(FailOpenReason::FewInliers { inliers: 0, needed }));
        }
        Ok(Outcome::First)
    }

    /// Brings the frame into the working view and derives what comparisons need.
    fn prepare(&mut self, frame: &RgbdFrame) -> Result<(), VisionError> {
        self.view.resample(frame, &mut self.current);
        if !self.history.is_empty() {
            self.exposure.compensate(&self.previous.gray, &mut self.current.gray);
        }
        self.estimator.load(&self.current)?;
        self.appearance.update(&self.current, self.config.shadow_rejection, &mut self.buffers.range)?;
        let camera = &self.view.camera;
        let b = &mut self.buffers;
        steepest_gradient(camera, self.current.gray.pixels(), &mut b.spare, &mut b.gradient);
        missing_depth::fill(camera, self.current.depth.pixels(), self.config.missing_depth, &mut b.filled);
        Ok(())
    }

    /// Camera motion since the previous frame. Known movers have no say, known static surfaces more than others.
    fn estimate(&mut self, dt: f64) -> Result<Result<MotionEstimate, FailOpenReason>, VisionError> {
        let (labels, model) = (&self.objects.labels, self.model.points());
        let (noise, significance) = (&self.noise, self.config.significance as f32);
        let depth = self.previous.depth.pixels();
        let confirmed = |i: usize| {
            // What hides a surface that is well known is not known itself.
            let known = self.config.static_model && model[i].agrees_with(depth[i], noise, significance);
            if known { model[i].hits.min(MAX_TRUST) } else { 0.0 }
        };
        let trust = |i: usize| if labels[i] == BACKGROUND { 1.0 + confirmed(i) } else { 0.0 };
        self.estimator.estimate(&self.view.camera, (&self.previous, &self.current), trust, dt)
    }

    /// Spreads the evidence within surfaces and forms the belief.
    fn diffuse(&mut self) {
        let camera = &self.view.camera;
        let b = &mut self.buffers;
        b.conductance.update(camera, &self.noise, &self.current, &EDGES);
        b.conductance.diffuse(camera.width, &mut self.field.cells, DIFFUSION_PASSES);
        let policy = Policy { threshold: self.config.threshold as f32, memory: self.config.temporal };
        let fresh = self.field.cells.iter().zip(&self.field.explained).map(|(&[evidence, weight], &explained)| {
            let weight = weight + PRIOR;
            Fresh { share: evidence / weight, weight, explained }
        });
        self.objects.update_odds(fresh, policy);
    }

    /// One step of the particle filter on the odds of motion: smoothed within surfaces, they are the kernel-weighted
    /// evidence of Eq. 3 that does not cross depth edges.
    fn follow(&mut self, dt: f64) {
        let (view, odds, carried) = (&self.view, &self.objects.odds, self.objects.carried());
        let evidence = |i: usize| odds[i].max(0.0);
        let unexplained = |i: usize| if carried[i] == BACKGROUND { evidence(i) } else { 0.0 };
        self.filter.advance(dt, |p| view.to_working(p.x, p.y).map_or(0.0, evidence));
        self.search.advance(dt, |p| view.to_working(p.x, p.y).map_or(0.0, unexplained));
        self.support.clear();
        self.support.resize(view.camera.pixels(), 0);
        for p in self.search.particles() {
            if let Some(i) = view.to_working(p.x, p.y) {
                self.support[i] += 1;
            }
        }
    }

    /// Regions of the camera image and the particles on each.
    pub(crate) fn report(&self) -> (Vec<DynamicRegion>, Vec<Vec<[f32; 2]>>) {
        let on = |label: u16| {
            let here = |p: &&Particle| self.view.to_working(p.x, p.y).is_some_and(|i| self.objects.labels[i] == label);
            self.filter.particles().iter().filter(here).copied().collect::<Vec<_>>()
        };
        let of = |object: &Object| {
            let particles = on(object.label);
            let positions = particles.iter().map(|p| [p.x, p.y]).collect();
            (report::region(&self.view, &self.previous.depth, object, &particles), positions)
        };
        self.objects.list.iter().map(of).unzip()
    }

    /// Static pixels confirm or correct the model; dynamic ones only clear what they disprove.
    fn update_model(&mut self) {
        if !self.config.static_model {
            return;
        }
        let camera = &self.view.camera;
        let Buffers { spare_mask, claimed, .. } = &mut self.buffers;
        dilate(camera.width, &self.mask, spare_mask);
        spare_mask.iter_mut().zip(claimed.iter()).for_each(|(dynamic, claimed)| *dynamic |= claimed);
        let significance = self.config.significance as f32;
        self.model.observe(&self.view.rays, (&self.noise, significance), &self.current, (claimed, spare_mask));
    }

    /// Makes the current frame the previous one.
    fn remember(&mut self, time: f64) -> Result<(), VisionError> {
        let homography = self.config.compensation == Compensation::Homography;
        let recycled = self.make_room();
        let spare = recycled.map_or_else(Appearance::default, |r| r.appearance);
        let mut appearance = std::mem::replace(&mut self.appearance, spare);
        appearance.mask.clone_from(&self.mask);
        self.history.push_front(Reference { time, motion: FrameMotion::none(homography), flow: self.flow, appearance });
        self.estimator.advance(&self.current)?;
        std::mem::swap(&mut self.previous, &mut self.current);
        self.last_time = time;
        self.frames += 1;
        Ok(())
    }

    /// Removes a past frame if there are enough: the oldest, or, where frames follow one another faster than their age matters, the newest.
    fn make_room(&mut self) -> Option<Reference> {
        let spacing = self.config.older_reference_age / f64::from(SPACINGS);
        let gap = self.history.front().zip(self.history.get(1)).map(|(newest, before)| newest.time - before.time);
        if gap.is_some_and(|gap| gap < spacing) {
            return self.history.pop_front();
        }
        if self.history.len() >= HISTORY { self.history.pop_back() } else { None }
    }

    /// Whether no frame was believed for so long that what was known before is of no use.
    fn is_blind(&self, time: f64) -> bool {
        time - self.believed > MAX_BLIND
    }

    /// Forgets everything before this frame.
    fn begin_anew(&mut self, frame: &RgbdFrame, time: f64) -> Result<(), VisionError> {
        self.reset();
        self.prepare(frame)?;
        self.begin(time).map(drop)
    }

    fn flooded(&self) -> Option<FailOpenReason> {
        let share = self.mask.iter().filter(|&&m| m != 0).count() as f64 / self.mask.len().max(1) as f64;
        (self.config.fail_open && share > self.config.max_mask_share).then_some(FailOpenReason::MaskTooLarge { share })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::{Distortion, Image};

    /// Confirmations that are left of a point of the static model at 2 m that had ten, after a frame in which `z` metres are measured there:
    /// on a pixel that was a mover's or not before colours decided that it is none.
    fn hits_left(claimed: bool, z: f32) -> f32 {
        let camera = Camera::new((320, 240), [260.0, 260.0, 159.5, 119.5], Distortion::default()).unwrap();
        let mut segmenter = RigidSegmenter::new(&camera, &SegmentationConfig::default(), 0);
        segmenter.current = ViewFrame { gray: Image::filled(320, 240, 100), depth: Image::filled(320, 240, z) };
        let at = 100 * 320 + 100;
        let position = segmenter.view.camera.point(at, 2.0);
        (0..10).for_each(|_| segmenter.model.points_mut()[at].confirm(position, 100.0));
        segmenter.buffers.claimed[at] = if claimed { 255 } else { 0 };
        segmenter.update_model();
        segmenter.model.points()[at].hits
    }

    #[test]
    fn the_ragged_depth_of_a_mover_does_not_enter_the_static_model() {
        assert_eq!(hits_left(true, 1.0), 10.0);
        assert!(hits_left(false, 1.0) < 10.0);
    }

    #[test]
    fn what_the_static_model_has_of_a_mover_becomes_doubtful() {
        assert!(hits_left(true, 2.0) < 10.0);
        assert_eq!(hits_left(false, 2.0), 11.0);
    }
}
