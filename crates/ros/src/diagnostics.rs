//! Figures about topics, and throttled complaints.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::messages::diagnostic::{DiagnosticArray, DiagnosticStatus, KeyValue};
use crate::messages::standard::Header;

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// As it should be.
    Ok,
    /// Works, but not as it should.
    Warn,
    /// Does not work.
    Error,
}

/// One part's state.
pub fn status(level: Level, name: String, message: String, values: Vec<(&str, String)>) -> DiagnosticStatus {
    let values = values.into_iter().map(|(key, value)| KeyValue { key: key.to_owned(), value }).collect();
    DiagnosticStatus { level: level as u8, name, message, hardware_id: String::new(), values }
}

/// The message for `/diagnostics`.
pub fn array(header: Header, status: Vec<DiagnosticStatus>) -> DiagnosticArray {
    DiagnosticArray { header, status }
}

/// Share of the newest gap in the smoothed time between messages.
const SMOOTHING: f64 = 0.1;

/// Counts the messages of a topic. Clones share the counters.
#[derive(Clone, Debug)]
pub struct TopicStatistics {
    topic: String,
    shared: Arc<Mutex<Counters>>,
}

#[derive(Debug)]
struct Counters {
    received: u64,
    refused: u64,
    last: Option<Instant>,
    /// Smoothed time between two messages, seconds.
    period: Option<f64>,
    since: Instant,
    since_count: u64,
}

/// What a topic did since it was last asked.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicReport {
    /// Full name.
    pub topic: String,
    /// Messages received in all.
    pub received: u64,
    /// Messages that could not be used, in all.
    pub refused: u64,
    /// Messages a second since the last report.
    pub rate: f64,
    /// Time between two messages, seconds, smoothed over some ten of them.
    pub period: Option<f64>,
    /// Seconds since the last message.
    pub age: Option<f64>,
}

impl TopicStatistics {
    /// Counters at zero for a topic (full name).
    pub fn new(topic: String) -> Self {
        let counters =
            Counters { received: 0, refused: 0, last: None, period: None, since: Instant::now(), since_count: 0 };
        Self { topic, shared: Arc::new(Mutex::new(counters)) }
    }

    /// Full name of the topic.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// A message came.
    pub fn count_received(&self) {
        self.with(|c| {
            c.received += 1;
            c.since_count += 1;
            let now = Instant::now();
            if let Some(gap) = c.last.replace(now).map(|last| (now - last).as_secs_f64()) {
                c.period = Some(c.period.map_or(gap, |period| period + SMOOTHING * (gap - period)));
            }
        });
    }

    /// A message came that cannot be used.
    pub fn count_refused(&self) {
        self.with(|c| c.refused += 1);
    }

    /// The figures; the rate counts from the last report.
    pub fn report(&self) -> TopicReport {
        self.with(|c| {
            let elapsed = c.since.elapsed().as_secs_f64();
            let rate = if elapsed > 0.0 { c.since_count as f64 / elapsed } else { 0.0 };
            (c.since, c.since_count) = (Instant::now(), 0);
            let age = c.last.map(|last| last.elapsed().as_secs_f64());
            TopicReport {
                topic: self.topic.clone(),
                received: c.received,
                refused: c.refused,
                rate,
                period: c.period,
                age,
            }
        })
    }

    fn with<T>(&self, f: impl FnOnce(&mut Counters) -> T) -> T {
        f(&mut self.shared.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Lets the first complaint through at once and then one per period, with the number of those held back.
#[derive(Debug)]
pub struct Throttle {
    period: Duration,
    last: Option<Instant>,
    held_back: u64,
}

impl Default for Throttle {
    /// One in 5 s: readable, yet not to be missed.
    fn default() -> Self {
        Self { period: Duration::from_secs(5), last: None, held_back: 0 }
    }
}

impl Throttle {
    /// Whether to speak now: how many times it was held back before.
    pub fn pass(&mut self) -> Option<u64> {
        if self.last.is_some_and(|last| last.elapsed() < self.period) {
            self.held_back += 1;
            return None;
        }
        self.last = Some(Instant::now());
        Some(std::mem::take(&mut self.held_back))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_count_from_report_to_report() {
        let statistics = TopicStatistics::new("/a".into());
        assert_eq!(statistics.report().age, None);
        statistics.clone().count_received();
        statistics.count_refused();
        let report = statistics.report();
        assert_eq!((report.received, report.refused), (1, 1));
        assert!(report.rate > 0.0 && report.age.is_some());
        assert!(statistics.report().rate.abs() < 1e-12);
    }

    #[test]
    fn complaints_are_held_back_and_counted() {
        let mut throttle = Throttle { period: Duration::from_secs(3600), ..Throttle::default() };
        assert_eq!((throttle.pass(), throttle.pass(), throttle.pass()), (Some(0), None, None));
        throttle.period = Duration::ZERO;
        assert_eq!(throttle.pass(), Some(2));
    }
}
