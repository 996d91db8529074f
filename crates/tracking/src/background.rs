//! Bundle adjustment on a thread of its own.

use std::thread::JoinHandle;

use crate::bundle_adjustment::{BundleProblem, BundleResult};
use crate::config::BundleAdjustmentConfig;

/// How much less urgent the solver is than the frames, in steps of `nice`: where processors are short it gets a tenth of what they get.
const NICENESS: i32 = 10;

/// Lets frames go first. Only on Linux does a thread have a niceness of its own; where the system refuses, all are alike.
fn give_way() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(NICENESS);
}

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
        let worker = thread
            .spawn(move || {
                give_way();
                problem.solve(&config)
            })
            .ok()?;
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

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use rustix::process::getpriority_process;

    #[test]
    fn only_the_thread_that_gives_way_does() {
        const LEAST_URGENT: i32 = 19;
        let before = getpriority_process(None).unwrap();
        let after = std::thread::spawn(|| {
            give_way();
            getpriority_process(None).unwrap()
        });
        assert_eq!(after.join().unwrap(), (before + NICENESS).min(LEAST_URGENT));
        assert_eq!(getpriority_process(None).unwrap(), before);
    }
}
