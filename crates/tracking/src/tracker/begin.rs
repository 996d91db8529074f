//! How a map begins, and begins anew: with the first frame, after a loss, after a reset, from a file.

use std::path::Path;

use nalgebra::Matrix6;
use pfd_geometry::{Pose, Stamp};
use rand::SeedableRng;
use rand_pcg::Pcg32;

use super::{Candidate, Tracker};
use crate::active::Active;
use crate::first_frames::{FirstFrames, Judgement};
use crate::localization::Localized;
use crate::map::Keyframe;
use crate::map_file::{MapFileError, MapSnapshot};
use crate::mapper::Mapper;
use crate::mask_check;
use crate::motion::Motion;
use crate::motion_filter::UncertainPose;
use crate::refinement::Refinement;
use crate::result::TrackingState;

/// Speed of a camera whose whereabouts nobody knows, m/s and rad/s: the standard deviation of a walk and of looking around.
const SPEED: f64 = 1.0;
/// After so long, seconds, it may be anywhere. The last keyframe of a map that was loaded may be days old, or younger than the frame.
const ANYWHERE_AFTER: f64 = 100.0;

/// The map begins anew a second time where a mask covers this share of what it holds in view, …
const COVERED: f64 = 0.1;
/// … until so many times the first frames have passed. Tracking all of them again takes a tenth of a second.
const LAST_LOOK: usize = 4;

/// Covariance of the motion of a camera that was lost for so long, seconds.
fn displacement_covariance(seconds: f64) -> Matrix6<f64> {
    Matrix6::from_diagonal_element((SPEED * seconds.abs().min(ANYWHERE_AFTER)).powi(2))
}

impl Tracker {
    /// Starts the map from a frame with enough depth; without, nothing changes. The first camera is the origin of the world. Unless its
    /// mask knew what moves, the map is judged again later.
    pub(super) fn initialize(&mut self, candidate: Candidate<'_>) -> bool {
        let unknown = !candidate.mask.is_some_and(|mask| mask.fraction() > 0.0);
        let motion = Motion::start(candidate.frame.stamp(), Pose::identity(), self.T_odom_start);
        let mut first_frames = FirstFrames::default();
        first_frames.push(candidate.frame.stamp(), candidate.features.clone());
        let started = self.start_from(candidate, motion);
        self.first_frames = (started && unknown && self.config.mapping.first_frames > 0).then_some(first_frames);
        started
    }

    /// Once [`crate::config::MappingConfig::first_frames`] have passed: when the mask shows that something moves, the map starts
    /// anew with this frame, and the frames before it are tracked again. The same happens some time later when a mask covers much of what
    /// the map holds: a mover that was found late has taken the first poses along. Returns whether it did.
    pub(super) fn begin_anew(&mut self, candidate: &Candidate<'_>, localized: &Localized) -> bool {
        let Some(mut first_frames) = self.first_frames.take() else { return false };
        let enough = self.config.mapping.first_frames;
        let holds_movers = candidate.mask.filter(|_| first_frames.len() >= enough).is_some_and(|mask| {
            let (model, depth) = ((&self.camera, &self.config), candidate.frame.depth());
            match first_frames.judge() {
                Judgement::First => mask.fraction() > 0.0,
                Judgement::Again => {
                    mask_check::covered_share(self.mapper.map(), model, mask, depth, localized) > COVERED
                }
            }
        });
        let begun = holds_movers && self.start_from_here(&first_frames, candidate);
        first_frames.push(candidate.frame.stamp(), candidate.features.clone());
        self.first_frames = (first_frames.len() < LAST_LOOK * enough).then_some(first_frames);
        begun
    }

    /// Replaces the map by one that starts with this frame, if the frames before can be tracked in that. Returns whether they can.
    fn start_from_here(&mut self, first_frames: &FirstFrames, candidate: &Candidate<'_>) -> bool {
        if candidate.features.with_depth() < self.config.pose.min_initial_points {
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
    pub(super) fn lose(&mut self, candidate: Candidate<'_>) -> bool {
        self.state = TrackingState::Lost;
        let enough = self.config.mapping.first_frames;
        let has_just_begun = self.first_frames.take().is_some_and(|frames| frames.len() <= enough);
        let stamp = candidate.frame.stamp();
        if candidate.features.with_depth() < self.config.pose.min_initial_points {
            self.lost_since = None;
            return false;
        }
        if has_just_begun {
            self.T_odom_start = self.T_odom_now();
            self.mapper.clear();
            self.active = None;
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
        (self.last_stamp, self.loaded) = (None, None);
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
}
