//! The threads on which a node works.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use pfd_geometry::{Camera, RgbdFrame, Stamp};
use pfd_ros::diagnostics::{Level, status};
use pfd_ros::messages::diagnostic::DiagnosticStatus;
use pfd_ros::{Clock, Throttle};
use tokio::sync::Notify;

use crate::camera_input::{DecodeError, RawFrame};

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

impl Frame {
    /// The frame that a pair of messages makes.
    ///
    /// # Errors
    /// [`DecodeError`] that says which image is at fault.
    pub fn decode(raw: &RawFrame) -> Result<Self, DecodeError> {
        Ok(Self { images: raw.decode()?, frame_id: raw.frame_id().to_owned(), camera: raw.camera })
    }
}

/// Something to work on.
pub trait Job: Send + 'static {
    /// Stamp of the colour image.
    fn stamp(&self) -> Stamp;
}

impl Job for RawFrame {
    fn stamp(&self) -> Stamp {
        Self::stamp(self)
    }
}

/// What a thread does with its jobs.
pub trait Processor: Send + 'static {
    /// What it works on.
    type Job: Job;

    /// Works on one.
    ///
    /// # Errors
    /// What went wrong; the next one comes all the same.
    fn process(&mut self, job: Self::Job) -> anyhow::Result<()>;

    /// No more will come.
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
    /// When the last frame was done.
    last_done: Option<Instant>,
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

    /// The diagnostic status. An error is shown for as long as errors come, and what was said of the last frame as long as frames come.
    pub fn status(&self, name: String) -> DiagnosticStatus {
        /// An error older than this (seconds) is over.
        const ERROR_AGE: f64 = 2.0;
        /// A frame done longer ago than this (seconds) says nothing of the present.
        const FRAME_AGE: f64 = 1.0;
        let s = self.with(|s| s.clone());
        let (mut level, mut message) = s.level.unwrap_or((Level::Ok, "waiting for frames".into()));
        if let Some(age) = s.last_done.map(|last| last.elapsed().as_secs_f64()).filter(|age| *age > FRAME_AGE) {
            (level, message) = (level.max(Level::Warn), format!("no frame for {age:.1} s; before that: {message}"));
        }
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
            s.last_done = Some(Instant::now());
            s.duration_ms = start.elapsed().as_secs_f64() * 1e3;
            s.latency = Some(clock.now().seconds_since(stamp));
            if let Some(error) = error {
                s.errors += 1;
                s.last_error = Some((Instant::now(), format!("{error:#}")));
            }
        });
    }
}

/// A running thread.
pub struct Worker {
    thread: JoinHandle<anyhow::Result<()>>,
}

impl Worker {
    /// Starts a thread that works on what `next` hands out, until that is `None`. When the thread ends, if only because it crashed,
    /// `ended` is notified: a node that cannot work must not look alive.
    ///
    /// # Errors
    /// When the system has no thread left.
    pub fn start<P: Processor>(
        name: &str,
        next: impl FnMut() -> Option<P::Job> + Send + 'static,
        (health, clock, ended): (Health, Clock, Arc<Notify>),
        processor: P,
    ) -> anyhow::Result<Self> {
        let guard = NotifyOnDrop(ended);
        let body = move || {
            let _guard = guard;
            work(next, &health, &clock, processor)
        };
        Ok(Self { thread: std::thread::Builder::new().name(name.to_owned()).spawn(body)? })
    }

    /// Waits until the thread has worked off what waits; its source must have ended.
    ///
    /// # Errors
    /// What the processor could not finish, or that it crashed.
    pub fn finish(self) -> anyhow::Result<()> {
        self.thread.join().map_err(|_| anyhow::anyhow!("the worker crashed"))?
    }
}

struct NotifyOnDrop(Arc<Notify>);

impl Drop for NotifyOnDrop {
    fn drop(&mut self) {
        self.0.notify_one();
    }
}

fn work<P: Processor>(
    mut next: impl FnMut() -> Option<P::Job>,
    health: &Health,
    clock: &Clock,
    mut processor: P,
) -> anyhow::Result<()> {
    let mut complaints = Throttle::default();
    while let Some(job) = next() {
        let (start, stamp) = (Instant::now(), job.stamp());
        let result = processor.process(job);
        if let Err(error) = &result
            && let Some(more) = complaints.pass()
        {
            tracing::error!("frame {stamp}: {error:#} ({more} more errors)");
        }
        health.done(start, stamp, clock, result.as_ref().err());
    }
    processor.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Number(u32);

    impl Job for Number {
        fn stamp(&self) -> Stamp {
            Stamp::from_nanos(i64::from(self.0))
        }
    }

    /// Refuses odd numbers, breaks at 7.
    struct Even;

    impl Processor for Even {
        type Job = Number;

        fn process(&mut self, job: Number) -> anyhow::Result<()> {
            assert_ne!(job.0, 7, "seven");
            anyhow::ensure!(job.0.is_multiple_of(2), "{} is odd", job.0);
            Ok(())
        }

        fn finish(&mut self) -> anyhow::Result<()> {
            Ok(())
        }
    }

    fn start(numbers: std::ops::Range<u32>) -> (Worker, Health, Arc<Notify>) {
        let (health, ended) = (Health::default(), Arc::new(Notify::new()));
        let mut numbers = numbers.map(Number);
        let tools = (health.clone(), Clock::new(false), ended.clone());
        (Worker::start("numbers", move || numbers.next(), tools, Even).unwrap(), health, ended)
    }

    #[test]
    fn an_error_is_counted_and_the_next_job_comes_all_the_same() {
        let (worker, health, _) = start(0..5);
        worker.finish().unwrap();
        let status = health.status("work".into());
        let value = |key: &str| status.values.iter().find(|v| v.key == key).unwrap().value.clone();
        assert_eq!((value("frames"), value("errors")), ("5".into(), "2".into()));
        assert_eq!(status.message, "3 is odd");
    }

    #[test]
    fn what_was_said_of_the_last_frame_does_not_hold_for_ever() {
        let health = Health::default();
        health.report(Level::Ok, "tracking".into(), Vec::new());
        let message = |ago: f64| {
            health.with(|s| s.last_done = Instant::now().checked_sub(std::time::Duration::from_secs_f64(ago)));
            let status = health.status("work".into());
            (status.level, status.message)
        };
        assert_eq!(message(0.5), (0, "tracking".into()));
        assert_eq!(message(3.0), (1, "no frame for 3.0 s; before that: tracking".into()));
    }

    #[test]
    fn a_crash_ends_the_node() {
        let (worker, _, ended) = start(6..10);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(ended.notified());
        assert!(worker.finish().unwrap_err().to_string().contains("crashed"));
    }
}
