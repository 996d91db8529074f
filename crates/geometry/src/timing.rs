//! How long the stages of a computation took.

use std::time::Instant;

/// Named stages with their wall-clock time in milliseconds, in the order in which they ran.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StageTimes(pub Vec<(&'static str, f64)>);

impl StageTimes {
    /// Runs `stage` and records how long it took under `name`.
    pub fn measure<T>(&mut self, name: &'static str, stage: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = stage();
        self.0.push((name, start.elapsed().as_secs_f64() * 1e3));
        result
    }

    /// Sum over all stages, milliseconds.
    pub fn total(&self) -> f64 {
        self.0.iter().map(|(_, ms)| ms).sum()
    }
}
