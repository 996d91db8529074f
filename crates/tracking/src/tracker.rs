//! The state machine around localisation and mapping.

use std::path::Path;

use nalgebra::{Matrix6, Vector6};
use pfd_geometry::{Camera, Mask, Pose, RgbdFrame, StageTimes, Stamp, StampedPose};
use pfd_vision::features::FeatureExtractor;
use rand::SeedableRng;
use rand_pcg::Pcg32;

use crate::active::Active;
use crate::config::TrackingConfig;
use crate::first_frames::FirstFrames;
use crate::image_features::ImageFeatures;
use crate::keyframe_decision;
use crate::local_mapping;
use crate::localization::{Localized, Localizer};
use crate::map::{Keyframe, KeyframeId, Map};
use crate::map_file::{MapFileError, MapSnapshot};
use crate::mapper::Mapper;
use crate::mask_check;
use crate::motion::Motion;
use crate::motion_filter::UncertainPose;
use crate::refinement::Refinement;
use crate::result::{MapPointView, TrackedFrame, TrackingError, TrackingState};
use crate::rolling_shutter::Shutter;

/// Camera tracking and mapping.
#[allow(non_snake_case)]
pub struct Tracker {
    camera: Camera,
    config: TrackingConfig,
    extractor: FeatureExtractor,
    seed: u64,
    rng: Pcg32,
    mapper: Mapper,
    state: TrackingState,
    frame_index: usize,
    last_stamp: Option<Stamp>,
    active: Option<Active>,
    loops: usize,
    /// Since when the camera has been lost although there is something to see.
    lost_since: Option<Stamp>,
    /// Kept until the map was judged by masks that know what moves.
    first_frames: Option<FirstFrames>,
    /// Pose of the camera in the odometry frame with which the next map starts.
    T_odom_start: Pose,
    /// Of the segment that the camera is in, with respect to the one that holds the origin.
    segment_covariance: Matrix6<f64>,
    /// With the readout time, a property of the camera: it outlives the map.
    refinement: Refinement,
}

/// Variance of the first pose (m², rad²), which defines the world: a millimetre and a milliradian, as nobody can work with zero.
const FIRST_VARIANCE: f64 = 1e-6;

/// Speed of a camera whose whereabouts nobody knows, m/s and rad/s: the standard deviation of a walk and of looking around.
const SPEED: f64 = 1.0;
/// After so long, seconds, it may be anywhere. The last keyframe of a map that was loaded may be days old, or younger than the frame.
const ANYWHERE_AFTER: f64 = 100.0;

/// Covariance of the motion of a camera that was lost for so long, seconds.
fn displacement_covariance(seconds: f64) -> Matrix6<f64> {
    Matrix6::from_diagonal_element((SPEED * seconds.abs().min(ANYWHERE_AFTER)).powi(2))
}

/// A frame on its way through [`Tracker::track`].
struct Candidate<'a> {
    frame: &'a RgbdFrame,
    index: usize,
    /// `None` once the mask was given up: because it leaves too little, or because the map contradicts it.
    mask: Option<&'a Mask>,
    features: ImageFeatures,
}

/// A frame whose pose is known, and which the map does not contain yet.
#[must_use = "the map grows with Tracker::extend_map"]
pub struct Located<'a> {
    /// The pose, with the size of the map before this frame.
    pub tracked: TrackedFrame,
    /// What the map may take in.
    found: Option<(Candidate<'a>, Localized)>,
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
            mapper: Mapper::new(camera, config.clone(), seed),
            config: config.clone(),
            seed,
            rng: Pcg32::seed_from_u64(seed),
            state: TrackingState::NotInitialized,
            frame_index: 0,
            last_stamp: None,
            active: None,
            loops: 0,
            lost_since: None,
            first_frames: None,
            T_odom_start: Pose::identity(),
            segment_covariance: Matrix6::zeros(),
            refinement: Refinement::new(config.rolling_shutter.readout),
        })
    }

    /// Lets the odometry go on from where that of `before` is: for a tracker that takes its place.
    #[must_use]
    pub fn continuing(self, before: &Self) -> Self {
        Self { T_odom_start: before.T_odom_now(), ..self }
    }

    /// Pose of the camera in the odometry frame, the last one that is known.
    #[allow(non_snake_case)]
    fn T_odom_now(&self) -> Pose {
        self.active.as_ref().map_or(self.T_odom_start, |active| *active.motion.T_odom_camera())
    }

    /// Whether a frame waits for a bundle adjustment that is not done when its result is due (the default: every run gives the same).
    /// Otherwise frames go on without it, and the next keyframe comes when it is done.
    pub fn set_waiting(&mut self, waits: bool) {
        self.mapper.set_waiting(waits);
    }

    /// Estimates the pose of `frame` and extends the map. Pixels that `mask` calls dynamic are not used.
    ///
    /// # Errors
    /// [`TrackingError`] when frame or mask do not fit the camera, or the frame is not newer than the last.
    pub fn track(&mut self, frame: &RgbdFrame, mask: Option<&Mask>) -> Result<TrackedFrame, TrackingError> {
        let located = self.locate(frame, mask)?;
        Ok(self.extend_map(located))
    }

    /// The first half of [`Self::track`]: the pose. It can be used while [`Self::extend_map`] is still at work.
    ///
    /// # Errors
    /// As [`Self::track`].
    pub fn locate<'a>(&mut self, frame: &'a RgbdFrame, mask: Option<&'a Mask>) -> Result<Located<'a>, TrackingError> {
        frame.check_camera(&self.camera)?;
        if let Some(last) = self.last_stamp.filter(|last| frame.stamp() <= *last) {
            return Err(TrackingError::OutOfOrder { stamp: frame.stamp(), last });
        }
        let mut timing = StageTimes::default();
        let features = timing.measure("features", || self.extract(frame, mask))?;
        if self.config.mapping.enabled {
            self.mapper.refresh_shutters(self.refinement.readout());
        }
        timing.measure("take over map", || {
            let reference = self.active.as_ref().map(|active| active.reference);
            let moved = self.mapper.take_over_due(self.frame_index, reference);
            self.move_with_map(moved);
        });
        self.last_stamp = Some(frame.stamp());
        let mut candidate = Candidate { frame, index: self.frame_index, mask, features };
        let localized = timing.measure("localize", || self.localize(&mut candidate))?;
        let localized = timing.measure("refine", || localized.map(|found| self.refine(&mut candidate.features, found)));
        let located = self.conclude(candidate, localized);
        self.frame_index += 1;
        Ok(Located { tracked: TrackedFrame { timing, ..located.tracked }, ..located })
    }

    /// The second half of [`Self::track`]: what the frame means for the map. Nothing may happen to this tracker in between.
    pub fn extend_map(&mut self, located: Located<'_>) -> TrackedFrame {
        let Located { mut tracked, found } = located;
        let mut timing = std::mem::take(&mut tracked.timing);
        timing.measure("map", || {
            if let Some((candidate, localized)) = found {
                tracked.is_keyframe = self.update_map(candidate, &localized);
            }
        });
        let map = self.mapper.map();
        TrackedFrame { keyframes: map.keyframe_count() as u32, map_points: map.point_count() as u32, timing, ..tracked }
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
        Localizer { camera: &self.camera, config: &self.config, map: self.mapper.map() }
    }

    /// The pose of the candidate: with the mask, where that leaves too little without, and at last by recognising the place.
    fn localize(&mut self, candidate: &mut Candidate<'_>) -> Result<Option<Localized>, TrackingError> {
        if self.active.is_none() {
            self.see_enough_to_start(candidate)?;
            return Ok(None);
        }
        if self.state != TrackingState::Lost
            && let Some(followed) = self.follow_with_or_without_mask(candidate)?
        {
            return Ok(Some(followed));
        }
        // Also for a frame that could not be followed the camera may be found in the map as a whole.
        self.state = TrackingState::Lost;
        let found = self.relocalize(&candidate.features);
        if found.is_some() || !self.leaves_little(candidate) {
            return Ok(found);
        }
        self.see_enough_to_start(candidate)?;
        Ok(self.relocalize(&candidate.features))
    }

    /// Whether a mask leaves little to go by.
    fn leaves_little(&self, candidate: &Candidate<'_>) -> bool {
        let few = candidate.features.with_depth() < self.config.pose.min_initial_points;
        candidate.mask.is_some_and(|mask| few || mask.fraction() > self.config.pose.doubtful_mask)
    }

    /// A map starts, or is found again, without a mask that leaves too little for it, or covers much: nothing is known yet that could
    /// contradict it, and as long as it stays, little else would ever be tracked. What moves is found out by [`Self::begin_anew`].
    fn see_enough_to_start(&mut self, candidate: &mut Candidate<'_>) -> Result<(), TrackingError> {
        if self.leaves_little(candidate) {
            candidate.mask = None;
            candidate.features = self.extract(candidate.frame, None)?;
        }
        Ok(())
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
        let localizer = Localizer { camera: &self.camera, config: &self.config, map: self.mapper.map() };
        self.refinement.refine(&localizer, velocity, features, found)
    }

    /// Follows the camera by what the mask leaves. Where that is too little, or the mask covers much and the map is seen behind it,
    /// the mask is given up.
    fn follow_with_or_without_mask(
        &mut self,
        candidate: &mut Candidate<'_>,
    ) -> Result<Option<Localized>, TrackingError> {
        let Some(active) = &self.active else { return Ok(None) };
        let masked = self.follow(active, candidate);
        let Some(mask) = candidate.mask else { return Ok(masked) };
        let enough = masked.as_ref().is_some_and(|l| l.matches.len() >= self.config.pose.min_unmasked_inliers);
        if enough && mask.fraction() < self.config.pose.doubtful_mask {
            return Ok(masked);
        }
        let unmasked_features = self.extract(candidate.frame, None)?;
        let masked_features = std::mem::replace(&mut candidate.features, unmasked_features);
        let unmasked = self.active.as_ref().and_then(|active| self.follow(active, candidate));
        let model = (&self.camera, &self.config);
        let Some(found) = unmasked else {
            candidate.features = masked_features;
            return Ok(masked);
        };
        let map = self.mapper.map();
        let agrees =
            !enough || masked.as_ref().is_none_or(|masked| mask_check::agree(map, &self.camera, masked, &found));
        let contradicted = agrees && mask_check::is_contradicted(map, model, mask, &candidate.features, &found);
        if contradicted || !enough && masked.as_ref().is_none_or(|masked| found.surpasses(masked)) {
            candidate.mask = None;
            return Ok(Some(found));
        }
        candidate.features = masked_features;
        Ok(masked)
    }

    fn follow(&self, active: &Active, candidate: &Candidate<'_>) -> Option<Localized> {
        let expectation = active.expectation(candidate.frame.stamp());
        self.localizer().follow(&candidate.features, &expectation, &mut self.rng.clone())
    }

    fn relocalize(&mut self, features: &ImageFeatures) -> Option<Localized> {
        if !self.config.places.relocalization {
            return None;
        }
        let ids = self.mapper.place_candidates(features.descriptors());
        let mut rng = self.rng.clone();
        let found = self.localizer().relocalize(features, ids.into_iter(), self.config.places.min_inliers, &mut rng);
        self.rng = rng;
        found
    }

    /// Updates state and motion with the outcome. Without a map, or lost for long, a map starts here.
    fn conclude<'a>(&mut self, candidate: Candidate<'a>, localized: Option<Localized>) -> Located<'a> {
        let (features, mask_used) = (candidate.features.len(), candidate.mask.is_some());
        let localized = localized.map(|found| self.smooth(candidate.frame.stamp(), found));
        let (inliers, covariance) =
            localized.as_ref().map_or((0, Matrix6::from_diagonal_element(FIRST_VARIANCE)), |found| {
                (found.matches.len(), found.covariance)
            });
        let (is_keyframe, found) = match localized {
            Some(localized) => {
                self.accept(&candidate, &localized);
                (false, Some((candidate, localized)))
            }
            None if self.active.is_none() => (self.initialize(candidate), None),
            None => (self.lose(candidate), None),
        };
        let known = matches!(self.state, TrackingState::Ok | TrackingState::Relocalized);
        let motion = self.active.as_ref().filter(|_| known).map(|active| &active.motion);
        let (twist, twist_covariance) = motion.map(Motion::twist).unwrap_or_default();
        let is_apart = self.mapper.is_apart();
        if !is_apart {
            self.segment_covariance = Matrix6::zeros();
        }
        let map = self.mapper.map();
        let tracked = TrackedFrame {
            stamp: self.last_stamp.unwrap_or_default(),
            state: self.state,
            T_world_camera: motion.map(|m| m.T_camera_world().inverse()),
            T_odom_camera: motion.map(|m| *m.T_odom_camera()),
            covariance: covariance + self.segment_covariance,
            is_apart,
            twist,
            twist_covariance,
            mask_used,
            features: features as u32,
            inliers: inliers as u32,
            keyframes: map.keyframe_count() as u32,
            map_points: map.point_count() as u32,
            is_keyframe,
            timing: StageTimes::default(),
        };
        Located { tracked, found }
    }

    /// Adds to a pose what the frames before say about it; nothing when the camera was lost.
    fn smooth(&mut self, stamp: Stamp, found: Localized) -> Localized {
        let by_frame = UncertainPose::found(found.T_camera_world, &found.covariance);
        let followed = self.active.as_mut().filter(|_| self.state != TrackingState::Lost);
        let known = followed.map_or(by_frame, |active| active.motion.smooth(stamp, &by_frame));
        Localized { T_camera_world: known.T_camera_world, covariance: known.covariance, ..found }
    }

    /// Starts the map from a frame with enough depth; without, nothing changes. The first camera is the origin of the world. Unless its mask knew what moves,
    /// the map is judged again later.
    fn initialize(&mut self, candidate: Candidate<'_>) -> bool {
        let unknown = !candidate.mask.is_some_and(|mask| mask.fraction() > 0.0);
        let motion = Motion::start(candidate.frame.stamp(), Pose::identity(), self.T_odom_start);
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
        let enough = self.config.mapping.first_frames;
        // A frame of which the mask is late decides nothing.
        if first_frames.len() < enough || candidate.mask.is_none() && first_frames.len() < 2 * enough {
            first_frames.push(candidate.frame.stamp(), candidate.features.clone());
            return false;
        }
        let Some(first_frames) = self.first_frames.take() else { return false };
        let moving = candidate.mask.is_some_and(|mask| mask.fraction() > 0.0);
        if !moving || candidate.features.with_depth() < self.config.pose.min_initial_points {
            return false;
        }
        let newest =
            Keyframe::new(candidate.frame.stamp(), candidate.index, Pose::identity(), candidate.features.clone());
        let Some(poses) = first_frames.track_back_from(newest, &self.camera, &self.config) else { return false };
        self.replace_map(candidate, &poses);
        true
    }

    /// Puts a map made of `candidate` in the place of the present one; `poses` are those of all frames up to it.
    fn replace_map(&mut self, candidate: &Candidate<'_>, poses: &[(Stamp, Pose)]) {
        let [.., (_, before), (stamp, pose)] = poses else { return };
        self.mapper.clear();
        let keyframe = Keyframe::new(*stamp, candidate.index, *pose, candidate.features.clone());
        let reference = self.mapper.insert(keyframe, &[]);
        for (stamp, pose) in poses {
            self.mapper.log_pose(*stamp, reference, pose);
        }
        let last_points = self.mapper.points_of(reference);
        if let Some(active) = &mut self.active {
            active.motion.revise(before, *pose);
            (active.reference, active.last_points) = (reference, last_points);
        }
    }

    /// The camera is lost. When it has been so for long in view of something, a new segment of the map starts at the last known
    /// pose. A map that does not hold the frames right after its first began with a bad image, and begins anew. Returns whether the
    /// frame became a keyframe.
    fn lose(&mut self, candidate: Candidate<'_>) -> bool {
        self.state = TrackingState::Lost;
        let has_just_begun = self.first_frames.take().is_some();
        let stamp = candidate.frame.stamp();
        if candidate.features.with_depth() < self.config.pose.min_initial_points {
            self.lost_since = None;
            return false;
        }
        if has_just_begun {
            self.T_odom_start = self.T_odom_now();
            self.mapper.clear();
            return self.initialize(candidate);
        }
        let since = *self.lost_since.get_or_insert(stamp);
        let Some(active) = &self.active else { return false };
        if !self.config.mapping.enabled || stamp.seconds_since(since) < self.config.places.new_segment_after {
            return false;
        }
        let mut motion = active.motion.clone();
        let here = UncertainPose { T_camera_world: *active.motion.T_camera_world(), covariance: Matrix6::zeros() };
        self.segment_covariance += displacement_covariance(stamp.seconds_since(motion.stamp()));
        motion.restart(stamp, &here);
        self.mapper.begin_segment();
        self.start_from(candidate, motion)
    }

    /// Makes the first keyframe of a segment, if the frame has enough depth for it.
    fn start_from(&mut self, candidate: Candidate<'_>, motion: Motion) -> bool {
        if !self.config.mapping.enabled || candidate.features.with_depth() < self.config.pose.min_initial_points {
            return false;
        }
        let (stamp, pose) = (candidate.frame.stamp(), *motion.T_camera_world());
        let keyframe = Keyframe::new(stamp, candidate.index, pose, candidate.features);
        let reference = self.mapper.insert(keyframe, &[]);
        self.mapper.log_pose(stamp, reference, &pose);
        let last_points = self.mapper.points_of(reference);
        self.active = Some(Active::new(motion, reference, last_points));
        self.state = TrackingState::Ok;
        self.lost_since = None;
        true
    }

    /// Takes over a pose.
    fn accept(&mut self, candidate: &Candidate<'_>, localized: &Localized) {
        let was_lost = self.state == TrackingState::Lost;
        self.state = if was_lost { TrackingState::Relocalized } else { TrackingState::Ok };
        let stamp = candidate.frame.stamp();
        self.lost_since = None;
        let reference = self.reference_of(localized);
        if let Some(reference) = reference {
            self.mapper.enter_segment_of(reference);
        }
        if !was_lost && self.config.mapping.enabled {
            self.revise_last_velocity(stamp, &localized.T_camera_world);
        }
        let Some(active) = &mut self.active else { return };
        active.accept(stamp, localized, reference, was_lost);
        self.mapper.log_pose(stamp, active.reference, &localized.T_camera_world);
    }

    /// When the last frame became a keyframe, its velocity follows better from the intervals on both sides of it.
    #[allow(non_snake_case)]
    fn revise_last_velocity(&mut self, stamp: Stamp, T_camera_world: &Pose) {
        let (Some(active), Some(newest)) = (&self.active, self.mapper.newest()) else { return };
        let keyframe = self.mapper.map().keyframe(newest);
        let Some(keyframe) = keyframe.filter(|k| k.frame_index + 1 == self.frame_index) else { return };
        let velocity = active.motion.velocity_between(stamp, T_camera_world);
        let shutter = Shutter { velocity, ..*keyframe.features.shutter() };
        self.mapper.set_shutter(newest, shutter);
    }

    /// The keyframe that shares most points with the frame.
    fn reference_of(&self, localized: &Localized) -> Option<KeyframeId> {
        self.mapper.map().observers(localized.matches.iter().map(|m| m.point)).first().map(|(id, _)| *id)
    }

    /// What a frame whose pose is known means for the map. Returns whether it became a keyframe.
    fn update_map(&mut self, candidate: Candidate<'_>, localized: &Localized) -> bool {
        if !self.config.mapping.enabled {
            return false;
        }
        if self.begin_anew(&candidate) {
            return true;
        }
        self.remember(&candidate, localized);
        if !self.keyframe_is_due(&candidate, localized) || self.mapper.is_busy() {
            return false;
        }
        self.take_over_adjustment();
        self.add_keyframe(candidate, localized);
        true
    }

    fn remember(&mut self, candidate: &Candidate<'_>, localized: &Localized) {
        local_mapping::update_point_memory(
            self.mapper.map_mut(),
            &self.camera,
            &self.config,
            (candidate.frame.depth(), candidate.mask),
            &localized.T_camera_world,
            (&localized.sought, &localized.matches),
        );
    }

    fn keyframe_is_due(&self, candidate: &Candidate<'_>, localized: &Localized) -> bool {
        let Some(active) = &self.active else { return false };
        let situation = keyframe_decision::Situation {
            stamp: candidate.frame.stamp(),
            resumed: active.resumed,
            agreement_broke_off: active.agreement.broke_off(candidate.frame.stamp()),
            reference: active.reference,
            newest: self.mapper.newest(),
            features: &candidate.features,
            matches: &localized.matches,
            is_masked: candidate.mask.is_some(),
        };
        keyframe_decision::is_due(self.mapper.map(), &self.config, &situation)
    }

    fn add_keyframe(&mut self, candidate: Candidate<'_>, localized: &Localized) {
        // The adjustment that was just taken over may have moved the pose.
        let pose = self.active.as_ref().map_or(localized.T_camera_world, |a| *a.motion.T_camera_world());
        let keyframe = Keyframe::new(candidate.frame.stamp(), candidate.index, pose, candidate.features);
        let id = self.mapper.insert(keyframe, &localized.matches);
        self.mapper.cull(id);
        let closed = self.mapper.close_loop(id, &mut self.rng);
        self.loops += usize::from(closed);
        let last_points = self.mapper.points_of(id);
        if let Some(active) = &mut self.active {
            active.reference = id;
            active.last_points = last_points;
            if let Some(keyframe) = self.mapper.map().keyframe(id).filter(|_| closed) {
                active.motion.correct(keyframe.T_camera_world);
            }
        }
        self.mapper.start_adjustment(id, candidate.index);
    }

    /// The camera moves with its reference keyframe when the map is adjusted.
    fn move_with_map(&mut self, moved: Option<Pose>) {
        if let (Some(moved), Some(active)) = (moved, &mut self.active) {
            active.motion.correct(active.motion.T_camera_world() * moved);
        }
    }

    /// Waits for background work and takes it over.
    pub fn finish(&mut self) {
        self.take_over_adjustment();
    }

    fn take_over_adjustment(&mut self) {
        let reference = self.active.as_ref().map(|active| active.reference);
        let moved = self.mapper.take_over(reference);
        self.move_with_map(moved);
    }

    /// Forgets the map and everything else; configuration and camera, with its readout time, stay, and the odometry goes on from where it
    /// is. Where nothing is mapped the map that was loaded stays as well, and the camera is looked for in it.
    #[allow(non_snake_case)]
    pub fn reset(&mut self) {
        self.T_odom_start = self.T_odom_now();
        self.segment_covariance = Matrix6::zeros();
        if self.config.mapping.enabled {
            self.mapper.clear();
        } else {
            self.mapper.forget_trajectory();
        }
        self.rng = Pcg32::seed_from_u64(self.seed);
        self.state = TrackingState::NotInitialized;
        self.last_stamp = None;
        self.lost_since = None;
        self.first_frames = None;
        self.active = None;
        self.expect_to_be_found();
    }

    /// Where there is a map and no camera in it, the camera counts as lost near the newest keyframe.
    fn expect_to_be_found(&mut self) {
        let newest = self.mapper.newest().and_then(|id| Some((id, self.mapper.map().keyframe(id)?)));
        if let Some((reference, keyframe)) = newest {
            let motion = Motion::start(keyframe.stamp, keyframe.T_camera_world, self.T_odom_start);
            self.frame_index = self.frame_index.max(keyframe.frame_index + 1);
            self.active = Some(Active::new(motion, reference, Vec::new()));
            self.state = TrackingState::Lost;
        }
    }

    /// The readout time with which the newest keyframe of the map was recorded, unless the configuration says what it is.
    fn adopt_readout(&mut self) {
        let newest = self.mapper.newest().and_then(|id| self.mapper.map().keyframe(id));
        if let Some(keyframe) = newest.filter(|_| self.config.rolling_shutter.estimate) {
            self.refinement = Refinement::new(keyframe.features.shutter().readout);
        }
    }

    /// A copy of the map's largest segment. Copying takes a small part of the time that writing takes, during which frames come in.
    pub fn snapshot(&self) -> MapSnapshot {
        self.mapper.snapshot()
    }

    /// Replaces the map by that of a file. The camera counts as lost until it is recognised there.
    ///
    /// # Errors
    /// When the file is no map of this camera, or made with other features; the present map stays.
    pub fn load_map(&mut self, path: &Path) -> Result<(), MapFileError> {
        let mut mapper = Mapper::new(self.camera, self.config.clone(), self.seed);
        mapper.load(path)?;
        mapper.set_waiting(self.mapper.waits());
        self.reset();
        self.mapper = mapper;
        self.active = None;
        self.adopt_readout();
        self.expect_to_be_found();
        Ok(())
    }

    /// The estimated time from the first to the last row of an image, seconds.
    pub fn readout(&self) -> f64 {
        self.refinement.readout()
    }

    /// Loops closed, and segments joined, since the start.
    pub fn loops(&self) -> usize {
        self.loops
    }

    /// The map.
    pub fn map(&self) -> &Map {
        self.mapper.map()
    }

    /// Poses (camera to world) of all tracked frames by the present state of the map.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        self.mapper.trajectory(usize::MAX)
    }

    /// The last `count` of them.
    pub fn recent_trajectory(&self, count: usize) -> Vec<StampedPose> {
        self.mapper.trajectory(count)
    }

    /// Poses (camera to world) of the keyframes, oldest first.
    pub fn keyframe_trajectory(&self) -> Vec<StampedPose> {
        self.mapper.keyframe_trajectory()
    }

    /// All map points.
    pub fn map_points(&self) -> Vec<MapPointView> {
        self.map().points().map(|(_, p)| MapPointView { position: p.position, color: p.color }).collect()
    }
}
