//! The state machine around localisation and mapping.

mod begin;
mod grow;
mod localize;

use nalgebra::Matrix6;
use pfd_geometry::{Camera, Mask, Pose, RgbdFrame, StageTimes, Stamp, StampedPose};
use pfd_vision::features::FeatureExtractor;
use rand::SeedableRng;
use rand_pcg::Pcg32;

use crate::active::Active;
use crate::config::TrackingConfig;
use crate::first_frames::FirstFrames;
use crate::image_features::ImageFeatures;
use crate::localization::Localized;
use crate::map::{KeyframeId, Map};
use crate::mapper::Mapper;
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
    /// The frame whose image the extractor has taken, until it is tracked.
    loaded: Option<Stamp>,
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
            loaded: None,
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

    /// Detects the corners of a frame before its mask is known, which [`Self::locate`] does otherwise: whoever waits for the mask gains that
    /// time, and nothing else changes.
    ///
    /// # Errors
    /// When the frame does not fit the camera, or OpenCV fails.
    pub fn detect_corners(&mut self, frame: &RgbdFrame) -> Result<(), TrackingError> {
        frame.check_camera(&self.camera)?;
        self.loaded = None;
        self.extractor.load(frame.gray())?;
        self.loaded = Some(frame.stamp());
        Ok(())
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
        if self.loaded.take() != Some(frame.stamp()) {
            timing.measure("corners", || self.extractor.load(frame.gray()))?;
        }
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

    /// Features of the frame that the extractor has taken.
    fn extract(&self, frame: &RgbdFrame, mask: Option<&Mask>) -> Result<ImageFeatures, TrackingError> {
        let features = self.extractor.extract(mask, self.config.features.mask_margin)?;
        let patches = self.extractor.patches(&features)?;
        let mut features = ImageFeatures::new(features, frame, &self.config).with_patches(patches);
        let followed = self.active.as_ref().filter(|_| self.state != TrackingState::Lost);
        let velocity = followed.map(|active| active.motion.velocity()).unwrap_or_default();
        features.set_shutter(&self.camera, Shutter { velocity, readout: self.refinement.readout() });
        Ok(features)
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

    /// Poses (camera to world) of the tracked frames by the present state of the map, without those in parts of it whose place in the world
    /// is not known: where a camera that stayed lost began anew and never saw the largest part again.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        self.mapper.trajectory()
    }

    /// Poses (camera to world) of the last `count` tracked frames, in whatever part of the map.
    pub fn recent_trajectory(&self, count: usize) -> Vec<StampedPose> {
        self.mapper.recent_trajectory(count)
    }

    /// Poses (camera to world) of the keyframes of the largest part of the map, oldest first.
    pub fn keyframe_trajectory(&self) -> Vec<StampedPose> {
        self.mapper.keyframe_trajectory()
    }

    /// Poses (camera to world) of all keyframes, oldest first.
    pub fn keyframe_poses(&self) -> Vec<StampedPose> {
        self.mapper.keyframe_poses()
    }

    /// All map points.
    pub fn map_points(&self) -> Vec<MapPointView> {
        self.map().points().map(|(_, p)| MapPointView { position: p.position, color: p.color }).collect()
    }
}
