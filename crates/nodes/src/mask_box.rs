//! Masks on their way to tracking: each belongs to the image with the same stamp.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use pfd_geometry::{Mask, Stamp};

use crate::settings::is_set_back;

/// Masks that may wait for their images.
const MAX_WAITING: usize = 32;

/// What became of the mask of an image.
#[derive(Clone, Debug, PartialEq)]
pub enum Taken {
    /// Here it is.
    Mask(Mask),
    /// It will not come: a later one is there.
    PassedOver,
    /// It has not come in time.
    Missing,
    /// No mask will come any more: the node is about to end.
    Closed,
}

/// Where masks wait.
#[derive(Debug, Default)]
pub struct MaskBox {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    masks: BTreeMap<Stamp, Mask>,
    /// Stamp of the newest mask that came, whether or not it is still here.
    newest: Option<Stamp>,
    /// Masks that were waited for in vain since the last one came.
    missing: usize,
    closed: bool,
}

/// After so many masks in a row that were waited for in vain their publisher is taken to be dead, or too slow to be waited for: its
/// silence would slow down every frame. The next mask that comes ends that.
const MAX_MISSING: usize = 3;

impl MaskBox {
    /// Puts a mask in; the oldest goes when there are too many, and all go when time was set back.
    pub fn put(&self, stamp: Stamp, mask: Mask) {
        let mut state = self.lock();
        state.forget_before(stamp);
        state.masks.insert(stamp, mask);
        state.newest = state.newest.max(Some(stamp));
        while state.masks.len() > MAX_WAITING {
            state.masks.pop_first();
        }
        state.missing = 0;
        self.changed.notify_all();
    }

    /// Stamp of the newest mask that came.
    pub fn newest(&self) -> Option<Stamp> {
        self.lock().newest
    }

    /// The mask of the image with `stamp`, for which it waits until `deadline`. Older masks are forgotten.
    pub fn take(&self, stamp: Stamp, deadline: Instant) -> Taken {
        let mut state = self.lock();
        loop {
            if let Some(mask) = state.masks.remove(&stamp) {
                state.masks = state.masks.split_off(&stamp);
                return Taken::Mask(mask);
            }
            if state.newest.is_some_and(|newest| newest > stamp) {
                return Taken::PassedOver;
            }
            if state.closed {
                return Taken::Closed;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Taken::Missing;
            }
            state = self.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Counts a mask that was waited for in vain.
    pub fn miss(&self) {
        self.lock().missing += 1;
    }

    /// Whether so many were that none is to be waited for until one comes.
    pub fn is_silent(&self) -> bool {
        self.lock().missing >= MAX_MISSING
    }

    /// Time was set back to `stamp`: forgets the masks from before.
    pub fn restart(&self, stamp: Stamp) {
        self.lock().forget_before(stamp);
    }

    /// Whoever waits need not wait any longer.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Forgets the masks from before time was set back to `stamp`, if it was.
    fn forget_before(&mut self, stamp: Stamp) {
        if self.newest.is_some_and(|newest| is_set_back(newest, stamp)) {
            self.masks.retain(|&waiting, _| !is_set_back(waiting, stamp));
            self.newest = self.masks.keys().next_back().copied();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::time::Duration;

    fn at(nanos: i64) -> Stamp {
        Stamp::from_nanos(nanos)
    }

    fn now() -> Instant {
        Instant::now()
    }

    fn in_a_minute() -> Instant {
        now() + Duration::from_secs(60)
    }

    #[test]
    fn stamps_must_be_equal() {
        let masks = MaskBox::default();
        masks.put(at(5), Mask::empty(1, 1));
        assert_eq!(masks.take(at(6), now()), Taken::Missing);
        assert_eq!(masks.take(at(5), now()), Taken::Mask(Mask::empty(1, 1)));
        assert_eq!(masks.take(at(5), now()), Taken::Missing);
    }

    #[test]
    fn a_skipped_mask_is_not_waited_for() {
        let masks = MaskBox::default();
        masks.put(at(7), Mask::empty(1, 1));
        let start = Instant::now();
        assert_eq!(masks.take(at(6), in_a_minute()), Taken::PassedOver);
        assert!(start.elapsed() < Duration::from_secs(30));
    }

    #[test]
    fn masks_from_before_time_was_set_back_do_not_count() {
        let masks = MaskBox::default();
        masks.put(at(9_000_000_000), Mask::empty(1, 1));
        masks.put(at(5), Mask::empty(1, 1));
        assert_eq!(masks.take(at(4), now()), Taken::PassedOver);
        assert_eq!(masks.take(at(6), now()), Taken::Missing);
    }

    #[test]
    fn masks_of_the_new_round_stay_when_time_was_set_back() {
        let masks = MaskBox::default();
        masks.put(at(9_000_000_000), Mask::empty(1, 1));
        masks.put(at(9_033_000_000), Mask::empty(1, 1));
        masks.put(at(10), Mask::empty(2, 1));
        masks.restart(at(5));
        assert_eq!(masks.take(at(10), now()), Taken::Mask(Mask::empty(2, 1)));
        let old = MaskBox::default();
        old.put(at(9_000_000_000), Mask::empty(1, 1));
        old.restart(at(5));
        assert_eq!(old.newest(), None);
    }

    #[test]
    fn a_publisher_that_went_silent_is_not_waited_for_until_it_is_back() {
        let masks = MaskBox::default();
        let miss = || {
            masks.miss();
            masks.is_silent()
        };
        assert_eq!([miss(), miss(), miss()], [false, false, true]);
        masks.put(at(100), Mask::empty(1, 1));
        assert!(!masks.is_silent());
    }

    #[test]
    fn a_node_that_ends_does_not_wait() {
        let masks = Arc::new(MaskBox::default());
        let waiting = std::thread::spawn({
            let masks = masks.clone();
            move || masks.take(at(3), in_a_minute())
        });
        masks.close();
        assert_eq!(waiting.join().unwrap(), Taken::Closed);
    }

    #[test]
    fn a_late_mask_is_waited_for() {
        let masks = Arc::new(MaskBox::default());
        let waiting = std::thread::spawn({
            let masks = masks.clone();
            move || masks.take(at(3), in_a_minute())
        });
        masks.put(at(3), Mask::empty(2, 1));
        assert_eq!(waiting.join().unwrap(), Taken::Mask(Mask::empty(2, 1)));
    }
}
