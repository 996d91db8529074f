//! The node's time: the system's, or that of `/clock`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use pfd_geometry::Stamp;

/// A clock that all parts of a node share.
#[derive(Clone, Debug, Default)]
pub struct Clock {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    simulated: AtomicBool,
    /// Last time on `/clock`, nanoseconds.
    time: AtomicI64,
}

impl Clock {
    /// A clock that shows system time or simulated time.
    pub fn new(use_sim_time: bool) -> Self {
        let clock = Self::default();
        clock.set_simulated(use_sim_time);
        clock
    }

    /// Switches between system time and simulated time (parameter `use_sim_time`).
    pub fn set_simulated(&self, simulated: bool) {
        self.shared.simulated.store(simulated, Ordering::Relaxed);
    }

    /// Whether simulated time is shown.
    pub fn is_simulated(&self) -> bool {
        self.shared.simulated.load(Ordering::Relaxed)
    }

    /// Takes over a time from `/clock`.
    pub fn set_time(&self, time: Stamp) {
        self.shared.time.store(time.as_nanos(), Ordering::Relaxed);
    }

    /// The time; with simulated time 0 until `/clock` was heard.
    pub fn now(&self) -> Stamp {
        if self.is_simulated() { Stamp::from_nanos(self.shared.time.load(Ordering::Relaxed)) } else { system_time() }
    }
}

/// The system's time.
pub fn system_time() -> Stamp {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Stamp::from_nanos(i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simulated_time_is_that_of_the_clock_topic() {
        let clock = Clock::new(true);
        assert_eq!(clock.now(), Stamp::default());
        clock.clone().set_time(Stamp::from_nanos(5));
        assert_eq!(clock.now(), Stamp::from_nanos(5));
        clock.set_simulated(false);
        assert!(clock.now() > Stamp::from_nanos(1_600_000_000_000_000_000));
    }
}
