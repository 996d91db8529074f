//! Publishers that come and go with the node while the worker stays.

use std::sync::{Arc, Mutex, PoisonError};

/// Holds the publishers of the present node; empty before the first and between two.
#[derive(Debug)]
pub struct Outlet<T> {
    current: Mutex<Option<Arc<T>>>,
}

impl<T> Default for Outlet<T> {
    fn default() -> Self {
        Self { current: Mutex::new(None) }
    }
}

impl<T> Outlet<T> {
    /// Replaces the publishers.
    pub fn set(&self, publishers: T) {
        *self.current.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(publishers));
    }

    /// The publishers, if the node is on the network.
    pub fn get(&self) -> Option<Arc<T>> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Lets the publishers go; endpoints must be gone before their node's runtime is.
    pub fn clear(&self) {
        *self.current.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}
