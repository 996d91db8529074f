//! `tracking_node` and `slam_node`: camera (and masks) in, poses and map out.
//!
//! The two differ in where the mask comes from: another node, or the segmentation in the same process.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::Context;
use crossbeam_channel::bounded;
use pfd_ros::convert::pose::pose_from_transform;
use pfd_ros::messages::geometry::TfMessage;
use pfd_ros::messages::pfd::{FilePath, FilePathRequest, FilePathResponse};
use pfd_ros::messages::standard::{Trigger, TriggerResponse};
use pfd_ros::{Arguments, Names, Node, Qos, RosError, StaticTransforms};
use pfd_tracking::{Tracker, map_file};

use crate::camera_input::frames;
use crate::first_stage::FirstStage;
use crate::mask_input::MaskInput;
use crate::node_diagnostics;
use crate::outlet::Outlet;
use crate::recorder::{named, save_trajectory};
use crate::segmentation::MaskOutput;
use crate::segmentation_stage::SegmentationStage;
use crate::settings::{is_changeable_in_slam, is_changeable_in_tracking};
use crate::slam_processor::{Parts, SlamProcessor, TrackingJob};
use crate::startup::{NEWEST, Startup};
use crate::tracking_output::TrackingOutput;
use crate::worker::{Health, Worker};

/// Which of the two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Masks come from another node.
    Tracking,
    /// Masks are made here.
    Composed,
}

impl Kind {
    fn is_changeable(self) -> fn(&str) -> bool {
        match self {
            Self::Tracking => is_changeable_in_tracking,
            Self::Composed => is_changeable_in_slam,
        }
    }

    /// How many frames of a live camera may wait. Tracking has those at hand whose masks are being made: a mask is of use only while its
    /// image is there. Those whose masks have come do not pile up, see [`SlamProcessor`].
    fn waiting(self) -> usize {
        /// At 30 Hz for half a second, at 60 Hz for a quarter.
        const BEHIND_MASKS: usize = 16;
        match self {
            Self::Tracking => BEHIND_MASKS,
            Self::Composed => NEWEST,
        }
    }
}

/// What workers, services and callbacks share.
#[derive(Default)]
pub struct Shared {
    /// The tracker, once the camera is known; locked for one frame at a time.
    tracker: Mutex<Option<Tracker>>,
    /// Static transforms heard so far.
    pub transforms: Mutex<StaticTransforms>,
    /// Frames are ignored.
    pub paused: AtomicBool,
    /// How often everything was to be forgotten.
    pub resets: AtomicU64,
    /// The map that was asked for: to be loaded with the first frame, and again where another camera needs another tracker.
    wanted_map: Mutex<Option<PathBuf>>,
}

impl Shared {
    /// The tracker. A panic in it ends the worker, and with it the node; there is nothing to protect.
    pub fn tracker(&self) -> MutexGuard<'_, Option<Tracker>> {
        self.tracker.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The map to load into a new tracker.
    pub fn wanted_map(&self) -> Option<PathBuf> {
        self.wanted_map.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Asks for a map, or for none any more.
    pub fn want_map(&self, path: Option<PathBuf>) {
        *self.wanted_map.lock().unwrap_or_else(PoisonError::into_inner) = path;
    }

    /// Loads a map now, or with the first frame if there was none yet. Returns what to say of it.
    fn load_map(&self, path: &Path) -> anyhow::Result<String> {
        // Held to the end: no tracker is made in between.
        let mut tracker = self.tracker();
        let said = if let Some(tracker) = tracker.as_mut() {
            tracker.load_map(path)?;
            path.display().to_string()
        } else {
            map_file::check(path)?;
            format!("{}: will be loaded with the first frame", path.display())
        };
        self.want_map(Some(path.to_owned()));
        Ok(said)
    }

    fn reset(&self) -> &'static str {
        self.resets.fetch_add(1, Ordering::Relaxed);
        let mut tracker = self.tracker();
        let Some(tracker) = tracker.as_mut() else { return "there is no map yet" };
        tracker.reset();
        if tracker.map().keyframe_count() > 0 {
            return "the camera is looked for in the map that was loaded";
        }
        self.want_map(None);
        "the map is empty again"
    }
}

/// The publishers of the present node.
#[derive(Clone, Default)]
pub struct Outlets {
    /// Poses and map.
    pub tracks: Arc<Outlet<TrackingOutput>>,
    /// Masks, where they are made here.
    pub masks: Arc<Outlet<MaskOutput>>,
}

/// Runs the node until it is told to stop.
///
/// # Errors
/// When parameters, network or files are at fault.
pub fn run(kind: Kind, args: &Arguments, names: Names) -> anyhow::Result<()> {
    let start = Startup::new(args, names, kind.is_changeable(), kind.waiting())?;
    let (shared, outlets) = (Arc::new(Shared::default()), Outlets::default());
    let masks = Arc::new(MaskInput::new(start.config.queue));
    if let Some(path) = named(&start.config.trajectory_file) {
        // Whether it can be written is said now and not in the end.
        save_trajectory(&path, &[]).context("trajectory_file")?;
    }
    let (workers, works) = start_workers(kind, &start, &shared, &masks, &outlets)?;
    let input = &start.input;
    let result = pfd_ros::run(&start.setup, &start.ended, |node: &mut Node| {
        outlets.tracks.set(TrackingOutput::new(node)?);
        match kind {
            Kind::Tracking => masks.attach(node)?,
            Kind::Composed => outlets.masks.set(MaskOutput::new(node, &start.config)?),
        }
        start.parameters.attach(node)?;
        attach_services(node, &shared)?;
        attach_transforms(node, shared.clone())?;
        node_diagnostics::attach(node, input.clone(), works.clone())?;
        input.attach(node)
    });
    masks.close();
    input.slot.close();
    // All of them, whatever became of the first.
    let finished: Vec<anyhow::Result<()>> = workers.into_iter().map(Worker::finish).collect();
    outlets.tracks.clear();
    outlets.masks.clear();
    // Before errors are returned: a mask that could not be written is no reason to lose the trajectory as well.
    if let (Some(path), Some(tracker)) = (named(&start.config.trajectory_file), shared.tracker().as_ref()) {
        save_trajectory(&path, &tracker.trajectory()).context("trajectory_file")?;
    }
    finished.into_iter().collect::<anyhow::Result<()>>()?;
    Ok(result?)
}

/// Threads, first stage first, and how each kind of work goes.
type Workers = (Vec<Worker>, Vec<(&'static str, Health)>);

/// Tracking on one thread; in the composed node segmentation on another one, so that a frame is segmented while the one before it is
/// tracked. Tracking has a frame from the time on at which segmentation begins with it: what needs no mask is done meanwhile.
fn start_workers(
    kind: Kind,
    start: &Startup,
    shared: &Arc<Shared>,
    masks: &Arc<MaskInput>,
    outlets: &Outlets,
) -> anyhow::Result<Workers> {
    let health = Health::default();
    let tools = start.tools(&health);
    let recorder = start.recorder()?;
    let parts = Parts {
        shared: shared.clone(),
        input: start.input.clone(),
        masks: masks.clone(),
        tracks: outlets.tracks.clone(),
        health: health.clone(),
    };
    let tracking = SlamProcessor::new(kind, start.settings.clone(), parts, recorder);
    let mut next = frames(&start.input);
    if kind == Kind::Tracking {
        let next = move || next().map(|raw| TrackingJob::from_messages(&raw));
        return Ok((vec![Worker::start("tracking", next, tools, tracking)?], vec![("tracking", health)]));
    }
    // One that is segmented waits while another is tracked and a third is segmented: what tracking cannot keep up with is dropped, and
    // counted, where frames come in.
    let (hand_over, segmented) = bounded(2);
    let segmentation_health = Health::default();
    let stage = SegmentationStage::new(start.settings.clone(), outlets.masks.clone(), segmentation_health.clone());
    let first = FirstStage::new(stage, shared.clone(), hand_over, health.clone());
    let workers = vec![
        Worker::start("segmentation", next, start.tools(&segmentation_health), first)?,
        Worker::start("tracking", move || segmented.recv().ok(), tools, tracking)?,
    ];
    Ok((workers, vec![("segmentation", segmentation_health), ("tracking", health)]))
}

/// Static transforms, of which the camera's way to the base is taken.
fn attach_transforms(node: &mut Node, shared: Arc<Shared>) -> Result<(), RosError> {
    node.subscribe::<TfMessage>("/tf_static", Qos::latched_from_many(), move |message| {
        let mut transforms = shared.transforms.lock().unwrap_or_else(PoisonError::into_inner);
        for t in &message.transforms {
            if let Some(pose) = pose_from_transform(&t.transform) {
                transforms.insert(&t.header.frame_id, &t.child_frame_id, pose);
            }
        }
    })?;
    Ok(())
}

fn attach_services(node: &mut Node, shared: &Arc<Shared>) -> Result<(), RosError> {
    let s = shared.clone();
    node.serve::<Trigger>("~/reset", move |_| done(s.reset()))?;
    let s = shared.clone();
    node.serve::<Trigger>("~/pause", move |_| {
        s.paused.store(true, Ordering::Relaxed);
        done("frames are ignored until ~/resume")
    })?;
    let s = shared.clone();
    node.serve::<Trigger>("~/resume", move |_| {
        s.paused.store(false, Ordering::Relaxed);
        done("working on frames")
    })?;
    let s = shared.clone();
    node.serve::<FilePath>("~/save_trajectory", move |r| {
        answer(&r, |path| {
            save_trajectory(Path::new(path), &ask(&s, Tracker::trajectory)?)?;
            Ok(path.to_owned())
        })
    })?;
    let s = shared.clone();
    node.serve::<FilePath>("~/save_map", move |r| {
        answer(&r, |path| {
            ask(&s, Tracker::snapshot)?.save(Path::new(path))?;
            Ok(path.to_owned())
        })
    })?;
    let s = shared.clone();
    node.serve::<FilePath>("~/load_map", move |r| answer(&r, |path| s.load_map(Path::new(path))))
}

fn done(message: &str) -> TriggerResponse {
    TriggerResponse { success: true, message: message.to_owned() }
}

/// Does something with the file that is named; `action` returns what to say of it.
fn answer(request: &FilePathRequest, action: impl FnOnce(&str) -> anyhow::Result<String>) -> FilePathResponse {
    if request.path.is_empty() {
        return FilePathResponse { success: false, message: "the path is empty".into() };
    }
    match action(&request.path) {
        Ok(message) => FilePathResponse { success: true, message },
        Err(error) => FilePathResponse { success: false, message: format!("{error:#}") },
    }
}

/// What the tracker says of itself. Frames wait meanwhile: files are written when it is done.
fn ask<T>(shared: &Shared, question: impl FnOnce(&Tracker) -> T) -> anyhow::Result<T> {
    shared.tracker().as_ref().map(question).ok_or_else(|| anyhow::anyhow!("no frame has been received yet"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_waits_for_the_camera_and_must_be_one() {
        let shared = Shared::default();
        assert!(shared.load_map(Path::new("/none.map")).unwrap_err().to_string().contains("/none.map"));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.map");
        std::fs::write(&path, "no map").unwrap();
        assert!(shared.load_map(&path).unwrap_err().to_string().contains("not a map"));
        assert_eq!(shared.wanted_map(), None);
        let camera =
            pfd_geometry::Camera::new((64, 48), [60.0, 60.0, 31.5, 23.5], pfd_geometry::Distortion::default()).unwrap();
        Tracker::new(camera, &pfd_tracking::TrackingConfig::default(), 0).unwrap().snapshot().save(&path).unwrap();
        assert!(shared.load_map(&path).unwrap().contains("first frame"));
        assert_eq!(shared.wanted_map().as_deref(), Some(path.as_path()));
        shared.want_map(None);
        assert_eq!(shared.wanted_map(), None);
    }
}
