//! Bundle adjustment on a thread of its own.

use std::thread::JoinHandle;

use crate::bundle_adjustment::{BundleProblem, BundleResult};
use crate::config::BundleAdjustmentConfig;

/// A bundle adjustment that is under way.
pub(crate) struct PendingAdjustment {
    worker: JoinHandle<BundleResult>,
    due_frame: usize,
}

impl PendingAdjustment {
    /// Starts to solve `problem`; the result is due at frame `due_frame`. `None` when the system has no thread left: the map then
    /// stays as it is until the next keyframe.
    pub(crate) fn start(problem: BundleProblem, config: BundleAdjustmentConfig, due_frame: usize) -> Option<Self> {
        let thread = std::thread::Builder::new().name("local bundle adjustment".to_owned());
        let worker = thread.spawn(move || problem.solve(&config)).ok()?;
        Some(Self::of(worker, due_frame))
    }

    /// The result of `worker`.
    pub(crate) fn of(worker: JoinHandle<BundleResult>, due_frame: usize) -> Self {
        Self { worker, due_frame }
    }

    /// Whether the result is to be taken over at frame `frame`.
    pub(crate) fn is_due(&self, frame: usize) -> bool {
        frame >= self.due_frame
    }

    /// Whether the result can be had without waiting for it.
    pub(crate) fn is_done(&self) -> bool {
        self.worker.is_finished()
    }

    /// Waits for the result; `None` when the adjustment crashed.
    pub(crate) fn wait(self) -> Option<BundleResult> {
        self.worker.join().ok()
    }
}
