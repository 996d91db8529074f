//! The map with all that is kept beside it: how its keyframes look and hang together, the poses that refer to them, and the bundle
//! adjustment under way.

use std::path::Path;

use pfd_geometry::{Camera, Pose, Stamp, StampedPose};
use rand_pcg::Pcg32;

use crate::background::PendingAdjustment;
use crate::bundle_adjustment::{self, BundleProblem};
use crate::config::TrackingConfig;
use crate::local_mapping;
use crate::localization::Localizer;
use crate::loop_closing;
use crate::map::{Keyframe, KeyframeId, Map, MapPointId};
use crate::map_file::{self, Maker, MapFileError, MapSnapshot};
use crate::matching::Match;
use crate::places::PlaceIndex;
use crate::rolling_shutter::Shutter;
use crate::segments::Segments;
use crate::trajectory::TrajectoryLog;

/// Extends and corrects the map.
pub(crate) struct Mapper {
    camera: Camera,
    config: TrackingConfig,
    /// Decides how places are indexed.
    seed: u64,
    map: Map,
    /// Living keyframes in the order of their creation.
    order: Vec<KeyframeId>,
    places: PlaceIndex,
    segments: Segments,
    trajectory: TrajectoryLog,
    adjustment: Option<PendingAdjustment>,
    /// Whether an adjustment that is due but not done is waited for.
    waits: bool,
}

#[allow(non_snake_case)]
impl Mapper {
    /// A mapper without a map.
    pub(crate) fn new(camera: Camera, config: TrackingConfig, seed: u64) -> Self {
        Self {
            camera,
            config,
            seed,
            map: Map::default(),
            order: Vec::new(),
            places: PlaceIndex::new(seed),
            segments: Segments::default(),
            trajectory: TrajectoryLog::default(),
            adjustment: None,
            waits: true,
        }
    }

    pub(crate) fn map(&self) -> &Map {
        &self.map
    }

    /// For what frames teach about the points they see.
    pub(crate) fn map_mut(&mut self) -> &mut Map {
        &mut self.map
    }

    pub(crate) fn newest(&self) -> Option<KeyframeId> {
        self.order.last().copied()
    }

    /// The points that a keyframe sees.
    pub(crate) fn points_of(&self, keyframe: KeyframeId) -> Vec<MapPointId> {
        self.map.keyframe(keyframe).into_iter().flat_map(|k| k.observed().map(|(_, point)| point)).collect()
    }

    /// Keyframes that may show what is described, likeliest first.
    pub(crate) fn place_candidates<'a>(
        &self,
        descriptors: impl Iterator<Item = &'a pfd_vision::features::Descriptor>,
    ) -> Vec<KeyframeId> {
        self.places.query(descriptors).into_iter().map(|(id, _)| id).collect()
    }

    /// Notes the pose (world to camera) of a frame relative to a keyframe.
    pub(crate) fn log_pose(&mut self, stamp: Stamp, reference: KeyframeId, T_camera_world: &Pose) {
        self.trajectory.push(&self.map, stamp, reference, T_camera_world);
    }

    /// Adds a keyframe to the current segment, with its matches and new points.
    pub(crate) fn insert(&mut self, keyframe: Keyframe, matches: &[Match]) -> KeyframeId {
        let id = local_mapping::insert_keyframe(&mut self.map, &self.camera, &self.config, keyframe, matches);
        if let Some(keyframe) = self.map.keyframe(id) {
            self.places.insert(id, keyframe.features.descriptors());
        }
        self.order.push(id);
        self.segments.add(id);
        id
    }

    /// From now on keyframes belong to a new segment.
    pub(crate) fn begin_segment(&mut self) {
        self.segments.begin();
    }

    /// Whether the current segment has not been joined with that of the origin.
    pub(crate) fn is_apart(&self) -> bool {
        self.order.first().is_some_and(|&first| !self.segments.is_current(first))
    }

    /// Forgets the poses of all frames; the map stays.
    pub(crate) fn forget_trajectory(&mut self) {
        self.trajectory = TrajectoryLog::default();
    }

    /// From now on keyframes belong to the segment of `keyframe`.
    pub(crate) fn enter_segment_of(&mut self, keyframe: KeyframeId) {
        self.segments.enter(keyframe);
    }

    /// Corrects the measurements of keyframes that were made with another readout time.
    pub(crate) fn refresh_shutters(&mut self, readout: f64) {
        local_mapping::refresh_shutters(&mut self.map, &self.camera, readout);
    }

    /// Corrects the measurements of one keyframe.
    pub(crate) fn set_shutter(&mut self, keyframe: KeyframeId, shutter: Shutter) {
        local_mapping::set_shutter(&mut self.map, &self.camera, keyframe, shutter);
    }

    /// Drops points that proved wrong, and keyframes near `newest` that add nothing. The first one stays: it is the origin.
    pub(crate) fn cull(&mut self, newest: KeyframeId) {
        local_mapping::cull_points(&mut self.map, &self.config, &self.order);
        let first = self.order.first().copied();
        let candidates: Vec<_> = self.map.covisible(newest).into_iter().map(|(id, _)| id).collect();
        for id in local_mapping::redundant_keyframes(&self.map, &self.config, &candidates) {
            // Removing one makes others less redundant.
            let still = local_mapping::redundant_keyframes(&self.map, &self.config, &[id]).contains(&id);
            if Some(id) != first && still {
                self.remove(id);
            }
        }
    }

    fn remove(&mut self, id: KeyframeId) {
        let standin = self.map.covisible(id).first().map(|(other, _)| *other);
        let Some(standin) = standin else { return };
        self.trajectory.replace(&self.map, id, standin);
        if let Some(keyframe) = self.map.keyframe(id) {
            self.places.remove(id, keyframe.features.descriptors());
        }
        self.map.remove_keyframe(id);
        self.order.retain(|other| *other != id);
    }

    /// Corrects the map when `newest` shows a place that was seen long ago. Returns whether it did.
    pub(crate) fn close_loop(&mut self, newest: KeyframeId, rng: &mut Pcg32) -> bool {
        if !self.config.places.loop_closing {
            return false;
        }
        let search = loop_closing::Search { places: &self.places, order: &self.order, segments: &self.segments };
        let localizer = Localizer::new(&self.camera, &self.config, &self.map);
        let Some(found) = loop_closing::detect(&localizer, &search, newest, rng) else { return false };
        if self.segments.are_joined(found.current, found.earlier) {
            let segment = self.segments.with(&self.order, newest);
            loop_closing::close(&mut self.map, &self.camera, &self.config, &segment, &found);
        } else {
            let (part, whole) = self.segments.part_and_whole(self.order.first(), (found.current, found.earlier));
            let segment = self.segments.with(&self.order, part);
            loop_closing::merge(&mut self.map, &self.camera, &self.config, &segment, &found);
            self.segments.join(part, whole);
        }
        true
    }

    /// Starts to adjust the map around a keyframe; the result is due `delay_frames` after frame `frame_index`.
    pub(crate) fn start_adjustment(&mut self, center: KeyframeId, frame_index: usize) {
        let config = self.config.bundle_adjustment.clone();
        if !config.enabled || self.map.keyframe_count() < 2 {
            return;
        }
        let problem = BundleProblem::local(&self.map, &self.camera, center, &config);
        let due_frame = frame_index + config.delay_frames;
        self.adjustment = PendingAdjustment::start(problem, config, due_frame);
    }

    /// See [`crate::Tracker::set_waiting`].
    pub(crate) fn set_waiting(&mut self, waits: bool) {
        self.waits = waits;
    }

    pub(crate) fn waits(&self) -> bool {
        self.waits
    }

    /// Takes over the adjustment if it is due at frame `frame_index`: at the same frame in every run, unless it is late and nobody
    /// waits. Returns how `reference` moved.
    pub(crate) fn take_over_due(&mut self, frame_index: usize, reference: Option<KeyframeId>) -> Option<Pose> {
        self.adjustment.as_ref().filter(|pending| pending.is_due(frame_index) && (self.waits || pending.is_done()))?;
        self.take_over(reference)
    }

    /// Whether a keyframe would have to wait for the adjustment under way.
    pub(crate) fn is_busy(&self) -> bool {
        !self.waits && self.adjustment.as_ref().is_some_and(|pending| !pending.is_done())
    }

    /// Waits for the adjustment under way and writes it into the map. Returns how `reference` moved: `T_before_after`.
    pub(crate) fn take_over(&mut self, reference: Option<KeyframeId>) -> Option<Pose> {
        let result = self.adjustment.take().and_then(PendingAdjustment::wait)?;
        let pose_of = |map: &Map| reference.and_then(|id| map.keyframe(id)).map(|k| k.T_camera_world);
        let before = pose_of(&self.map);
        bundle_adjustment::apply(&mut self.map, &result);
        // Their measurements may have been corrected while the solver was at work.
        for (keyframe, _) in &result.poses {
            local_mapping::place_single_views(&mut self.map, &self.camera, *keyframe);
        }
        Some(before?.inverse() * pose_of(&self.map)?)
    }

    /// Forgets everything but camera, configuration and seed. Nobody waits for a solver that is still at work.
    pub(crate) fn clear(&mut self) {
        *self = Self { waits: self.waits, ..Self::new(self.camera, self.config.clone(), self.seed) };
    }

    /// A copy of the largest segment.
    pub(crate) fn snapshot(&self) -> MapSnapshot {
        let order = self.segments.largest(&self.order);
        let mut map = self.map.clone();
        self.order.iter().filter(|id| !order.contains(id)).for_each(|id| map.remove_keyframe(*id));
        MapSnapshot { map, order, maker: Maker::new(&self.camera, &self.config) }
    }

    /// Fills an empty mapper with the map of a file.
    ///
    /// # Errors
    /// When the file is no map of this camera, or made with other features.
    pub(crate) fn load(&mut self, path: &Path) -> Result<(), MapFileError> {
        let (map, order) = map_file::load(path, &self.camera, &self.config)?;
        for (id, keyframe) in order.iter().filter_map(|id| Some((*id, map.keyframe(*id)?))) {
            self.places.insert(id, keyframe.features.descriptors());
        }
        (self.map, self.order) = (map, order);
        Ok(())
    }

    /// Poses (camera to world) of the last `count` logged frames by the present state of the map.
    pub(crate) fn recent_trajectory(&self, count: usize) -> Vec<StampedPose> {
        self.trajectory.recent(&self.map, count)
    }

    /// Poses (camera to world) of all logged frames in the largest segment.
    pub(crate) fn trajectory(&self) -> Vec<StampedPose> {
        let segment = self.segments.largest(&self.order).into_iter().collect();
        self.trajectory.near(&self.map, &segment)
    }

    /// Poses (camera to world) of the keyframes of the largest segment, oldest first.
    pub(crate) fn keyframe_trajectory(&self) -> Vec<StampedPose> {
        self.poses_of(&self.segments.largest(&self.order))
    }

    /// Poses (camera to world) of all keyframes, oldest first.
    pub(crate) fn keyframe_poses(&self) -> Vec<StampedPose> {
        self.poses_of(&self.order)
    }

    fn poses_of(&self, keyframes: &[KeyframeId]) -> Vec<StampedPose> {
        let pose = |id: &KeyframeId| {
            self.map.keyframe(*id).map(|k| StampedPose { stamp: k.stamp, pose: k.T_camera_world.inverse() })
        };
        keyframes.iter().filter_map(pose).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle_adjustment::BundleResult;
    use pfd_geometry::Distortion;
    use pfd_optimization::{Summary, Termination};
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Arc, mpsc};

    fn mapper(waits: bool) -> Mapper {
        let camera = Camera::new((640, 480), [520.0, 520.0, 320.0, 240.0], Distortion::default()).unwrap();
        let mut mapper = Mapper::new(camera, TrackingConfig::default(), 0);
        mapper.set_waiting(waits);
        mapper
    }

    /// An adjustment due at frame 3 that is done when the sender is dropped, and says so.
    fn slow_adjustment() -> (mpsc::Sender<()>, Arc<AtomicBool>, PendingAdjustment) {
        let (finish, finished) = mpsc::channel::<()>();
        let done = Arc::new(AtomicBool::new(false));
        let says_so = Arc::clone(&done);
        let worker = std::thread::spawn(move || {
            let _ = finished.recv();
            says_so.store(true, Ordering::SeqCst);
            let (iterations, termination) = (0, Termination::Converged);
            let summary = Summary { initial_cost: 0.0, final_cost: 0.0, iterations, termination };
            BundleResult { poses: Vec::new(), points: Vec::new(), outliers: Vec::new(), summary }
        });
        (finish, done, PendingAdjustment::of(worker, 3))
    }

    #[test]
    fn a_late_adjustment_holds_nobody_up_who_does_not_wait() {
        let (finish, _, adjustment) = slow_adjustment();
        let mut mapper = mapper(false);
        mapper.adjustment = Some(adjustment);
        assert!(mapper.is_busy());
        mapper.take_over_due(3, None);
        assert!(mapper.adjustment.is_some(), "taken over although it is not done");
        drop(finish);
        while mapper.is_busy() {
            std::thread::yield_now();
        }
        mapper.take_over_due(2, None);
        assert!(mapper.adjustment.is_some(), "taken over before it was due");
        mapper.take_over_due(5, None);
        assert!(mapper.adjustment.is_none());
    }

    #[test]
    fn clearing_neither_waits_nor_changes_who_waits() {
        let (finish, _, adjustment) = slow_adjustment();
        let mut mapper = mapper(false);
        mapper.adjustment = Some(adjustment);
        mapper.clear();
        assert!(mapper.adjustment.is_none() && !mapper.waits());
        drop(finish);
    }

    #[test]
    fn who_waits_takes_an_adjustment_over_at_the_frame_for_which_it_is_due() {
        let (finish, done, adjustment) = slow_adjustment();
        let mut mapper = mapper(true);
        mapper.adjustment = Some(adjustment);
        assert!(!mapper.is_busy());
        let late = std::thread::spawn(move || drop(finish));
        mapper.take_over_due(3, None);
        assert!(mapper.adjustment.is_none() && done.load(Ordering::SeqCst), "not waited for");
        late.join().unwrap();
    }
}
