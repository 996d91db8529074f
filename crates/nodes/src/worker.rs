//! The thread on which a node works.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use pfd_geometry::{Camera, RgbdFrame, Stamp};
use pfd_ros::diagnostics::{Level, status};
use pfd_ros::messages::diagnostic::DiagnosticStatus;
use pfd_ros::{Clock, Throttle};

use crate::camera_input::CameraInput;

/// A frame with what the outputs need to know about it.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The images.
    pub images: RgbdFrame,
    /// Frame of the colour image.
    pub frame_id: String,
    /// The camera that took it.
    pub camera: Camera,
}

/// What a node does with frames.
pub trait Processor: Send + 'static {
    /// Works on a frame.
    ///
    /// # Errors
    /// What went wrong; the next frame comes all the same.
    fn process(&mut self, frame: &Frame) -> anyhow::Result<()>;

    /// No more frames will come.
    ///
    /// # Errors
    /// What could not be written.
    fn finish(&mut self) -> anyhow::Result<()>;
}

/// How the work goes. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct Health {
    shared: Arc<Mutex<State>>,
}

#[derive(Clone, Debug, Default)]
struct State {
    frames: u64,
    errors: u64,
    last_error: Option<(Instant, String)>,
    latency: Option<f64>,
    duration_ms: f64,
    level: Option<(Level, String)>,
    values: Vec<(&'static str, String)>,
}

impl Health {
    /// Takes over what the node says about itself.
    pub fn report(&self, level: Level, message: String, values: Vec<(&'static str, String)>) {
        self.with(|s| {
            s.level = Some((level, message));
            s.values = values;
        });
    }

    /// The diagnostic status. An error is shown for as long as errors come.
    pub fn status(&self, name: String) -> DiagnosticStatus {
        /// An error older than this (seconds) is over.
        const ERROR_AGE: f64 = 2.0;
        let s = self.with(|s| s.clone());
        let (mut level, mut message) = s.level.unwrap_or((Level::Ok, "waiting for frames".into()));
        if let Some((_, error)) = s.last_error.filter(|(when, _)| when.elapsed().as_secs_f64() < ERROR_AGE) {
            (level, message) = (Level::Error, error);
        }
        let mut values = s.values;
        values.push(("frames", s.frames.to_string()));
        values.push(("errors", s.errors.to_string()));
        values.push(("stamp to result, ms", s.latency.map_or("-".into(), |l| format!("{:.1}", l * 1e3))));
        values.push(("processing, ms", format!("{:.1}", s.duration_ms)));
        status(level, name, message, values)
    }

    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        f(&mut self.shared.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn done(&self, start: Instant, stamp: Stamp, clock: &Clock, error: Option<&anyhow::Error>) {
        self.with(|s| {
            s.frames += 1;
            s.duration_ms = start.elapsed().as_secs_f64() * 1e3;
            s.latency = Some(clock.now().seconds_since(stamp));
            if let Some(error) = error {
                s.errors += 1;
                s.last_error = Some((Instant::now(), format!("{error:#}")));
            }
        });
    }
}

/// A running worker.
pub struct Worker {
    thread: JoinHandle<anyhow::Result<()>>,
    input: Arc<CameraInput>,
}

impl Worker {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system has no thread left.
    pub fn start(
        name: &str,
        input: Arc<CameraInput>,
        health: Health,
        clock: Clock,
        processor: impl Processor,
    ) -> anyhow::Result<Self> {
        let frames = input.clone();
        let body = move || work(&frames, &health, &clock, processor);
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(body)?;
        Ok(Self { thread, input })
    }

    /// Lets the worker finish what waits, and waits for it.
    ///
    /// # Errors
    /// What the processor could not finish, or that it crashed.
    pub fn finish(self) -> anyhow::Result<()> {
        self.input.slot.close();
        self.thread.join().map_err(|_| anyhow::anyhow!("the worker crashed"))?
    }
}

fn work(input: &CameraInput, health: &Health, clock: &Clock, mut processor: impl Processor) -> anyhow::Result<()> {
    let mut complaints = Throttle::default();
    while let Some(raw) = input.slot.take() {
        let start = Instant::now();
        let (stamp, frame_id, camera) = (raw.stamp(), raw.frame_id().to_owned(), raw.camera);
        let frame = raw.decode().map(|images| Frame { images, frame_id, camera });
        let result = frame.map_err(anyhow::Error::from).and_then(|frame| processor.process(&frame));
        if let Err(error) = &result
            && let Some(more) = complaints.pass()
        {
            tracing::error!("frame {stamp}: {error:#} ({more} more errors)");
        }
        health.done(start, stamp, clock, result.as_ref().err());
    }
    processor.finish()
}
