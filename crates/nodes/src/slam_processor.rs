//! The work of `tracking_node` and `slam_node` for one frame.

use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use pfd_geometry::{Camera, Mask, Stamp};
use pfd_parameters::NodeConfig;
use pfd_pipeline::SlamConfig;
use pfd_ros::Throttle;
use pfd_ros::diagnostics::Level;
use pfd_segmentation::Mode;
use pfd_tracking::TrackingState;

use crate::core::{Core, Kind, Outcome};
use crate::mask_input::MaskInput;
use crate::outlet::Outlet;
use crate::recorder::{FrameRecord, Recorder};
use crate::segmentation::{self, MaskOutput};
use crate::settings::LiveSettings;
use crate::slam::Shared;
use crate::tracking_output::{FrameNames, TrackingOutput};
use crate::worker::{Frame, Health, Processor};

/// Time between two messages of the map, path and keyframes: they are large.
const MAP_PERIOD: Duration = Duration::from_secs(1);

/// Works on frames.
pub struct SlamProcessor {
    kind: Kind,
    settings: LiveSettings,
    shared: Arc<Shared>,
    masks: Arc<MaskInput>,
    tracks: Arc<Outlet<TrackingOutput>>,
    mask_output: Arc<Outlet<MaskOutput>>,
    recorder: Recorder,
    health: Health,
    names: FrameNames,
    camera: Option<Camera>,
    last_stamp: Option<Stamp>,
    last_map: Option<Instant>,
    missing_masks: u64,
    complaints: Throttle,
}

impl SlamProcessor {
    /// A processor that has not seen a camera yet.
    pub fn new(
        kind: Kind,
        settings: LiveSettings,
        shared: Arc<Shared>,
        masks: Arc<MaskInput>,
        outputs: (Arc<Outlet<TrackingOutput>>, Arc<Outlet<MaskOutput>>),
        recorder: Recorder,
        health: Health,
    ) -> Self {
        let (tracks, mask_output) = outputs;
        Self {
            kind,
            settings,
            shared,
            masks,
            tracks,
            mask_output,
            recorder,
            health,
            names: FrameNames::default(),
            camera: None,
            last_stamp: None,
            last_map: None,
            missing_masks: 0,
            complaints: Throttle::default(),
        }
    }

    /// Makes the algorithms anew when the camera changed, and starts afresh when time was set back.
    fn prepare(&mut self, frame: &Frame, slam: &SlamConfig) -> anyhow::Result<()> {
        let stamp = frame.images.stamp();
        let mut core = self.shared.core();
        if core.is_none() || self.camera != Some(frame.camera) {
            if core.is_some() {
                tracing::warn!("the camera's size or calibration changed: starting a new map");
            }
            *core = Some(Core::new(self.kind, frame.camera, slam)?);
            self.camera = Some(frame.camera);
        }
        if self.last_stamp.replace(stamp).is_some_and(|last| is_set_back(last, stamp)) {
            tracing::warn!("time was set back to {stamp}: starting a new map");
            core.as_mut().into_iter().for_each(Core::reset);
            self.names = FrameNames::default();
            self.masks.restart();
        }
        Ok(())
    }

    /// The mask from the other node; without masks tracking goes on and says so.
    fn mask(&mut self, stamp: Stamp, config: &NodeConfig, mode: Mode) -> Option<Mask> {
        if self.kind == Kind::Composed || mode == Mode::None {
            return None;
        }
        let mask = self.masks.take(stamp, Duration::from_secs_f64(config.mask_timeout));
        if mask.is_none() {
            self.missing_masks += 1;
            if let Some(more) = self.complaints.pass() {
                let why = if self.masks.is_published() {
                    "it came too late (mask_timeout)"
                } else {
                    "nobody publishes masks"
                };
                tracing::warn!("frame {stamp} is tracked without a mask: {why} ({more} more like it)");
            }
        }
        mask
    }

    fn publish(&mut self, frame: &Frame, outcome: &Outcome, mask: Option<&Mask>, config: &NodeConfig) {
        if let (Some(output), Some(segmentation)) = (self.mask_output.get(), &outcome.segmentation) {
            output.publish(frame, segmentation);
        }
        let Some(output) = self.tracks.get() else { return };
        {
            let transforms = self.shared.transforms.lock().unwrap_or_else(PoisonError::into_inner);
            self.names.update(&transforms, &frame.frame_id, config);
        }
        output.publish_pose(&mut self.names, outcome, config);
        output.publish_state(&frame.frame_id, outcome, mask);
        if self.last_map.is_none_or(|last| last.elapsed() >= MAP_PERIOD) {
            self.last_map = Some(Instant::now());
            self.publish_map(&output, outcome.tracked.stamp, config);
        }
    }

    fn publish_map(&self, output: &TrackingOutput, stamp: Stamp, config: &NodeConfig) {
        if let (Some(core), Some(camera)) = (self.shared.core().as_ref(), &self.camera) {
            output.publish_map(&self.names, core.tracker(), camera, stamp, config);
        }
    }

    fn record(&mut self, outcome: &Outcome, mask: Option<&Mask>) -> anyhow::Result<()> {
        let t = &outcome.tracked;
        if let Some(mask) = mask {
            self.recorder.add_mask(t.stamp, mask)?;
        }
        self.recorder.add(&FrameRecord {
            stamp: t.stamp,
            state: t.state.to_string(),
            segmentation_ms: outcome.segmentation_ms,
            tracking_ms: outcome.tracking_ms,
            features: t.features,
            inliers: t.inliers,
            mask_fraction: mask.map_or(0.0, Mask::fraction),
            objects: outcome.segmentation.as_ref().map_or(0, |s| s.regions.len()),
        })
    }

    fn report(&self, outcome: &Outcome, mask: Option<&Mask>) {
        let t = &outcome.tracked;
        let (mut level, mut message) = match t.state {
            TrackingState::Ok | TrackingState::Relocalized => (Level::Ok, format!("{}", t.state)),
            TrackingState::NotInitialized => (Level::Warn, "waiting for a frame with enough features and depth".into()),
            TrackingState::Lost => (Level::Error, "LOST: move the camera back to a place that it has seen".into()),
        };
        if mask.is_none() && self.kind == Kind::Tracking && level == Level::Ok {
            (level, message) = (Level::Warn, format!("{}, without masks", t.state));
        }
        let mut values = vec![
            ("features", t.features.to_string()),
            ("inliers", t.inliers.to_string()),
            ("keyframes", t.keyframes.to_string()),
            ("map points", t.map_points.to_string()),
            ("frames without a mask", self.missing_masks.to_string()),
        ];
        values.extend(t.timing.0.iter().map(|(stage, ms)| (*stage, format!("{ms:.2} ms"))));
        values.extend(outcome.segmentation.iter().flat_map(segmentation::figures));
        self.health.report(level, message, values);
    }
}

/// A step back by more than this (seconds) is no reordering: a new recording, a bag that loops.
const SET_BACK: f64 = 1.0;

fn is_set_back(last: Stamp, now: Stamp) -> bool {
    last.seconds_since(now) > SET_BACK
}

impl Processor for SlamProcessor {
    fn process(&mut self, frame: &Frame) -> anyhow::Result<()> {
        if self.shared.paused.load(Ordering::Relaxed) {
            self.health.report(Level::Warn, "paused".into(), Vec::new());
            return Ok(());
        }
        let settings = self.settings.get();
        self.prepare(frame, &settings.slam)?;
        let received = self.mask(frame.images.stamp(), &settings.node, settings.slam.mode);
        let result = {
            let mut core = self.shared.core();
            let core = core.as_mut().ok_or_else(|| anyhow::anyhow!("there is no tracker"))?;
            core.process(&frame.images, received.as_ref())
        };
        if result.is_err()
            && let Some(output) = self.tracks.get()
        {
            output.publish_failure(&frame.frame_id, frame.images.stamp());
        }
        let outcome = result?;
        let mask = received.as_ref().or(outcome.segmentation.as_ref().map(|s| &s.mask));
        self.publish(frame, &outcome, mask, &settings.node);
        self.report(&outcome, mask);
        self.record(&outcome, mask)
    }

    fn finish(&mut self) -> anyhow::Result<()> {
        self.shared.core().as_mut().into_iter().for_each(Core::finish);
        let config = self.settings.get().node;
        if let (Some(output), Some(stamp)) = (self.tracks.get(), self.last_stamp) {
            self.publish_map(&output, stamp, &config);
        }
        self.recorder.finish()
    }
}
