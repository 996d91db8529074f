//! The state machine around localisation and mapping.

use std::path::Path;

use nalgebra::{Matrix6, Vector6};
use pfd_geometry::{Camera, Mask, Pose, RgbdFrame, StageTimes, Stamp, StampedPose};
use pfd_vision::features::FeatureExtractor;
use rand::SeedableRng;
use rand_pcg::Pcg32;

use crate::background::PendingAdjustment;
use crate::bundle_adjustment::{self, BundleProblem};
use crate::config::TrackingConfig;
use crate::first_frames::FirstFrames;
use crate::image_features::ImageFeatures;
use crate::local_mapping;
use crate::localization::{Expectation, Localized, Localizer};
use crate::loop_closing;
use crate::map::{Keyframe, KeyframeId, Map, MapPointId};
use crate::map_file::{self, MapFileError};
use crate::matching::Match;
use crate::motion::Motion;
use crate::places::PlaceIndex;
use crate::refinement::Refinement;
use crate::result::{MapPointView, TrackedFrame, TrackingError, TrackingState};
use crate::rolling_shutter::Shutter;
use crate::segments::Segments;
use crate::trajectory::TrajectoryLog;

/// Camera tracking and mapping.
pub struct Tracker {
    camera: Camera,
    config: TrackingConfig,
    extractor: FeatureExtractor,
    seed: u64,
    rng: Pcg32,
    map: Map,
    /// Living keyframes in the order of their creation.
    keyframe_order: Vec<KeyframeId>,
    places: PlaceIndex,
    trajectory: TrajectoryLog,
    state: TrackingState,
    frame_index: usize,
    last_stamp: Option<Stamp>,
    active: Option<Active>,
    adjustment: Option<PendingAdjustment>,
    loops: usize,
    segments: Segments,
    /// Since when the camera has been lost although there is something to see.
    lost_since: Option<Stamp>,
    /// Kept until the map was judged by masks that know what moves.
    first_frames: Option<FirstFrames>,
    /// With the readout time, a property of the camera: it outlives the map.
    refinement: Refinement,
}

/// What is known while (and after) a map exists.
struct Active {
    motion: Motion,
    reference: KeyframeId,
    /// Map points that the last frame showed.
    last_points: Vec<MapPointId>,
}

/// A frame on its way through [`Tracker::track`].
struct Candidate<'a> {
    frame: &'a RgbdFrame,
    /// `None` once the mask was given up because it leaves too little.
    mask: Option<&'a Mask>,
    features: ImageFeatures,
}

impl Tracker {
    /// A tracker without a map.
    ///
    /// # Errors
    /// When OpenCV cannot be set up.
    pub fn new(camera: Camera, config: &TrackingConfig, seed: u64) -> Result<Self, TrackingError> {
        pfd_vision::use_single_thread()?;
        Ok(Self {
            camera,
            extractor: FeatureExtractor::new(config.features.options()),
            config: config.clone(),
            seed,
            rng: Pcg32::seed_from_u64(seed),
            map: Map::default(),
            keyframe_order: Vec::new(),
            places: PlaceIndex::new(seed),
            trajectory: TrajectoryLog::default(),
            state: TrackingState::NotInitialized,
            frame_index: 0,
            last_stamp: None,
            active: None,
            adjustment: None,
            loops: 0,
            segments: Segments::default(),
            lost_since: None,
            first_frames: None,
            refinement: Refinement::new(config.rolling_shutter.readout),
        })
    }

    /// Estimates the pose of `frame`. Pixels that `mask` calls dynamic are not used.
    ///
    /// # Errors
    /// [`TrackingError`] when frame or mask do not fit the camera, or the frame is not newer than the last.
    pub fn track(&mut self, frame: &RgbdFrame, mask: Option<&Mask>) -> Result<TrackedFrame, TrackingError> {
        frame.check_camera(&self.camera)?;
        if let Some(last) = self.last_stamp.filter(|last| frame.stamp() <= *last) {
            return Err(TrackingError::OutOfOrder { stamp: frame.stamp(), last });
        }
        let mut timing = StageTimes::default();
        if self.config.mapping.enabled {
            local_mapping::refresh_shutters(&mut self.map, &self.camera, self.refinement.readout());
        }
        let features = timing.measure("features", || self.extract(frame, mask))?;
        timing.measure("take over map", || self.take_over_adjustment(false));
        self.last_stamp = Some(frame.stamp());
        let mut candidate = Candidate { frame, mask, features };
        let localized = timing.measure("localize", || self.localize(&mut candidate))?;
        let localized = timing.measure("refine", || localized.map(|found| self.refine(&mut candidate.features, found)));
        let tracked = timing.measure("map", || self.integrate(candidate, localized));
        self.frame_index += 1;
        Ok(TrackedFrame { timing, ..tracked })
    }

    fn extract(&mut self, frame: &RgbdFrame, mask: Option<&Mask>) -> Result<ImageFeatures, TrackingError> {
        let features = self.extractor.extract(frame.gray(), mask, self.config.features.mask_margin)?;
        let patches = self.extractor.patches(&features)?;
        let mut features = ImageFeatures::new(features, frame, &self.config).with_patches(patches);
        let followed = self.active.as_ref().filter(|_| self.state != TrackingState::Lost);
        let velocity = followed.map(|active| active.motion.velocity()).unwrap_or_default();
        features.set_shutter(&self.camera, Shutter { velocity, readout: self.refinement.readout() });
        Ok(features)
    }

    fn localizer(&self) -> Localizer<'_> {
        Localizer { camera: &self.camera, config: &self.config, map: &self.map }
    }

    /// The pose of the candidate: with the mask, where that leaves too little without, and at last by recognising the place.
    fn localize(&mut self, candidate: &mut Candidate<'_>) -> Result<Option<Localized>, TrackingError> {
        if self.active.is_none() {
            return Ok(None);
        }
        if self.state == TrackingState::Lost {
            return Ok(self.relocalize(&candidate.features));
        }
        let followed = self.follow_with_or_without_mask(candidate)?;
        if followed.is_none() {
            // Also for this frame the camera may be found in the map as a whole.
            self.state = TrackingState::Lost;
            return Ok(self.relocalize(&candidate.features));
        }
        Ok(followed)
    }

    /// Makes the most of a pose that was found: see [`Refinement`].
    #[allow(non_snake_case)]
    fn refine(&mut self, features: &mut ImageFeatures, found: Localized) -> Localized {
        let Some(active) = &self.active else { return found };
        let velocity = match self.state {
            // A camera that was lost may be anywhere.
            TrackingState::Lost => Vector6::zeros(),
            _ => active.motion.velocity_at(self.last_stamp.unwrap_or_default(), &found.T_camera_world),
        };
        // Not `self.localizer()`, which would borrow the refinement as well.
        let localizer = Localizer { camera: &self.camera, config: &self.config, map: &self.map };
        self.refinement.refine(&localizer, velocity, features, found)
    }

    fn follow_with_or_without_mask(
        &mut self,
        candidate: &mut Candidate<'_>,
    ) -> Result<Option<Localized>, TrackingError> {
        let Some(active) = &self.active else { return Ok(None) };
        let masked = self.follow(active, candidate);
        let enough = |l: &Localized| l.matches.len() >= self.config.pose.min_unmasked_inliers;
        if candidate.mask.is_none() || masked.as_ref().is_some_and(enough) {
            return Ok(masked);
        }
        let mask = candidate.mask.take();
        let features = std::mem::take(&mut candidate.features);
        candidate.features = self.extract(candidate.frame, None)?;
        let unmasked = self.active.as_ref().and_then(|active| self.follow(active, candidate));
        if unmasked.is_none() {
            candidate.mask = mask;
            candidate.features = features;
            return Ok(masked);
        }
        Ok(unmasked)
    }

    fn follow(&self, active: &Active, candidate: &Candidate<'_>) -> Option<Localized> {
        let expectation = Expectation {
            predicted: active.motion.predict(candidate.frame.stamp()),
            last: *active.motion.T_camera_world(),
            last_points: &active.last_points,
            reference: active.reference,
        };
        self.localizer().follow(&candidate.features, &expectation, &mut self.rng.clone())
    }

    fn relocalize(&mut self, features: &ImageFeatures) -> Option<Localized> {
        if !self.config.places.relocalization {
            return None;
        }
        let candidates = self.places.query(features.descriptors());
        let mut rng = self.rng.clone();
        let ids = candidates.into_iter().map(|(id, _)| id);
        let found = self.localizer().relocalize(features, ids, self.config.places.min_inliers, &mut rng);
        self.rng = rng;
        found
    }

    /// Updates state, motion and map with the outcome.
    fn integrate(&mut self, candidate: Candidate<'_>, localized: Option<Localized>) -> TrackedFrame {
        let features = candidate.features.len();
        let (inliers, covariance, is_keyframe) = match localized {
            Some(localized) => {
                let (inliers, covariance) = (localized.matches.len(), localized.covariance);
                (inliers, covariance, self.accept(candidate, &localized))
            }
            None if self.active.is_none() => (0, Matrix6::zeros(), self.initialize(candidate)),
            None => (0, Matrix6::zeros(), self.lose(candidate)),
        };
        let known = matches!(self.state, TrackingState::Ok | TrackingState::Relocalized);
        let motion = self.active.as_ref().filter(|_| known).map(|active| &active.motion);
        TrackedFrame {
            stamp: self.last_stamp.unwrap_or_default(),
            state: self.state,
            T_world_camera: motion.map(|m| m.T_camera_world().inverse()),
            T_odom_camera: motion.map(|m| *m.T_odom_camera()),
            covariance,
            features: features as u32,
            inliers: inliers as u32,
            keyframes: self.map.keyframe_count() as u32,
            map_points: self.map.point_count() as u32,
            is_keyframe,
            timing: StageTimes::default(),
        }
    }

    /// Starts the map from a frame with enough depth. The first camera is the origin of the world. Unless its mask knew what moves,
    /// the map is judged again later.
    fn initialize(&mut self, candidate: Candidate<'_>) -> bool {
        let unknown = !candidate.mask.is_some_and(|mask| mask.fraction() > 0.0);
        let motion = Motion::start(candidate.frame.stamp(), Pose::identity(), Pose::identity());
        let mut first_frames = FirstFrames::default();
        first_frames.push(candidate.frame.stamp(), candidate.features.clone());
        let started = self.start_from(candidate, motion);
        self.first_frames = (started && unknown && self.config.mapping.first_frames > 0).then_some(first_frames);
        started
    }

    /// Once [`crate::config::MappingConfig::first_frames`] have passed: when the mask shows that something moves, the map starts
    /// anew with this frame, and the frames before it are tracked again. Returns whether it did.
    fn begin_anew(&mut self, candidate: &Candidate<'_>) -> bool {
        let Some(first_frames) = &mut self.first_frames else { return false };
        if first_frames.len() < self.config.mapping.first_frames {
            first_frames.push(candidate.frame.stamp(), candidate.features.clone());
            return false;
        }
        let Some(first_frames) = self.first_frames.take() else { return false };
        let moving = candidate.mask.is_some_and(|mask| mask.fraction() > 0.0);
        if !moving || candidate.features.with_depth() < self.config.pose.min_initial_points {
            return false;
        }
        let newest =
            Keyframe::new(candidate.frame.stamp(), self.frame_index, Pose::identity(), candidate.features.clone());
        let Some(poses) = first_frames.track_back_from(newest, &self.camera, &self.config) else { return false };
        self.replace_map(candidate, &poses);
        true
    }

    /// Puts a map made of `candidate` in the place of the present one; `poses` are those of all frames up to it.
    fn replace_map(&mut self, candidate: &Candidate<'_>, poses: &[(Stamp, Pose)]) {
        let [.., (_, before), (stamp, pose)] = poses else { return };
        // What was under way concerns the old map.
        drop(self.adjustment.take().and_then(PendingAdjustment::wait));
        self.map = Map::default();
        self.keyframe_order.clear();
        self.places = PlaceIndex::new(self.seed);
        self.trajectory = TrajectoryLog::default();
        let keyframe = Keyframe::new(*stamp, self.frame_index, *pose, candidate.features.clone());
        let reference = self.insert_keyframe(keyframe, &[]);
        for (stamp, pose) in poses {
            self.trajectory.push(&self.map, *stamp, reference, pose);
        }
        let last_points = self.points_of(reference);
        if let Some(active) = &mut self.active {
            active.motion.revise(before, *pose);
            (active.reference, active.last_points) = (reference, last_points);
        }
    }

    /// The camera is lost. When it has been so for long in view of something, a new segment of the map starts at the last known
    /// pose. Returns whether the frame became a keyframe.
    fn lose(&mut self, candidate: Candidate<'_>) -> bool {
        self.state = TrackingState::Lost;
        self.first_frames = None;
        let stamp = candidate.frame.stamp();
        if candidate.features.with_depth() < self.config.pose.min_initial_points {
            self.lost_since = None;
            return false;
        }
        let since = *self.lost_since.get_or_insert(stamp);
        let Some(active) = &self.active else { return false };
        if !self.config.mapping.enabled || stamp.seconds_since(since) < self.config.places.new_segment_after {
            return false;
        }
        let mut motion = active.motion.clone();
        motion.restart(stamp, *active.motion.T_camera_world());
        self.segments.begin();
        self.start_from(candidate, motion)
    }

    /// Makes the first keyframe of a segment, if the frame has enough depth for it.
    fn start_from(&mut self, candidate: Candidate<'_>, motion: Motion) -> bool {
        if candidate.features.with_depth() < self.config.pose.min_initial_points {
            return false;
        }
        let (stamp, pose) = (candidate.frame.stamp(), *motion.T_camera_world());
        let keyframe = Keyframe::new(stamp, self.frame_index, pose, candidate.features);
        let reference = self.insert_keyframe(keyframe, &[]);
        self.trajectory.push(&self.map, stamp, reference, &pose);
        self.active = Some(Active { motion, reference, last_points: self.points_of(reference) });
        self.state = TrackingState::Ok;
        self.lost_since = None;
        true
    }

    /// Takes over a pose. Returns whether the frame became a keyframe.
    fn accept(&mut self, candidate: Candidate<'_>, localized: &Localized) -> bool {
        let was_lost = self.state == TrackingState::Lost;
        self.state = if was_lost { TrackingState::Relocalized } else { TrackingState::Ok };
        let stamp = candidate.frame.stamp();
        self.lost_since = None;
        let reference = self.reference_of(localized);
        if let Some(reference) = reference {
            self.segments.enter(reference);
        }
        if !was_lost && self.config.mapping.enabled {
            self.revise_last_velocity(stamp, &localized.T_camera_world);
        }
        if let Some(active) = &mut self.active {
            if was_lost {
                active.motion.restart(stamp, localized.T_camera_world);
            } else {
                active.motion.update(stamp, localized.T_camera_world);
            }
            active.last_points = localized.matches.iter().map(|m| m.point).collect();
            active.reference = reference.unwrap_or(active.reference);
            self.trajectory.push(&self.map, stamp, active.reference, &localized.T_camera_world);
        }
        if !self.config.mapping.enabled {
            return false;
        }
        if self.begin_anew(&candidate) {
            return true;
        }
        self.remember(&candidate, localized);
        if !self.keyframe_is_due(&candidate, localized) {
            return false;
        }
        self.take_over_adjustment(true);
        self.add_keyframe(candidate, localized);
        true
    }

    /// When the last frame became a keyframe, its velocity follows better from the intervals on both sides of it.
    #[allow(non_snake_case)]
    fn revise_last_velocity(&mut self, stamp: Stamp, T_camera_world: &Pose) {
        let (Some(active), Some(&newest)) = (&self.active, self.keyframe_order.last()) else { return };
        let Some(keyframe) = self.map.keyframe(newest).filter(|k| k.frame_index + 1 == self.frame_index) else {
            return;
        };
        let velocity = active.motion.velocity_between(stamp, T_camera_world);
        let shutter = Shutter { velocity, ..*keyframe.features.shutter() };
        local_mapping::set_shutter(&mut self.map, &self.camera, newest, shutter);
    }

    /// The keyframe that shares most points with the frame.
    fn reference_of(&self, localized: &Localized) -> Option<KeyframeId> {
        self.map.observers(localized.matches.iter().map(|m| m.point)).first().map(|(id, _)| *id)
    }

    fn remember(&mut self, candidate: &Candidate<'_>, localized: &Localized) {
        local_mapping::update_point_memory(
            &mut self.map,
            &self.camera,
            &self.config,
            (candidate.frame.depth(), candidate.mask),
            &localized.T_camera_world,
            (&localized.sought, &localized.matches),
        );
    }

    /// Mur-Artal and Tardós, T-RO 2017, section III-E: too little is left of the reference keyframe, or much new is in view.
    fn keyframe_is_due(&self, candidate: &Candidate<'_>, localized: &Localized) -> bool {
        let Some(active) = &self.active else { return false };
        let Some(reference) = self.map.keyframe(active.reference) else { return true };
        let newest = self.keyframe_order.last().and_then(|id| self.map.keyframe(*id));
        let gap = newest.map_or(usize::MAX, |k| self.frame_index.saturating_sub(k.frame_index));
        // Points from pixels that may move must not enter the map.
        let without_mask = candidate.mask.is_none() && localized.matches.len() < self.config.pose.min_unmasked_inliers;
        if gap < self.config.mapping.min_keyframe_gap || without_mask {
            return false;
        }
        let established = usize::min(3, self.map.keyframe_count());
        let of_reference = reference
            .observed()
            .filter(|(_, p)| self.map.point(*p).is_some_and(|p| p.observations().len() >= established))
            .count();
        let matched = localized.matches.len();
        let few = (matched as f64) < self.config.mapping.keyframe_inlier_ratio * of_reference as f64;
        let with_depth = |m: &&Match| candidate.features.measurement(m.feature).depth.is_some();
        let matched_with_depth = localized.matches.iter().filter(with_depth).count();
        let new = candidate.features.with_depth().saturating_sub(matched_with_depth);
        let wanted = self.config.mapping.wanted_points;
        few || (matched_with_depth < wanted && new > wanted)
    }

    fn add_keyframe(&mut self, candidate: Candidate<'_>, localized: &Localized) {
        // The adjustment that was just taken over may have moved the pose.
        let pose = self.active.as_ref().map_or(localized.T_camera_world, |a| *a.motion.T_camera_world());
        let keyframe = Keyframe::new(candidate.frame.stamp(), self.frame_index, pose, candidate.features);
        let id = self.insert_keyframe(keyframe, &localized.matches);
        local_mapping::cull_points(&mut self.map, &self.config, &self.keyframe_order);
        self.cull_keyframes(id);
        self.close_loop(id);
        let last_points = self.points_of(id);
        if let Some(active) = &mut self.active {
            active.reference = id;
            active.last_points = last_points;
        }
        self.start_adjustment(id);
    }

    /// Corrects the map when `newest` shows a place that was seen long ago.
    fn close_loop(&mut self, newest: KeyframeId) {
        if !self.config.places.loop_closing {
            return;
        }
        let mut rng = self.rng.clone();
        let search =
            loop_closing::Search { places: &self.places, order: &self.keyframe_order, segments: &self.segments };
        let found = loop_closing::detect(&self.localizer(), &search, newest, &mut rng);
        self.rng = rng;
        let Some(found) = found else { return };
        let segment = self.segments.with(&self.keyframe_order, newest);
        if self.segments.are_joined(found.current, found.earlier) {
            loop_closing::close(&mut self.map, &self.camera, &self.config, &segment, &found);
            self.loops += 1;
        } else {
            loop_closing::merge(&mut self.map, &self.camera, &self.config, &segment, &found);
            self.segments.join(found.current, found.earlier);
        }
        if let (Some(active), Some(keyframe)) = (&mut self.active, self.map.keyframe(newest)) {
            active.motion.correct(keyframe.T_camera_world);
        }
    }

    /// Loops closed since the start.
    pub fn loops(&self) -> usize {
        self.loops
    }

    fn insert_keyframe(&mut self, keyframe: Keyframe, matches: &[Match]) -> KeyframeId {
        let id = local_mapping::insert_keyframe(&mut self.map, &self.camera, &self.config, keyframe, matches);
        if let Some(keyframe) = self.map.keyframe(id) {
            self.places.insert(id, keyframe.features.descriptors());
        }
        self.keyframe_order.push(id);
        self.segments.add(id);
        id
    }

    fn points_of(&self, keyframe: KeyframeId) -> Vec<MapPointId> {
        self.map.keyframe(keyframe).into_iter().flat_map(|k| k.observed().map(|(_, point)| point)).collect()
    }

    /// Drops keyframes near `newest` that add nothing. The first one stays: it is the origin.
    fn cull_keyframes(&mut self, newest: KeyframeId) {
        let first = self.keyframe_order.first().copied();
        let candidates: Vec<_> = self.map.covisible(newest).into_iter().map(|(id, _)| id).collect();
        for id in local_mapping::redundant_keyframes(&self.map, &self.config, &candidates) {
            // Removing one makes others less redundant.
            let still = local_mapping::redundant_keyframes(&self.map, &self.config, &[id]).contains(&id);
            if Some(id) != first && still {
                self.remove_keyframe(id);
            }
        }
    }

    fn remove_keyframe(&mut self, id: KeyframeId) {
        let standin = self.map.covisible(id).first().map(|(other, _)| *other);
        let Some(standin) = standin else { return };
        self.trajectory.replace(&self.map, id, standin);
        if let Some(keyframe) = self.map.keyframe(id) {
            self.places.remove(id, keyframe.features.descriptors());
        }
        self.map.remove_keyframe(id);
        self.keyframe_order.retain(|other| *other != id);
    }

    fn start_adjustment(&mut self, center: KeyframeId) {
        let config = self.config.bundle_adjustment.clone();
        if !config.enabled || self.map.keyframe_count() < 2 {
            return;
        }
        let problem = BundleProblem::local(&self.map, &self.camera, center, &config);
        let due_frame = self.frame_index + config.delay_frames;
        self.adjustment = PendingAdjustment::start(problem, config, due_frame);
    }

    /// Writes a finished bundle adjustment into the map once it is due (or `now`), at the same frame in every run.
    fn take_over_adjustment(&mut self, now: bool) {
        let due = self.adjustment.take_if(|pending| now || pending.is_due(self.frame_index));
        let Some(result) = due.and_then(PendingAdjustment::wait) else { return };
        let reference = self.active.as_ref().map(|active| active.reference);
        let pose_of = |map: &Map| reference.and_then(|id| map.keyframe(id)).map(|k| k.T_camera_world);
        let before = pose_of(&self.map);
        bundle_adjustment::apply(&mut self.map, &result);
        if let (Some(before), Some(after), Some(active)) = (before, pose_of(&self.map), &mut self.active) {
            let corrected = active.motion.T_camera_world() * before.inverse() * after;
            active.motion.correct(corrected);
        }
    }

    /// Waits for background work and takes it over.
    pub fn finish(&mut self) {
        self.take_over_adjustment(true);
    }

    /// Forgets the map and everything else; configuration and camera, with its readout time, stay.
    pub fn reset(&mut self) {
        self.take_over_adjustment(true);
        self.map = Map::default();
        self.keyframe_order.clear();
        self.places = PlaceIndex::new(self.seed);
        self.rng = Pcg32::seed_from_u64(self.seed);
        self.trajectory = TrajectoryLog::default();
        self.segments = Segments::default();
        self.state = TrackingState::NotInitialized;
        self.last_stamp = None;
        self.lost_since = None;
        self.first_frames = None;
        self.active = None;
    }

    /// Writes the map to a file: its largest segment.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save_map(&self, path: &Path) -> Result<(), MapFileError> {
        let order = self.segments.largest(&self.keyframe_order);
        if order.len() == self.keyframe_order.len() {
            return map_file::save(path, &self.map, &order, &self.camera);
        }
        let mut map = self.map.clone();
        self.keyframe_order.iter().filter(|id| !order.contains(id)).for_each(|id| map.remove_keyframe(*id));
        map_file::save(path, &map, &order, &self.camera)
    }

    /// Replaces the map by that of a file. The camera counts as lost until it is recognised there.
    ///
    /// # Errors
    /// When the file is no map of this camera; the present map stays.
    pub fn load_map(&mut self, path: &Path) -> Result<(), MapFileError> {
        let (map, order) = map_file::load(path, &self.camera)?;
        self.reset();
        for (id, keyframe) in order.iter().filter_map(|id| Some((*id, map.keyframe(*id)?))) {
            self.places.insert(id, keyframe.features.descriptors());
        }
        if let Some((reference, keyframe)) = order.last().and_then(|id| Some((*id, map.keyframe(*id)?))) {
            let motion = Motion::start(keyframe.stamp, keyframe.T_camera_world, Pose::identity());
            self.refinement = Refinement::new(keyframe.features.shutter().readout);
            self.active = Some(Active { motion, reference, last_points: Vec::new() });
            self.state = TrackingState::Lost;
            self.frame_index = self.frame_index.max(keyframe.frame_index + 1);
        }
        (self.map, self.keyframe_order) = (map, order);
        Ok(())
    }

    /// The estimated time from the first to the last row of an image, seconds.
    pub fn readout(&self) -> f64 {
        self.refinement.readout()
    }

    /// The map.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Poses (camera to world) of all tracked frames by the present state of the map.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        self.trajectory.poses(&self.map)
    }

    /// Poses (camera to world) of the keyframes, oldest first.
    pub fn keyframe_trajectory(&self) -> Vec<StampedPose> {
        let pose = |id: &KeyframeId| {
            self.map.keyframe(*id).map(|k| StampedPose { stamp: k.stamp, pose: k.T_camera_world.inverse() })
        };
        self.keyframe_order.iter().filter_map(pose).collect()
    }

    /// All map points.
    pub fn map_points(&self) -> Vec<MapPointView> {
        self.map.points().map(|(_, p)| MapPointView { position: p.position, color: p.color }).collect()
    }
}
