//! `tracking_node` and `slam_node`: camera (and masks) in, poses and map out.
//!
//! The two differ in where the mask comes from: another node, or the segmentation in the same process.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pfd_ros::convert::pose::pose_from_transform;
use pfd_ros::messages::geometry::TfMessage;
use pfd_ros::messages::pfd::{FilePath, FilePathRequest, FilePathResponse};
use pfd_ros::messages::standard::{Trigger, TriggerResponse};
use pfd_ros::{Arguments, Names, Node, Qos, RosError, Setup, StaticTransforms};
use tokio::sync::Notify;

use crate::camera_input::CameraInput;
use crate::core::{Core, Kind};
use crate::mask_input::MaskInput;
use crate::node_diagnostics;
use crate::outlet::Outlet;
use crate::recorder::{Recorder, save_trajectory};
use crate::segmentation::MaskOutput;
use crate::settings::{LiveSettings, Settings, is_changeable_in_slam};
use crate::slam_processor::SlamProcessor;
use crate::tracking_output::TrackingOutput;
use crate::worker::{Health, Worker};

/// What worker, services and callbacks share.
pub struct Shared {
    /// The algorithms; locked for one frame at a time.
    core: Mutex<Option<Core>>,
    /// Static transforms heard so far.
    pub transforms: Mutex<StaticTransforms>,
    /// Frames are ignored.
    pub paused: AtomicBool,
}

impl Shared {
    /// The algorithms. A panic in them ends the worker, and with it the node; there is nothing to protect.
    pub fn core(&self) -> MutexGuard<'_, Option<Core>> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Runs the node until it is told to stop.
///
/// # Errors
/// When parameters, network or files are at fault.
pub fn run(kind: Kind, args: &Arguments, names: Names) -> anyhow::Result<()> {
    let settings = Settings::read(args, &names)?;
    let config = settings.node.clone();
    let setup = Setup::new(args, names, &config.network, config.use_sim_time)?;
    let input = CameraInput::new(&config, settings.camera()?);
    let recorder = Recorder::new(&config.frames_file, &config.mask_directory)?;
    let live = LiveSettings::new(settings);
    let parameters = live.server(setup.clock.clone(), is_changeable_in_slam);
    let shared =
        Arc::new(Shared { core: Mutex::default(), transforms: Mutex::default(), paused: AtomicBool::new(false) });
    let health = Health::default();
    let masks = Arc::new(MaskInput::new(config.queue));
    let (tracks, mask_output) = (Arc::new(Outlet::default()), Arc::new(Outlet::default()));
    let processor = SlamProcessor::new(
        kind,
        live,
        shared.clone(),
        masks.clone(),
        (tracks.clone(), mask_output.clone()),
        recorder,
        health.clone(),
    );
    let worker = Worker::start("slam", input.clone(), health.clone(), setup.clock.clone(), processor)?;
    let result = pfd_ros::run(&setup, &Arc::new(Notify::new()), |node: &mut Node| {
        tracks.set(TrackingOutput::new(node)?);
        match kind {
            Kind::Tracking => masks.attach(node)?,
            Kind::Composed => mask_output.set(MaskOutput::new(node, &config)?),
        }
        parameters.attach(node)?;
        attach_services(node, &shared)?;
        attach_transforms(node, shared.clone())?;
        node_diagnostics::attach(node, "tracking", input.clone(), health.clone())?;
        input.attach(node)
    });
    masks.clear();
    let finished = worker.finish();
    tracks.clear();
    mask_output.clear();
    finished?;
    if !config.trajectory_file.is_empty() {
        save(&shared, &config.trajectory_file)?;
    }
    Ok(result?)
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
    node.serve::<Trigger>("~/reset", move |_| done(s.core().as_mut().map_or("there is no map yet", reset)))?;
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
    node.serve::<FilePath>("~/save_trajectory", move |r| answer(&r, |path| save(&s, path)))?;
    let s = shared.clone();
    node.serve::<FilePath>("~/save_map", move |r| {
        answer(&r, |path| with_core(&s, |core| Ok(core.tracker().save_map(Path::new(path))?)))
    })?;
    let s = shared.clone();
    node.serve::<FilePath>("~/load_map", move |r| {
        answer(&r, |path| with_core(&s, |core| Ok(core.tracker_mut().load_map(Path::new(path))?)))
    })
}

fn reset(core: &mut Core) -> &'static str {
    core.reset();
    "the map is empty again"
}

fn done(message: &str) -> TriggerResponse {
    TriggerResponse { success: true, message: message.to_owned() }
}

fn answer(request: &FilePathRequest, action: impl FnOnce(&str) -> anyhow::Result<()>) -> FilePathResponse {
    if request.path.is_empty() {
        return FilePathResponse { success: false, message: "the path is empty".into() };
    }
    match action(&request.path) {
        Ok(()) => FilePathResponse { success: true, message: request.path.clone() },
        Err(error) => FilePathResponse { success: false, message: format!("{error:#}") },
    }
}

fn with_core(shared: &Shared, action: impl FnOnce(&mut Core) -> anyhow::Result<()>) -> anyhow::Result<()> {
    action(shared.core().as_mut().ok_or_else(|| anyhow::anyhow!("no frame has been received yet"))?)
}

fn save(shared: &Shared, path: &str) -> anyhow::Result<()> {
    with_core(shared, |core| save_trajectory(Path::new(path), &core.tracker().trajectory()))
}
