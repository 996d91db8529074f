//! Notices that the middleware's threads have died.
//!
//! RustDDS does its work on two threads a participant. A system call that a signal interrupts (SIGSTOP and SIGCONT, a debugger,
//! suspend) ends them without a word, and nothing is received ever after. The threads are looked for by their id.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

/// How often to look.
pub const PERIOD: Duration = Duration::from_millis(250);
/// Names of the threads, cut to the 15 characters that Linux keeps.
const THREADS: [&str; 2] = ["RustDDS Partici", "RustDDS discove"];

/// Watches the threads of one participant.
#[derive(Debug, Default)]
pub struct Watchdog {
    before: BTreeSet<String>,
    watched: BTreeSet<String>,
}

impl Watchdog {
    /// To be made before the participant, whose threads are those that come later.
    pub fn new() -> Self {
        Self { before: middleware_threads(), watched: BTreeSet::new() }
    }

    /// Whether a thread that was there is gone. Threads are taken note of when they are first seen.
    pub fn is_dead(&mut self) -> bool {
        let now = middleware_threads();
        let dead = self.watched.iter().any(|id| !now.contains(id));
        if self.watched.len() < THREADS.len() {
            self.watched = now.difference(&self.before).cloned().collect();
        }
        dead
    }
}

/// Ids of all threads of this process that belong to the middleware.
fn middleware_threads() -> BTreeSet<String> {
    let is_one = |path: &Path| {
        let name = std::fs::read_to_string(path.join("comm")).unwrap_or_default();
        THREADS.contains(&name.trim_end())
    };
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return BTreeSet::new() };
    let mine = tasks.flatten().filter(|task| is_one(&task.path()));
    mine.map(|task| task.file_name().to_string_lossy().into_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_ends_is_noticed() {
        let mut watchdog = Watchdog::new();
        let (stop, stopped) = std::sync::mpsc::channel::<()>();
        let (started, start) = std::sync::mpsc::channel::<()>();
        let body = move || {
            started.send(()).unwrap();
            let _ = stopped.recv();
        };
        let thread = std::thread::Builder::new().name("RustDDS Participant 7 event loop".into()).spawn(body).unwrap();
        start.recv().unwrap();
        assert!(!watchdog.is_dead());
        assert!(!watchdog.is_dead());
        drop(stop);
        thread.join().unwrap();
        assert!(watchdog.is_dead());
    }
}
