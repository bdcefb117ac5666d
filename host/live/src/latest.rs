//! The latest state, for readers that poll it.

use std::sync::{Arc, Mutex, PoisonError};

use super::observer::Seen;

/// The latest state; written by one thread, read by others, without waiting.
#[derive(Clone, Debug)]
pub struct Latest(Arc<Mutex<Arc<Seen>>>);

impl Latest {
    /// Starts with the state `seen`.
    pub fn new(seen: Seen) -> Self {
        Self(Arc::new(Mutex::new(Arc::new(seen))))
    }

    /// Replaces the state.
    pub fn set(&self, seen: Seen) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(seen);
    }

    /// Returns the latest state.
    pub fn get(&self) -> Arc<Seen> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
