//! Progress on stderr: a bar on a terminal, a line now and then elsewhere.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::output;

/// How many lines a run prints where there is no terminal.
const LINES: usize = 10;

/// Progress of one run, or of several at the same time.
#[derive(Debug)]
pub(crate) struct Progress {
    name: String,
    total: usize,
    bar: Option<ProgressBar>,
    done: AtomicUsize,
    start: Instant,
}

impl Progress {
    pub(crate) fn new(name: &str, total: usize) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let style = ProgressStyle::with_template("{msg} {bar:30} {pos}/{len} {per_sec} {eta} left");
            let bar = ProgressBar::new(total as u64).with_message(name.to_owned());
            bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        });
        Self { name: name.to_owned(), total, bar, done: AtomicUsize::new(0), start: Instant::now() }
    }

    /// One frame is done.
    pub(crate) fn step(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        match &self.bar {
            Some(bar) => bar.inc(1),
            None if is_milestone(done, self.total) => {
                let left = time_left(self.start.elapsed(), done, self.total);
                output::note(&format!("{}: {done}/{}{left}", self.name, self.total));
            }
            None => {}
        }
    }

    /// Something the user should know about a frame.
    pub(crate) fn note(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| output::note(text)),
            None => output::note(text),
        }
    }

    pub(crate) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// How long the rest takes at the pace so far; nothing at the end.
fn time_left(elapsed: Duration, done: usize, total: usize) -> String {
    if done >= total {
        return String::new();
    }
    let seconds = elapsed.as_secs_f64() * (total - done) as f64 / done.max(1) as f64;
    let minutes = (seconds / 60.0).floor();
    format!(", {minutes:.0} min {:.0} s left", (seconds - 60.0 * minutes).floor())
}

fn is_milestone(done: usize, total: usize) -> bool {
    let share = |n: usize| n * LINES / total.max(1);
    share(done) > share(done - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rest_takes_as_long_per_frame() {
        assert_eq!(time_left(Duration::from_secs(50), 10, 30), ", 1 min 40 s left");
        assert_eq!(time_left(Duration::from_secs(50), 30, 30), "");
    }

    #[test]
    fn lines_are_few() {
        assert_eq!((1..=1000).filter(|&i| is_milestone(i, 1000)).count(), LINES);
        assert_eq!((1..=3).filter(|&i| is_milestone(i, 3)).count(), 3);
    }
}
