//! Mode `pfd`: one frame after the other, in the working view.

use std::collections::VecDeque;

use pfd_geometry::{Camera, DepthNoise, RgbdFrame, StageTimes};
use pfd_vision::VisionError;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::credibility;
use super::diffusion::{Conductance, EdgeScales};
use super::evidence::{Cue, Earlier, Field, STRIDE, Scene, depth_shift, steepest_gradient};
use super::large_planes::{LargePlanes, NO_PLANE};
use super::missing_depth;
use super::model_alignment::Alignment;
use super::motion::{CornerMove, MotionEstimate, MotionEstimator};
use super::objects::{Object, Objects, Policy};
use super::reference::{Appearance, FrameMotion, Reference, depth_range};
use super::regions::{BACKGROUND, Component, HoleFiller, components, dilate, fill_rectangle};
use super::report;
use super::static_model::StaticModel;
use super::surfaces::{Relief, Surfaces};
use super::territories::{self, Territories, Verdict};
use super::things;
use super::undecided::Undecided;
use super::view::{Motion, View, ViewFrame};
use crate::config::{Compensation, ParticleConfig, PfdConfig, RegionShape, SegmentationConfig};
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
    failures: usize,
    /// Frames processed, which sets the pixels that are compared.
    frames: usize,
    buffers: Buffers,
    planes: LargePlanes,
    surfaces: Surfaces,
    territories: Territories,
    undecided: Undecided,
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
    model_depth: Vec<f32>,
    model_near: Vec<f32>,
    model_far: Vec<f32>,
    conductance: Conductance,
    range: [Vec<f32>; 2],
    visited: Vec<bool>,
    /// Whether a pixel lies in a new region.
    candidates: Vec<bool>,
    holes: HoleFiller,
    spare_mask: Vec<u8>,
}

/// Frames kept for comparison: at 30 Hz about half a second.
const HISTORY: usize = 16;
/// Frames kept over the age of the oldest that is compared with, at most: at 30 Hz each, of a faster camera some.
const SPACINGS: u8 = 12;
/// Frames without a motion estimate after which everything is forgotten.
const MAX_FAILURES: usize = 5;
/// Frames never lie closer in time than this, seconds.
const MIN_DT: f64 = 1e-3;
/// Confirmations of the static model that add to the trust in a corner.
const MAX_TRUST: f32 = 3.0;
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
/// Weight of the assumption "static" where nothing is known.
const PRIOR: f32 = 0.04;
/// Regions start where the log-odds exceed this.
const HYSTERESIS: f32 = 0.3;
/// Uncertainty of a place in another frame, working pixels: interpolation and pose, …
const WARP_SIGMA: f32 = 0.35;
/// … plus this share of the image motion, for rolling shutter, blur and stamps of colour and depth that differ.
const WARP_SIGMA_PER_PIXEL: f32 = 0.05;
/// Particles gather on a region at this many times their mean density, …
const MIN_DENSITY: f64 = 4.0;
/// … or are at least this share of all.
const MAX_SUPPORT: f64 = 0.5;
/// A region of which this share surely stands before the static model has come in, whether or not particles have.
const INTRUSION: f32 = 0.4;
/// Something that hardly ever moved rests after this share of the time that an established mover takes.
const MIN_REST: f64 = 0.2;
/// Passes of the diffusion.
const DIFFUSION_PASSES: usize = 2;
/// Makes the random numbers of the search others than those of the filter.
const SEARCH_STREAM: u64 = 0x9E37_79B9_7F4A_7C15;
/// What stops the diffusion.
const EDGES: EdgeScales = EdgeScales { radius: 30.0, depth: 2.0, gray: 80.0 };
/// Holes of a mask up to this share of the image are filled.
const HOLE_SHARE: f64 = 0.002;

impl RigidSegmenter {
    pub(crate) fn new(camera: &Camera, config: &SegmentationConfig, seed: u64) -> Self {
        let view = View::new(camera);
        let mut segmenter = Self {
            config: config.pfd,
            noise: config.depth_noise,
            seed,
            estimator: MotionEstimator::new(&config.pfd, config.depth_noise, seed),
            current: ViewFrame::default(),
            previous: ViewFrame::default(),
            appearance: Appearance::default(),
            history: VecDeque::with_capacity(HISTORY),
            model: StaticModel::new(&view.camera),
            objects: Objects::default(),
            last_time: 0.0,
            flow: 0.0,
            failures: 0,
            frames: 0,
            buffers: Buffers::default(),
            planes: LargePlanes::default(),
            surfaces: Surfaces::default(),
            territories: Territories::default(),
            undecided: Undecided::default(),
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
        self.history.clear();
        self.flow = 0.0;
        self.model.clear();
        self.objects.clear(self.view.camera.pixels());
        self.failures = 0;
        self.frames = 0;
        self.mask.clear();
        self.mask.resize(self.view.camera.pixels(), 0);
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
            Err(reason) => return Ok(self.give_up(reason)),
        };
        timing.measure("evidence", || self.gather(&estimate, dt, time));
        timing.measure("diffusion", || self.diffuse());
        timing.measure("particles", || self.follow(dt));
        timing.measure("regions", || self.extract(&estimate, time));
        let flooded = self.flooded();
        if flooded.is_none() {
            timing.measure("model", || self.update_model());
        } else {
            self.disbelieve();
        }
        timing.measure("remember", || self.remember(time))?;
        self.failures = if flooded.is_some() { self.failures + 1 } else { 0 };
        if self.failures > MAX_FAILURES {
            self.reset();
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
        let (inliers, needed) = (self.estimator.corners(), self.config.min_inliers);
        if inliers < needed {
            self.reset();
            return Ok(Outcome::Failed(FailOpenReason::FewInliers { inliers: 0, needed }));
        }
        Ok(Outcome::First)
    }

    /// Brings the frame into the working view and derives what comparisons need.
    fn prepare(&mut self, frame: &RgbdFrame) -> Result<(), VisionError> {
        self.view.resample(frame, &mut self.current);
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
        let confirmed = |i: usize| if self.config.static_model { model[i].hits.min(MAX_TRUST) } else { 0.0 };
        let trust = |i: usize| if labels[i] == BACKGROUND { 1.0 + confirmed(i) } else { 0.0 };
        self.estimator.estimate(&self.view.camera, (&self.previous, &self.current), trust, dt)
    }

    /// Evidence from earlier frames, the static model, corners and memory.
    fn gather(&mut self, estimate: &MotionEstimate, dt: f64, time: f64) {
        let camera = self.view.camera;
        self.field.clear(camera.pixels());
        self.flow = estimate.flow;
        self.objects.update_velocities(&estimate.corners, dt);
        self.objects.carry(&camera, self.previous.depth.pixels(), self.current.depth.pixels(), dt);
        let motion = self.anchor(&estimate.motion, estimate.flow);
        for reference in &mut self.history {
            reference.motion = reference.motion.then(&motion);
        }
        if self.config.temporal {
            self.look_back(&motion);
        }
        self.compare_earlier(estimate.flow, time);
        if self.config.static_model {
            self.compare_model(&motion, estimate.flow);
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
    fn anchor(&self, motion: &FrameMotion, flow: f32) -> FrameMotion {
        if !self.config.static_model || !self.config.anchored_motion {
            return *motion;
        }
        let (camera, points, carried) = (&self.view.camera, self.model.points(), self.objects.carried());
        let (pixel_sigma, shift) = (pixel_sigma(flow), depth_shift(flow, self.flow));
        let alignment = Alignment { camera, noise: &self.noise, frame: &self.current, points, pixel_sigma, shift };
        let corrected = alignment.correct(&motion.T_earlier_current.inverse(), |i| carried[i] != BACKGROUND);
        FrameMotion { T_earlier_current: corrected.inverse(), ..*motion }
    }

    /// Finds the doubts of the last frame about what this one sees.
    fn look_back(&mut self, motion: &FrameMotion) {
        let (camera, rays, depth, warp) = (&self.view.camera, &self.view.rays, &self.buffers.filled, motion.warp());
        self.objects.look_back(|i| {
            let (p, _) = (depth[i] > 0.0).then(|| warp.apply(camera, rays[i], depth[i])).flatten()?;
            camera.nearest(p)
        });
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
        self.surfaces.describe(camera, &relief, |_| Some(1.0));
        things::are_things(&self.surfaces, camera, &mut moves);
        for (i, &surface) in self.surfaces.labels.iter().enumerate() {
            if moves.get(surface as usize).is_some_and(|m| *m) {
                self.field.observe(i, Cue::OwnMotion, MOVING_THING);
            }
        }
    }

    /// Adds evidence around corners that move together, and against motion around the still ones beside them. The fewer earlier
    /// frames there are to compare with, the more corners say.
    fn blame_territories(&mut self, corners: &[CornerMove]) {
        let (camera, sigma) = (self.view.camera, pixel_sigma(self.flow));
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
                Verdict::Moving => pixels.iter().for_each(|&i| self.field.observe(i, Cue::OwnMotion, moving)),
                Verdict::Still => pixels.iter().for_each(|&i| self.field.add_static(i, STILL_CORNER)),
            }
        }
    }

    fn scene(&self) -> Scene<'_> {
        Scene {
            camera: &self.view.camera,
            rays: &self.view.rays,
            noise: &self.noise,
            frame: &self.current,
            appearance: &self.appearance,
            gradient: &self.buffers.gradient,
            filled: &self.buffers.filled,
            carried: self.objects.carried(),
            significance: self.config.significance as f32,
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

    fn compare_model(&mut self, motion: &FrameMotion, flow: f32) {
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
        self.scene().compare_model(self.model.points(), range, depth_shift(flow, self.flow), &mut field);
        self.field = field;
    }

    /// Spreads the evidence within surfaces and forms the belief.
    fn diffuse(&mut self) {
        let camera = &self.view.camera;
        let b = &mut self.buffers;
        b.conductance.update(camera, &self.noise, &self.current, &EDGES);
        b.conductance.diffuse(camera.width, &mut self.field.cells, DIFFUSION_PASSES);
        let policy = Policy { threshold: self.config.threshold as f32, memory: self.config.temporal };
        for (i, &[evidence, weight]) in self.field.cells.iter().enumerate() {
            let fresh = (evidence / (weight + PRIOR), weight + PRIOR);
            self.objects.update_odds(i, fresh, self.field.explained[i], policy);
        }
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

    /// What the cues say together of a component that continues no object. Less is asked where, if configured, many times the
    /// particles have gathered that chance would put there, or where a good part surely stands before the static model. What
    /// moves on a large plane that stays where it is is a reflection, or a picture on a screen.
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
        let pixels = component.pixels.iter().map(|&i| self.view.to_camera(i as usize)).collect();
        NewRegion {
            pixels,
            cues,
            believed: credibility::log_odds(&cues) > credibility::limit(supported, agreement) && !reflection,
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

    /// Forms regions and continues objects.
    fn extract(&mut self, estimate: &MotionEstimate, time: f64) {
        let camera = self.view.camera;
        let b = &mut self.buffers;
        let min_pixels = (self.config.min_area * camera.pixels() as f64) as usize;
        let found = components(&camera, &self.objects.odds, (0.0, HYSTERESIS), min_pixels.max(1), &mut b.visited);
        let (mut found, new): (Vec<_>, Vec<_>) = found.into_iter().partition(|c| self.objects.continues(c));
        mark(&new, camera.pixels(), &mut b.candidates);
        let agreement = self.agreement(estimate);
        self.new_regions = new.iter().map(|component| self.judge(component, agreement)).collect();
        let believed = new.into_iter().zip(&self.new_regions).filter(|(_, judged)| judged.believed);
        found.extend(believed.map(|(component, _)| component));
        self.objects.update(found, &self.field.motion, time);
        if self.config.rigid_planes {
            let (cues, surfaces) = (&self.field.cues, &self.surfaces);
            let speaks_for_motion = |surface| credibility::speaks_for_motion(cues, &surfaces.pixels(surface));
            things::settle_planes(&mut self.objects, &self.surfaces, &camera, speaks_for_motion);
        }
        self.complete();
        self.assign_undecided();
        self.release(time);
        self.draw_mask();
    }

    /// Extends objects over things of which they hold a good part: whoever stands and gestures is more than arms.
    fn complete(&mut self) {
        if !self.config.whole_things || self.objects.list.is_empty() {
            return;
        }
        let camera = self.view.camera;
        let (labels, cells, explained) = (&self.objects.labels, &self.field.cells, &self.field.explained);
        // What the static model explains is not in doubt, whatever evidence has come to it from a mover beside it.
        let share = |i: usize| (1.0 - explained[i]) * cells[i][0] / (cells[i][1] + PRIOR);
        let doubt = |i: usize| (labels[i] == BACKGROUND).then(|| share(i));
        let depth = self.current.depth.pixels();
        self.surfaces.describe(&camera, &Relief::new(&self.noise, depth, &self.planes.labels), doubt);
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed ^ self.frames as u64);
        let owners = things::owners(&self.objects, &self.surfaces, (&camera, &self.noise, depth), &mut rng);
        self.objects.extend(&self.surfaces, &owners);
    }

    /// Lets grey levels decide where depth does not: along outlines and where it is missing.
    fn assign_undecided(&mut self) {
        if self.objects.list.is_empty() {
            return;
        }
        let found = (&self.objects.odds[..], &self.field.changed[..]);
        let outlines = self.config.refined_outlines;
        let labels = self.undecided.assign(&self.view.camera, &self.current, &self.objects.labels, found, outlines);
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

    /// Static pixels confirm or correct the model; dynamic ones only clear what they disprove.
    fn update_model(&mut self) {
        if !self.config.static_model {
            return;
        }
        let camera = &self.view.camera;
        dilate(camera.width, &self.mask, &mut self.buffers.spare_mask);
        let significance = self.config.significance as f32;
        self.model.observe(camera, (&self.noise, significance), &self.current, &self.buffers.spare_mask);
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

    /// The frame cannot be compared: the next one is compared with the last good one, until too many failed.
    fn give_up(&mut self, reason: FailOpenReason) -> Outcome {
        self.failures += 1;
        if self.failures > MAX_FAILURES {
            self.reset();
        }
        Outcome::Failed(reason)
    }

    fn flooded(&self) -> Option<FailOpenReason> {
        let share = self.mask.iter().filter(|&&m| m != 0).count() as f64 / self.mask.len().max(1) as f64;
        (self.config.fail_open && share > self.config.max_mask_share).then_some(FailOpenReason::MaskTooLarge { share })
    }
}

/// Uncertainty of a warp, and of a corner under it, working pixels, when the image moves by `flow` pixels.
fn pixel_sigma(flow: f32) -> f32 {
    WARP_SIGMA + WARP_SIGMA_PER_PIXEL * flow
}

/// Marks the pixels of components.
fn mark(components: &[Component], pixels: usize, out: &mut Vec<bool>) {
    out.clear();
    out.resize(pixels, false);
    components.iter().flat_map(|c| &c.pixels).for_each(|&i| out[i as usize] = true);
}

fn adopt(camera: &super::view::Pinhole, frame: &ViewFrame, model: &mut StaticModel, i: usize) {
    let z = frame.depth.pixels()[i];
    if z > 0.0 {
        let position = camera.unproject((i % camera.width) as f32, (i / camera.width) as f32, z);
        model.replace(i, position, f32::from(frame.gray.pixels()[i]));
    }
}

fn splat(camera: &super::view::Pinhole, centre: usize, field: &mut Field) {
    let (u, v) = (centre % camera.width, centre / camera.width);
    for y in v.saturating_sub(CORNER_RADIUS)..(v + CORNER_RADIUS + 1).min(camera.height) {
        for x in u.saturating_sub(CORNER_RADIUS)..(u + CORNER_RADIUS + 1).min(camera.width) {
            field.add_motion(y * camera.width + x, Cue::OwnMotion, CORNER);
        }
    }
}
