//! Masks on their way to tracking: each belongs to the image with the same stamp.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use pfd_geometry::{Mask, Stamp};

/// Masks that may wait for their images.
const MAX_WAITING: usize = 32;

/// Where masks wait.
#[derive(Debug, Default)]
pub struct MaskBox {
    masks: Mutex<BTreeMap<Stamp, Mask>>,
    arrived: Condvar,
}

impl MaskBox {
    /// Puts a mask in; the oldest goes when there are too many.
    pub fn put(&self, stamp: Stamp, mask: Mask) {
        let mut masks = self.lock();
        masks.insert(stamp, mask);
        while masks.len() > MAX_WAITING {
            masks.pop_first();
        }
        self.arrived.notify_all();
    }

    /// The mask of the image with `stamp`, for which it waits up to `timeout`, but not when a later mask is there: then this one
    /// was skipped. Older masks are forgotten.
    pub fn take(&self, stamp: Stamp, timeout: Duration) -> Option<Mask> {
        let deadline = Instant::now() + timeout;
        let mut masks = self.lock();
        loop {
            if let Some(mask) = masks.remove(&stamp) {
                *masks = masks.split_off(&stamp);
                return Some(mask);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            let was_skipped = masks.keys().next_back().is_some_and(|&newest| newest > stamp);
            if was_skipped || left.is_zero() {
                return None;
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
        assert_eq!(masks.take(at(6), Duration::ZERO), None);
        assert_eq!(masks.take(at(5), Duration::ZERO), Some(Mask::empty(1, 1)));
        assert_eq!(masks.take(at(5), Duration::ZERO), None);
    }

    #[test]
    fn a_skipped_mask_is_not_waited_for() {
        let masks = MaskBox::default();
        masks.put(at(7), Mask::empty(1, 1));
        let start = Instant::now();
        assert_eq!(masks.take(at(6), Duration::from_secs(60)), None);
        assert!(start.elapsed() < Duration::from_secs(30));
    }

    #[test]
    fn a_late_mask_is_waited_for() {
        let masks = Arc::new(MaskBox::default());
        let waiting = std::thread::spawn({
            let masks = masks.clone();
            move || masks.take(at(3), Duration::from_secs(60))
        });
        masks.put(at(3), Mask::empty(2, 1));
        assert_eq!(waiting.join().unwrap(), Some(Mask::empty(2, 1)));
    }
}
