//! Masks on their way to tracking: each belongs to the image with the same stamp.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

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
}

/// Where masks wait.
#[derive(Debug, Default)]
pub struct MaskBox {
    masks: Mutex<BTreeMap<Stamp, Mask>>,
    arrived: Condvar,
}

impl MaskBox {
    /// Puts a mask in; the oldest goes when there are too many, and all go when time was set back.
    pub fn put(&self, stamp: Stamp, mask: Mask) {
        let mut masks = self.lock();
        if masks.keys().next_back().is_some_and(|&newest| is_set_back(newest, stamp)) {
            masks.clear();
        }
        masks.insert(stamp, mask);
        while masks.len() > MAX_WAITING {
            masks.pop_first();
        }
        self.arrived.notify_all();
    }

    /// The mask of the image with `stamp`, for which it waits up to `timeout`. Older masks are forgotten.
    pub fn take(&self, stamp: Stamp, timeout: Duration) -> Taken {
        let deadline = Instant::now() + timeout;
        let mut masks = self.lock();
        loop {
            if let Some(mask) = masks.remove(&stamp) {
                *masks = masks.split_off(&stamp);
                return Taken::Mask(mask);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if masks.keys().next_back().is_some_and(|&newest| newest > stamp) {
                return Taken::PassedOver;
            }
            if left.is_zero() {
                return Taken::Missing;
            }
            masks = self.arrived.wait_timeout(masks, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Forgets all masks: time was set back.
    pub fn clear(&self) {
        self.lock().clear();
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<Stamp, Mask>> {
        self.masks.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    fn at(nanos: i64) -> Stamp {
        Stamp::from_nanos(nanos)
    }

    #[test]
    fn stamps_must_be_equal() {
        let masks = MaskBox::default();
        masks.put(at(5), Mask::empty(1, 1));
        assert_eq!(masks.take(at(6), Duration::ZERO), Taken::Missing);
        assert_eq!(masks.take(at(5), Duration::ZERO), Taken::Mask(Mask::empty(1, 1)));
        assert_eq!(masks.take(at(5), Duration::ZERO), Taken::Missing);
    }

    #[test]
    fn a_skipped_mask_is_not_waited_for() {
        let masks = MaskBox::default();
        masks.put(at(7), Mask::empty(1, 1));
        let start = Instant::now();
        assert_eq!(masks.take(at(6), Duration::from_secs(60)), Taken::PassedOver);
        assert!(start.elapsed() < Duration::from_secs(30));
    }

    #[test]
    fn masks_from_before_time_was_set_back_do_not_count() {
        let masks = MaskBox::default();
        masks.put(at(9_000_000_000), Mask::empty(1, 1));
        masks.put(at(5), Mask::empty(1, 1));
        assert_eq!(masks.take(at(4), Duration::ZERO), Taken::PassedOver);
        assert_eq!(masks.take(at(6), Duration::ZERO), Taken::Missing);
    }

    #[test]
    fn a_late_mask_is_waited_for() {
        let masks = Arc::new(MaskBox::default());
        let waiting = std::thread::spawn({
            let masks = masks.clone();
            move || masks.take(at(3), Duration::from_secs(60))
        });
        masks.put(at(3), Mask::empty(2, 1));
        assert_eq!(waiting.join().unwrap(), Taken::Mask(Mask::empty(2, 1)));
    }
}
