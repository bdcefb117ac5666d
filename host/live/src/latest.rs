//! The latest state, for those who look at it now and then.

use std::sync::{Arc, Mutex, PoisonError};

use super::observer::Seen;

/// What was seen last; written by one thread, read by others, never waited for.
#[derive(Clone, Debug)]
pub struct Latest(Arc<Mutex<Arc<Seen>>>);

impl Latest {
    /// Begins with `seen`.
    pub fn new(seen: Seen) -> Self {
        Self(Arc::new(Mutex::new(Arc::new(seen))))
    }

    /// Replaces it.
    pub fn set(&self, seen: Seen) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(seen);
    }

    /// What was seen last.
    pub fn get(&self) -> Arc<Seen> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
