//! Which colour and depth messages belong together, by stamp.

use std::collections::BTreeMap;

use pfd_geometry::Stamp;

/// Messages of one topic that may wait for their partners; the oldest goes first.
const MAX_WAITING: usize = 30;
/// A stamp that lies this much (seconds) behind the newest one means that time was set back: a new recording, a bag that loops.
const RESET_AFTER: f64 = 1.0;

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
    newest: Option<Stamp>,
    newest_second: Option<Stamp>,
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
            newest: None,
            newest_second: None,
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
        self.notice(stamp);
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
        }
        self.pairs()
    }

    /// Adds a message of the second topic; returns the pairs that are now certain.
    pub fn add_second(&mut self, stamp: Stamp, message: B) -> Vec<(A, B)> {
        self.notice(stamp);
        let gap = self.newest_second.map(|last| stamp.as_nanos().saturating_sub(last.as_nanos()));
        self.second_period = gap.and_then(|gap| u64::try_from(gap).ok()).filter(|&gap| gap > 0).or(self.second_period);
        self.newest_second = self.newest_second.max(Some(stamp));
        if self.second.insert(stamp, message).is_some() {
            self.counters.duplicates += 1;
        }
        if self.second.len() > MAX_WAITING {
            self.second.pop_first();
            self.counters.second_unpaired += 1;
        }
        self.pairs()
    }

    /// Starts over when time was set back.
    fn notice(&mut self, stamp: Stamp) {
        if self.newest.is_some_and(|newest| newest.seconds_since(stamp) > RESET_AFTER) {
            self.first.clear();
            self.second.clear();
            (self.last_pair, self.newest, self.newest_second, self.second_period) = (None, None, None, None);
            self.counters.resets += 1;
        }
        self.newest = self.newest.max(Some(stamp));
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
        // Until a later one is there a nearer one may still come, unless it is not due yet.
        let is_certain = |before: Stamp| self.second_period.is_some_and(|period| 2 * distance(before) < period);
        if after.is_none() && !before.is_some_and(is_certain) {
            return None;
        }
        let nearest = before.into_iter().chain(after).min_by_key(|&s| distance(s))?;
        if distance(nearest) <= self.tolerance.unsigned_abs() {
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
