//! The work of `tracking_node` and `slam_node` for one frame.

use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use crossbeam_channel::Receiver;
use pfd_geometry::{Camera, Mask, Stamp};
use pfd_parameters::{NodeConfig, Queue};
use pfd_pipeline::SlamConfig;
use pfd_ros::Throttle;
use pfd_ros::diagnostics::Level;
use pfd_segmentation::{Mode, Segmentation};
use pfd_tracking::{TrackedFrame, Tracker, TrackingState};

use crate::camera_input::{CameraInput, RawFrame};
use crate::mask_box::Taken;
use crate::mask_input::MaskInput;
use crate::outlet::Outlet;
use crate::recorder::{FrameRecord, Recorder};
use crate::settings::{LiveSettings, Settings, is_set_back};
use crate::slam::{Kind, Shared};
use crate::tracking_output::{FrameNames, TrackingOutput};
use crate::worker::{Frame, Health, Job, Processor};

/// Time between two messages of the map, path and keyframes: they are large.
const MAP_PERIOD: Duration = Duration::from_secs(1);

/// A frame on its way to tracking.
pub struct TrackingJob {
    /// Stamp of the colour image.
    pub stamp: Stamp,
    /// Frame of the colour image.
    pub frame_id: String,
    /// When it arrived.
    pub received: Instant,
    /// The images, or why there are none.
    pub frame: anyhow::Result<Arc<Frame>>,
    /// Where to ask for what moves in them, if that is found in this process.
    pub segmented: Option<Receiver<anyhow::Result<Segmented>>>,
}

impl TrackingJob {
    /// A frame whose mask comes from another node.
    pub fn from_messages(raw: &RawFrame) -> Self {
        let frame = Frame::decode(raw).map(Arc::new).map_err(anyhow::Error::from);
        Self::new(raw, frame, None)
    }

    /// A frame that was decoded, or could not be.
    pub fn new(
        raw: &RawFrame,
        frame: anyhow::Result<Arc<Frame>>,
        segmented: Option<Receiver<anyhow::Result<Segmented>>>,
    ) -> Self {
        let (stamp, frame_id, received) = (raw.stamp(), raw.frame_id().to_owned(), raw.received);
        Self { stamp, frame_id, received, frame, segmented }
    }
}

impl Job for TrackingJob {
    fn stamp(&self) -> Stamp {
        self.stamp
    }
}

/// What moves in a frame.
#[derive(Clone, Debug)]
pub struct Segmented {
    /// Mask and regions.
    pub segmentation: Segmentation,
    /// Wall-clock time that it took.
    pub milliseconds: f64,
}

/// The outcome for a frame.
pub struct Outcome {
    /// What moves, where it was found here.
    pub segmented: Option<Segmented>,
    /// Where the camera is.
    pub tracked: TrackedFrame,
    /// Wall-clock time of tracking, ms.
    pub tracking_ms: f64,
}

impl Outcome {
    /// Wall-clock time of segmentation, ms; 0 where it was done elsewhere.
    pub fn segmentation_ms(&self) -> f64 {
        self.segmented.as_ref().map_or(0.0, |s| s.milliseconds)
    }
}

/// What the work shares with the rest of the node.
pub struct Parts {
    /// Tracker and switches.
    pub shared: Arc<Shared>,
    /// Where frames wait.
    pub input: Arc<CameraInput>,
    /// Masks of another node.
    pub masks: Arc<MaskInput>,
    /// Publishers.
    pub tracks: Arc<Outlet<TrackingOutput>>,
    /// For diagnostics.
    pub health: Health,
}

/// Tracks frames.
pub struct SlamProcessor {
    kind: Kind,
    settings: LiveSettings,
    parts: Parts,
    recorder: Recorder,
    names: FrameNames,
    camera: Option<Camera>,
    last_stamp: Option<Stamp>,
    last_map: Option<Instant>,
    missing_masks: u64,
    passed_over: u64,
    complaints: Throttle,
}

/// What to do about the mask of another node.
enum Received {
    /// Track the frame, with a mask if there is one.
    Track(Option<Mask>),
    /// Leave the frame out.
    PassOver,
}

impl SlamProcessor {
    /// A processor that has not seen a camera yet.
    pub fn new(kind: Kind, settings: LiveSettings, parts: Parts, recorder: Recorder) -> Self {
        Self {
            kind,
            settings,
            parts,
            recorder,
            names: FrameNames::default(),
            camera: None,
            last_stamp: None,
            last_map: None,
            missing_masks: 0,
            passed_over: 0,
            complaints: Throttle::default(),
        }
    }

    /// Makes the tracker anew when the camera changed, and starts afresh when time was set back.
    fn prepare(&mut self, frame: &Frame, slam: &SlamConfig, queue: Queue) -> anyhow::Result<()> {
        let stamp = frame.images.stamp();
        let mut tracker = self.parts.shared.tracker();
        if tracker.is_none() || self.camera != Some(frame.camera) {
            let mut new = Tracker::new(frame.camera, &slam.tracking, slam.seed)?;
            if let Some(old) = tracker.as_ref() {
                tracing::warn!("the camera's size or calibration changed: starting a new map");
                new = new.continuing(old);
            }
            // A live camera does not wait; a recording is to give the same in every run.
            new.set_waiting(queue == Queue::All);
            self.camera = Some(frame.camera);
            load_wanted_map(&self.parts.shared, tracker.insert(new))?;
        }
        if self.last_stamp.replace(stamp).is_some_and(|last| is_set_back(last, stamp)) {
            tracing::warn!("time was set back to {stamp}: starting anew");
            self.names = self.names.restarted();
            self.parts.masks.restart(stamp);
            if let Some(tracker) = tracker.as_mut() {
                start_afresh(&self.parts.shared, tracker)?;
            }
        }
        Ok(())
    }

    /// Detects the corners of a frame whose mask is still being made. Returns how long that took, ms.
    fn detect_corners(&self, frame: &Frame) -> anyhow::Result<f64> {
        let start = Instant::now();
        self.parts.shared.tracker().as_mut().context("there is no tracker")?.detect_corners(&frame.images)?;
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }

    /// Tracks a frame and publishes its pose as soon as it is known: what the map takes in can wait.
    fn track(
        &mut self,
        frame: &Frame,
        mask: Option<&Mask>,
        config: &NodeConfig,
    ) -> anyhow::Result<(TrackedFrame, f64)> {
        let shared = self.parts.shared.clone();
        let mut tracker = shared.tracker();
        let tracker = tracker.as_mut().context("there is no tracker")?;
        let start = Instant::now();
        let located = tracker.locate(&frame.images, mask).context("tracking")?;
        let locating = start.elapsed();
        self.publish_pose(&frame.frame_id, &located.tracked, config);
        let start = Instant::now();
        let tracked = tracker.extend_map(located);
        Ok((tracked, (locating + start.elapsed()).as_secs_f64() * 1e3))
    }

    fn work(&mut self, job: TrackingJob) -> anyhow::Result<()> {
        let frame = &*job.frame?;
        let settings = self.settings.get();
        self.prepare(frame, &settings.slam, settings.node.queue)?;
        let detection_ms = if self.is_to_wait(job.stamp, &settings) { self.detect_corners(frame)? } else { 0.0 };
        let segmented = job.segmented.map(|made| made.recv().context("segmentation has ended")?).transpose()?;
        let size = frame.images.rgb().size();
        let Received::Track(received) = self.mask((job.stamp, size), job.received, &settings) else { return Ok(()) };
        let made_here = segmented.as_ref().map(|s| &s.segmentation.mask);
        let (tracked, tracking_ms) = self.track(frame, received.as_ref().or(made_here), &settings.node)?;
        let outcome = Outcome { segmented, tracked, tracking_ms: detection_ms + tracking_ms };
        let made_here = outcome.segmented.as_ref().map(|s| &s.segmentation.mask);
        let mask = received.as_ref().or(made_here);
        let looked_for = mask.filter(|_| settings.slam.mode != Mode::None);
        self.publish(frame, &outcome, looked_for, &settings.node);
        self.report(&outcome, mask);
        self.record(&outcome, mask);
        Ok(())
    }

    /// Whether the mask of a frame is still being made, as far as is known.
    fn is_to_wait(&self, stamp: Stamp, settings: &Settings) -> bool {
        match self.kind {
            Kind::Composed => true,
            Kind::Tracking => {
                let masks = &self.parts.masks;
                settings.slam.mode != Mode::None
                    && masks.are_expected()
                    && masks.newest().is_none_or(|newest| newest < stamp)
            }
        }
    }

    /// The mask from the other node, for a frame that arrived at `received`. A live camera's frame that segmentation passed over is
    /// passed over here as well: so both work on the same frames, and what moves stays out of the map.
    fn mask(&mut self, (stamp, size): (Stamp, (usize, usize)), received: Instant, settings: &Settings) -> Received {
        if self.kind == Kind::Composed {
            return Received::Track(None);
        }
        let is_live = settings.node.queue == Queue::Newest;
        let timeout = Duration::from_secs_f64(settings.node.mask_timeout);
        let wants_masks = settings.slam.mode != Mode::None;
        let taken = wants_masks.then(|| self.parts.masks.take(stamp, received, timeout));
        match taken {
            Some(Taken::Closed) => Received::PassOver,
            Some(Taken::PassedOver) if is_live => self.pass_over(),
            _ if is_live && self.is_behind(timeout, wants_masks) => self.pass_over(),
            Some(Taken::Mask(mask)) => match check_size(&mask, size) {
                Ok(()) => Received::Track(Some(mask)),
                Err(why) => {
                    self.complain_about_mask(stamp, &why);
                    Received::Track(None)
                }
            },
            Some(Taken::PassedOver | Taken::Missing) => {
                let is_late = self.parts.masks.is_published();
                let why = if is_late { "it came too late (mask_timeout)" } else { "nobody publishes masks" };
                self.complain_about_mask(stamp, why);
                Received::Track(None)
            }
            // Nothing is looked for, which is another thing than a mask that is missing.
            None => Received::Track(Some(Mask::empty(size.0, size.1))),
        }
    }

    fn pass_over(&mut self) -> Received {
        self.passed_over += 1;
        Received::PassOver
    }

    /// Whether more frames wait for tracking than it may lag behind. A frame whose mask is still being made waits for that.
    fn is_behind(&self, timeout: Duration, wants_masks: bool) -> bool {
        /// A bundle adjustment or a keyframe may hold tracking up for so many frames.
        const MAX_BEHIND: usize = 4;
        let masks = &self.parts.masks;
        let (are_expected, newest) = (wants_masks && masks.are_expected(), masks.newest());
        let waits_for_mask =
            |raw: &RawFrame| newest.is_none_or(|n| raw.stamp() > n) && raw.received.elapsed() < timeout;
        self.parts.input.slot.count(|raw| !(are_expected && waits_for_mask(raw))) >= MAX_BEHIND
    }

    /// Without a mask tracking goes on and says so.
    fn complain_about_mask(&mut self, stamp: Stamp, why: &str) {
        self.missing_masks += 1;
        let Some(more) = self.complaints.pass() else { return };
        tracing::warn!("frame {stamp} is tracked without a mask: {why} ({more} more like it)");
    }

    fn publish_pose(&mut self, camera_frame: &str, tracked: &TrackedFrame, config: &NodeConfig) {
        let Some(output) = self.parts.tracks.get() else { return };
        {
            let transforms = self.parts.shared.transforms.lock().unwrap_or_else(PoisonError::into_inner);
            self.names.update(&transforms, camera_frame, config, Instant::now());
        }
        output.publish_pose(&mut self.names, tracked, config);
    }

    fn publish(&mut self, frame: &Frame, outcome: &Outcome, mask: Option<&Mask>, config: &NodeConfig) {
        let Some(output) = self.parts.tracks.get() else { return };
        output.publish_state(&frame.frame_id, outcome, mask);
        if self.last_map.is_none_or(|last| last.elapsed() >= MAP_PERIOD) {
            self.last_map = Some(Instant::now());
            self.publish_map(&output, outcome.tracked.stamp, config);
        }
    }

    fn publish_map(&self, output: &TrackingOutput, stamp: Stamp, config: &NodeConfig) {
        if let (Some(tracker), Some(camera)) = (self.parts.shared.tracker().as_ref(), &self.camera) {
            output.publish_map(&self.names, tracker, camera, stamp, config);
        }
    }

    fn record(&mut self, outcome: &Outcome, mask: Option<&Mask>) {
        let t = &outcome.tracked;
        let record = FrameRecord {
            stamp: t.stamp,
            state: t.state.to_string(),
            segmentation_ms: outcome.segmentation_ms(),
            tracking_ms: outcome.tracking_ms,
            features: t.features,
            inliers: t.inliers,
            mask_fraction: mask.map_or(0.0, Mask::fraction),
            objects: outcome.segmented.as_ref().map_or(0, |s| s.segmentation.regions.len()),
        };
        self.recorder.record(&record, mask);
    }

    fn report(&self, outcome: &Outcome, mask: Option<&Mask>) {
        let t = &outcome.tracked;
        let (mut level, mut message) = match t.state {
            TrackingState::Ok | TrackingState::Relocalized => (Level::Ok, format!("{}", t.state)),
            TrackingState::NotInitialized => (Level::Warn, "waiting for a frame with enough features and depth".into()),
            TrackingState::Lost => (Level::Error, "LOST: move the camera back to a place that it has seen".into()),
        };
        if t.is_apart && level == Level::Ok {
            let apart =
                "in a new part of the map, whose place with respect to the rest is a guess until the camera shows both";
            (level, message) = (Level::Warn, format!("{}, {apart}", t.state));
        }
        let wants_masks = self.kind == Kind::Tracking && self.settings.get().slam.mode != Mode::None;
        if mask.is_none() && wants_masks && level == Level::Ok {
            (level, message) = (Level::Warn, format!("{}, without masks", t.state));
        }
        let mut values = vec![
            ("features", t.features.to_string()),
            ("inliers", t.inliers.to_string()),
            ("keyframes", t.keyframes.to_string()),
            ("map points", t.map_points.to_string()),
            ("frames without a mask", self.missing_masks.to_string()),
            ("frames passed over", self.passed_over.to_string()),
        ];
        values.extend(t.timing.0.iter().map(|(stage, ms)| (*stage, format!("{ms:.2} ms"))));
        self.parts.health.report(level, message, values);
    }
}

/// Loads the map that was asked for. One that cannot be loaded is not asked for again.
fn load_wanted_map(shared: &Shared, tracker: &mut Tracker) -> anyhow::Result<()> {
    let Some(path) = shared.wanted_map() else { return Ok(()) };
    if let Err(error) = tracker.load_map(&path) {
        shared.want_map(None);
        return Err(error).with_context(|| format!("~/load_map {}", path.display()));
    }
    tracing::info!("map {} loaded", path.display());
    Ok(())
}

/// Forgets what was seen, but not that the camera is to be looked for in a map that was loaded.
fn start_afresh(shared: &Shared, tracker: &mut Tracker) -> anyhow::Result<()> {
    tracker.reset();
    if tracker.map().keyframe_count() > 0 { Ok(()) } else { load_wanted_map(shared, tracker) }
}

/// Whether a mask is one of an image of this size, or what is wrong with it.
fn check_size(mask: &Mask, (width, height): (usize, usize)) -> Result<(), String> {
    match mask.image().size() {
        size if size == (width, height) => Ok(()),
        (w, h) => Err(format!("the one on dynamic_mask has {w}x{h} pixels, the image {width}x{height}")),
    }
}

impl Processor for SlamProcessor {
    type Job = TrackingJob;

    fn process(&mut self, job: TrackingJob) -> anyhow::Result<()> {
        if self.parts.shared.paused.load(Ordering::Relaxed) {
            self.parts.health.report(Level::Warn, "paused".into(), Vec::new());
            return Ok(());
        }
        let (stamp, frame_id) = (job.stamp, job.frame_id.clone());
        let result = self.work(job);
        if result.is_err()
            && let Some(output) = self.parts.tracks.get()
        {
            output.publish_failure(&frame_id, stamp);
        }
        result
    }

    fn finish(&mut self) -> anyhow::Result<()> {
        self.parts.shared.tracker().as_mut().into_iter().for_each(Tracker::finish);
        let config = self.settings.get().node;
        if let (Some(output), Some(stamp)) = (self.parts.tracks.get(), self.last_stamp) {
            self.publish_map(&output, stamp, &config);
        }
        self.recorder.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_tracking::TrackingConfig;
    use std::path::Path;

    #[test]
    fn whoever_starts_afresh_is_looked_for_in_the_map_that_was_loaded() {
        let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/composite-demo");
        let sequence = pfd_dataset::Sequence::open(&bundled).unwrap();
        let mut tracker = Tracker::new(sequence.camera().unwrap(), &TrackingConfig::default(), 0).unwrap();
        tracker.track(&sequence.frame(0).unwrap(), None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("room.map");
        tracker.snapshot().save(&map).unwrap();
        let shared = Shared::default();
        start_afresh(&shared, &mut tracker).unwrap();
        assert_eq!(tracker.map().keyframe_count(), 0, "no map was loaded");
        shared.want_map(Some(map));
        start_afresh(&shared, &mut tracker).unwrap();
        assert_eq!(tracker.map().keyframe_count(), 1);
    }

    #[test]
    fn a_mask_of_another_size_is_named() {
        assert_eq!(check_size(&Mask::empty(640, 480), (640, 480)), Ok(()));
        let why = check_size(&Mask::empty(320, 240), (640, 480)).unwrap_err();
        assert!(why.contains("320x240") && why.contains("640x480"), "{why}");
    }
}
