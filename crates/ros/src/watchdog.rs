//! Notices that the middleware's threads have died, or that the process was suspended for so long that others have given it up:
//! they do not take the same participant back.
//!
//! RustDDS does its work on two threads a participant. An error of the system or a fault ends them without a word, and nothing is
//! received ever after. (Interrupted system calls did so, as after SIGSTOP and SIGCONT, until that was mended: see
//! `third_party/rustdds/PATCHES.md`.) The threads are looked for by their id.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

/// How often to look.
pub const PERIOD: Duration = Duration::from_millis(250);
/// Time in which the threads of a new participant must be running; they name themselves when they first run.
const STARTUP: Duration = Duration::from_secs(10);
/// A process that did not run for longer than this was suspended; others give it up after 10 s (Cyclone DDS) or 20 s (Fast DDS).
const SUSPENSION: Duration = Duration::from_secs(5);
/// Names of the threads, cut to the 15 characters that Linux keeps.
const THREADS: [&str; 2] = ["RustDDS Partici", "RustDDS discove"];

/// Watches the threads of one participant.
#[derive(Debug)]
pub struct Watchdog {
    before: BTreeSet<String>,
    watched: BTreeSet<String>,
    deadline: Instant,
    last_look: (Instant, Duration),
}

impl Watchdog {
    /// To be made before the participant, whose threads are those that come later.
    pub fn start() -> Self {
        let now = Instant::now();
        Self {
            before: middleware_threads(),
            watched: BTreeSet::new(),
            deadline: now + STARTUP,
            last_look: (now, since_boot()),
        }
    }

    /// Whether to join anew: the process was suspended, or a thread is gone: one that was seen, or one that did not show up in time because it died before anyone looked.
    pub fn is_dead(&mut self) -> bool {
        self.was_suspended(Instant::now(), since_boot()) || self.is_dead_at(Instant::now())
    }

    /// Whether it is long since the last look. One clock stands still while the computer sleeps, the other goes on; nobody can set either.
    fn was_suspended(&mut self, now: Instant, boot_now: Duration) -> bool {
        let (last, boot_last) = std::mem::replace(&mut self.last_look, (now, boot_now));
        let slept = boot_now.saturating_sub(boot_last);
        slept.max(now.saturating_duration_since(last)) > SUSPENSION
    }

    fn is_dead_at(&mut self, time: Instant) -> bool {
        let now = middleware_threads();
        self.watched.extend(now.difference(&self.before).cloned());
        let complete = self.watched.len() >= THREADS.len();
        !self.watched.is_subset(&now) || (!complete && time >= self.deadline)
    }
}

/// Time since the computer was started, sleep included; zero where the system does not tell.
fn since_boot() -> Duration {
    let text = std::fs::read_to_string("/proc/uptime").unwrap_or_default();
    let seconds = text.split_whitespace().next().and_then(|number| number.parse().ok());
    seconds.and_then(|s| Duration::try_from_secs_f64(s).ok()).unwrap_or_default()
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
    use std::sync::mpsc::{Sender, channel};
    use std::thread::JoinHandle;

    use super::*;

    /// Runs until the sender is dropped.
    fn thread(name: &str) -> (Sender<()>, JoinHandle<()>) {
        let (stop, stopped) = channel::<()>();
        let (started, start) = channel::<()>();
        let body = move || {
            started.send(()).unwrap();
            let _ = stopped.recv();
        };
        let thread = std::thread::Builder::new().name(name.into()).spawn(body).unwrap();
        start.recv().unwrap();
        (stop, thread)
    }

    #[test]
    fn a_long_suspension_is_noticed_once() {
        let mut watchdog = Watchdog::start();
        let (now, boot) = (Instant::now(), since_boot());
        assert!(boot > Duration::ZERO);
        assert!(!watchdog.was_suspended(now, boot));
        assert!(!watchdog.was_suspended(now + PERIOD, boot + PERIOD));
        assert!(watchdog.was_suspended(now + 2 * SUSPENSION, boot + 2 * SUSPENSION), "stopped");
        assert!(!watchdog.was_suspended(now + 2 * SUSPENSION, boot + 2 * SUSPENSION));
        assert!(watchdog.was_suspended(now + 2 * SUSPENSION, boot + 4 * SUSPENSION), "the computer slept");
        assert!(!watchdog.was_suspended(now + 2 * SUSPENSION, Duration::ZERO), "the system does not tell");
    }

    // One test, as threads of parallel tests would be taken for the middleware's.
    #[test]
    fn a_thread_that_ends_or_never_shows_up_is_noticed() {
        let mut watchdog = Watchdog::start();
        let (stop, event_loop) = thread("RustDDS Participant 7 event loop");
        let (_run, _discovery) = thread("RustDDS discovery");
        assert!(!watchdog.is_dead());
        let mut late = Watchdog::start();
        drop(stop);
        event_loop.join().unwrap();
        // The kernel lists a thread for a moment after it was joined.
        let patience = Instant::now() + Duration::from_secs(10);
        while !watchdog.is_dead() {
            assert!(Instant::now() < patience, "the end of the event loop goes unnoticed");
            std::thread::yield_now();
        }

        let (_run, _event_loop) = thread("RustDDS Participant 8 event loop");
        let deadline = late.deadline;
        assert!(!late.is_dead(), "the other thread may still come");
        assert!(late.is_dead_at(deadline), "the other thread has died early");
    }
}
