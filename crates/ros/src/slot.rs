//! Hand-over from callbacks to a worker thread: bounded, counting what is dropped.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use pfd_parameters::Queue;

/// Items that may wait when nothing is to be dropped; beyond it the oldest goes, and is counted.
const MAX_WAITING: usize = 64;

/// A queue between one or more producers and a worker.
#[derive(Debug)]
pub struct Slot<T> {
    state: Mutex<State<T>>,
    filled: Condvar,
    capacity: usize,
}

#[derive(Debug)]
struct State<T> {
    items: VecDeque<T>,
    dropped: u64,
    closed: bool,
}

impl<T> Slot<T> {
    /// A queue that keeps the `newest` items, or all of them.
    pub fn new(queue: Queue, newest: usize) -> Self {
        let capacity = match queue {
            Queue::Newest => newest.max(1),
            Queue::All => MAX_WAITING,
        };
        let state = State { items: VecDeque::new(), dropped: 0, closed: false };
        Self { state: Mutex::new(state), filled: Condvar::new(), capacity }
    }

    /// Puts an item in; when the queue is full the oldest is dropped.
    pub fn put(&self, item: T) {
        let mut state = self.lock();
        while state.items.len() >= self.capacity {
            state.items.pop_front();
            state.dropped += 1;
        }
        state.items.push_back(item);
        self.filled.notify_one();
    }

    /// Waits for the oldest item; `None` when the queue is closed and empty.
    pub fn take(&self) -> Option<T> {
        let mut state = self.lock();
        loop {
            if let Some(item) = state.items.pop_front() {
                return Some(item);
            }
            if state.closed {
                return None;
            }
            state = self.filled.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// How many of the waiting items are such.
    pub fn count(&self, is_such: impl Fn(&T) -> bool) -> usize {
        self.lock().items.iter().filter(|item| is_such(item)).count()
    }

    /// No more items will come: [`Self::take`] returns `None` after the waiting ones.
    pub fn close(&self) {
        self.lock().closed = true;
        self.filled.notify_all();
    }

    /// How many items were dropped so far.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    /// The lock only guards plain data, which a panic elsewhere leaves intact.
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_wins_and_drops_are_counted() {
        let slot = Slot::new(Queue::Newest, 1);
        (1..=3).for_each(|i| slot.put(i));
        assert_eq!([slot.count(|i| *i > 2), slot.count(|i| *i < 3)], [1, 0]);
        slot.close();
        assert_eq!((slot.take(), slot.take(), slot.dropped()), (Some(3), None, 2));
    }

    #[test]
    fn all_keeps_the_order_up_to_the_bound() {
        let slot = Slot::new(Queue::All, 1);
        (0..MAX_WAITING + 2).for_each(|i| slot.put(i));
        slot.close();
        let taken: Vec<usize> = std::iter::from_fn(|| slot.take()).collect();
        assert_eq!(taken, (2..MAX_WAITING + 2).collect::<Vec<_>>());
        assert_eq!(slot.dropped(), 2);
    }

    #[test]
    fn a_waiting_worker_is_woken() {
        let slot = std::sync::Arc::new(Slot::new(Queue::Newest, 1));
        let worker = std::thread::spawn({
            let slot = slot.clone();
            move || slot.take()
        });
        slot.put(5);
        assert_eq!(worker.join().unwrap(), Some(5));
    }
}
