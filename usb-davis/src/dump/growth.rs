//! Progress of a dump that is read while it is being written.

use std::sync::{Arc, Condvar, Mutex, PoisonError};

#[derive(Debug, Default)]
struct State {
    bytes: u64,
    ended: bool,
}

/// Length of a dump that is being written, shared by its writer and its readers.
#[derive(Clone, Debug, Default)]
pub struct Growth(Arc<(Mutex<State>, Condvar)>);

impl Growth {
    /// Sets the length of the dump, which ends with a whole record.
    pub(super) fn set(&self, bytes: u64) {
        let (state, changed) = &*self.0;
        state.lock().unwrap_or_else(PoisonError::into_inner).bytes = bytes;
        changed.notify_all();
    }

    /// Marks the end of writing: readers then treat the file as complete. Call it in every case, also if the recording
    /// failed or never began.
    pub fn end(&self) {
        let (state, changed) = &*self.0;
        state.lock().unwrap_or_else(PoisonError::into_inner).ended = true;
        changed.notify_all();
    }

    /// Waits until the dump is longer than `bytes`, and returns its length up to the last whole record; `None` once
    /// writing has ended.
    pub fn wait_beyond(&self, bytes: u64) -> Option<u64> {
        let (state, changed) = &*self.0;
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        while !state.ended && state.bytes <= bytes {
            state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        (!state.ended).then_some(state.bytes)
    }
}
