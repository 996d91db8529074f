//! Which colour and depth messages belong together, by stamp.

use std::collections::BTreeMap;

use pfd_geometry::Stamp;

/// Messages of one topic that may wait for their partners; the oldest goes first.
const MAX_WAITING: usize = 30;
/// A stamp that lies this much (seconds) behind the newest one means that time was set back: a new recording, a bag that loops.
const RESET_AFTER: f64 = 1.0;
/// Indices of the two topics.
const FIRST: usize = 0;
const SECOND: usize = 1;

/// What happened to messages that found no partner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SyncCounters {
    /// Pairs made.
    pub pairs: u64,
    /// First-topic messages without a partner within the tolerance.
    pub first_unpaired: u64,
    /// Second-topic messages that no pair used.
    pub second_unpaired: u64,
    /// Messages with a stamp that was there already.
    pub duplicates: u64,
    /// Messages older than the last pair.
    pub late: u64,
    /// How often time was set back.
    pub resets: u64,
}

/// Pairs messages of two topics whose stamps differ by at most the tolerance; equal stamps at once, others as soon as it is
/// certain that no nearer partner will come. Each message is used once; pairs come in the order of the first topic's stamps.
#[derive(Debug)]
pub struct Synchronizer<A, B> {
    tolerance: i64,
    first: BTreeMap<Stamp, A>,
    second: BTreeMap<Stamp, B>,
    last_pair: Option<Stamp>,
    /// Newest stamp of each topic. Time is set back within a topic: a topic that lags behind the other one is merely late.
    newest: [Option<Stamp>; 2],
    /// Time between the last two messages of the second topic, nanoseconds.
    second_period: Option<u64>,
    /// Stamp offset (second minus first, seconds) of the last pair, or of the last near miss.
    last_offset: Option<f64>,
    counters: SyncCounters,
}

impl<A, B> Synchronizer<A, B> {
    /// A synchroniser with a tolerance in seconds; 0 pairs equal stamps only.
    pub fn new(tolerance: f64) -> Self {
        Self {
            tolerance: (tolerance * 1e9).round() as i64,
            first: BTreeMap::new(),
            second: BTreeMap::new(),
            last_pair: None,
            newest: [None; 2],
            second_period: None,
            last_offset: None,
            counters: SyncCounters::default(),
        }
    }

    /// What was paired and what was not.
    pub fn counters(&self) -> SyncCounters {
        self.counters
    }

    /// Stamp of the second message minus that of the first, of the last pair or near miss, seconds.
    pub fn last_offset(&self) -> Option<f64> {
        self.last_offset
    }

    /// Adds a message of the first topic; returns the pairs that are now certain.
    pub fn add_first(&mut self, stamp: Stamp, message: A) -> Vec<(A, B)> {
        self.notice(FIRST, stamp);
        if self.last_pair.is_some_and(|last| stamp <= last) {
            self.counters.late += 1;
            return Vec::new();
        }
        if self.first.insert(stamp, message).is_some() {
            self.counters.duplicates += 1;
        }
        if self.first.len() > MAX_WAITING {
            self.first.pop_first();
            self.counters.first_unpaired += 1;
            self.last_offset = self.newest[SECOND].map(|second| second.seconds_since(stamp)).or(self.last_offset);
        }
        self.pairs()
    }

    /// Adds a message of the second topic; returns the pairs that are now certain.
    pub fn add_second(&mut self, stamp: Stamp, message: B) -> Vec<(A, B)> {
        let last = self.notice(SECOND, stamp);
        let gap = last.map(|last| stamp.as_nanos().saturating_sub(last.as_nanos()));
        self.second_period = gap.and_then(|gap| u64::try_from(gap).ok()).filter(|&gap| gap > 0).or(self.second_period);
        if self.second.insert(stamp, message).is_some() {
            self.counters.duplicates += 1;
        }
        if self.second.len() > MAX_WAITING {
            self.second.pop_first();
            self.counters.second_unpaired += 1;
        }
        self.pairs()
    }

    /// Starts over when time was set back. Returns the newest stamp of the topic before this one.
    fn notice(&mut self, topic: usize, stamp: Stamp) -> Option<Stamp> {
        if self.newest[topic].is_some_and(|newest| newest.seconds_since(stamp) > RESET_AFTER) {
            self.first.clear();
            self.second.clear();
            (self.last_pair, self.newest, self.second_period) = (None, [None; 2], None);
            self.counters.resets += 1;
        }
        let before = self.newest[topic];
        self.newest[topic] = before.max(Some(stamp));
        before
    }

    fn pairs(&mut self) -> Vec<(A, B)> {
        let mut out = Vec::new();
        while let Some((stamp, decision)) = self.decide() {
            let Some(first) = self.first.remove(&stamp) else { break };
            match decision.and_then(|partner| Some((partner, self.second.remove(&partner)?))) {
                Some((partner, second)) => {
                    self.forget_older(partner);
                    self.last_offset = Some(partner.seconds_since(stamp));
                    self.last_pair = Some(stamp);
                    self.counters.pairs += 1;
                    out.push((first, second));
                }
                None => self.counters.first_unpaired += 1,
            }
        }
        out
    }

    /// The oldest first message and its partner (`None`: it has none and will get none), if that is certain.
    fn decide(&mut self) -> Option<(Stamp, Option<Stamp>)> {
        let (&stamp, _) = self.first.first_key_value()?;
        if self.second.contains_key(&stamp) {
            return Some((stamp, Some(stamp)));
        }
        let distance = |s: Stamp| s.as_nanos().abs_diff(stamp.as_nanos());
        let before = self.second.range(..stamp).next_back().map(|(&s, _)| s);
        let after = self.second.range(stamp..).next().map(|(&s, _)| s);
        let is_partner = |s: Stamp| distance(s) <= self.tolerance.unsigned_abs();
        // Until a later one is there a nearer one may still come, unless it is not due yet. After a loss the last gap is no period, but
        // then what came before it is no partner either.
        let is_due_later = |before: Stamp| self.second_period.is_some_and(|period| 2 * distance(before) < period);
        let is_certain = |before: Stamp| is_partner(before) && is_due_later(before);
        if after.is_none() && !before.is_some_and(is_certain) {
            return None;
        }
        let nearest = before.into_iter().chain(after).min_by_key(|&s| distance(s))?;
        if is_partner(nearest) {
            return Some((stamp, Some(nearest)));
        }
        self.last_offset = Some(nearest.seconds_since(stamp));
        Some((stamp, None))
    }

    fn forget_older(&mut self, partner: Stamp) {
        let newer = self.second.split_off(&partner);
        self.counters.second_unpaired += self.second.len() as u64;
        self.second = newer;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(ms: i64) -> Stamp {
        Stamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn equal_stamps_pair_at_once() {
        let mut sync = Synchronizer::new(0.0);
        assert_eq!(sync.add_first(at(10), 'a'), []);
        assert_eq!(sync.add_second(at(10), 1), [('a', 1)]);
        assert_eq!(sync.add_second(at(43), 2), []);
        assert_eq!(sync.add_first(at(43), 'b'), [('b', 2)]);
    }

    #[test]
    fn near_stamps_pair_when_it_is_certain() {
        let mut sync = Synchronizer::new(0.02);
        assert_eq!(sync.add_first(at(33), 'a'), []);
        assert_eq!(sync.add_second(at(20), 1), [], "a nearer one may come");
        assert_eq!(sync.add_second(at(50), 2), [('a', 1)]);
        assert_eq!(sync.add_first(at(66), 'b'), []);
        assert_eq!(sync.add_second(at(80), 3), [('b', 3)]);
        sync.add_second(at(110), 4);
        assert_eq!(sync.add_first(at(115), 'c'), [('c', 4)], "the next is not due before 140 ms");
        assert!((sync.last_offset().unwrap() + 0.005).abs() < 1e-9);
    }

    #[test]
    fn what_has_no_partner_is_counted_and_its_offset_told() {
        let mut sync = Synchronizer::new(0.02);
        sync.add_first(at(0), 'a');
        assert_eq!(sync.add_second(at(100), 1), []);
        assert_eq!(sync.counters().first_unpaired, 1);
        assert!((sync.last_offset().unwrap() - 0.1).abs() < 1e-9);
    }

    #[test]
    fn a_topic_that_lags_behind_is_late_and_not_set_back() {
        for lag in [-5000, 5000] {
            let mut sync = Synchronizer::new(0.02);
            for ms in (10_000..13_000).step_by(33) {
                assert_eq!(sync.add_first(at(ms), ()), []);
                assert_eq!(sync.add_second(at(ms + lag), ()), []);
            }
            assert_eq!(sync.counters().resets, 0);
            assert!(sync.counters().first_unpaired > 30, "{lag} ms: {:?}", sync.counters());
            // As far as a message still waits from which it can be told.
            let offset = sync.last_offset().unwrap();
            assert!((offset - lag as f64 * 1e-3).abs() < 1.1, "{offset} s");
        }
    }

    #[test]
    fn after_a_loss_a_partner_is_waited_for() {
        let mut sync = Synchronizer::new(0.02);
        for ms in [0, 33, 99] {
            sync.add_first(at(ms), ms);
            sync.add_second(at(ms), ms);
        }
        assert_eq!(sync.add_first(at(132), 132), [], "33 ms after a gap of 66");
        assert_eq!(sync.add_second(at(132), 132), [(132, 132)]);
    }

    #[test]
    fn duplicates_late_messages_and_resets() {
        let mut sync = Synchronizer::new(0.02);
        sync.add_second(at(5000), 1);
        sync.add_first(at(5000), 'a');
        assert_eq!(sync.add_first(at(5000), 'a'), []);
        assert_eq!(sync.add_first(at(4990), 'z'), []);
        assert_eq!(sync.counters().late, 2);
        // The bag loops.
        sync.add_first(at(0), 'b');
        assert_eq!(sync.add_second(at(0), 2), [('b', 2)]);
        assert_eq!(sync.counters().resets, 1);
    }

    proptest! {
        #[test]
        fn memory_is_bounded_and_pairs_are_ordered(
            messages in prop::collection::vec((any::<bool>(), 0_i64..3000), 0..300),
        ) {
            let mut sync = Synchronizer::new(0.02);
            let mut last = None;
            for (first, ms) in messages {
                let before = sync.counters().resets;
                let pairs = if first { sync.add_first(at(ms), at(ms)) } else { sync.add_second(at(ms), at(ms)) };
                if sync.counters().resets != before {
                    last = None;
                }
                for (a, b) in pairs {
                    prop_assert!(a.seconds_since(b).abs() <= 0.02 + 1e-9);
                    prop_assert!(last.is_none_or(|l| l < a));
                    last = Some(a);
                }
                prop_assert!(sync.first.len() <= MAX_WAITING && sync.second.len() <= MAX_WAITING);
            }
        }
    }
}
