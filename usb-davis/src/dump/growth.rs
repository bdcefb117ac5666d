//! Progress of a file that is read while it is being written.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

#[derive(Debug, Default)]
struct State {
    bytes: u64,
    ended: bool,
}

/// Length of a file that is being written, shared by its writer and its readers.
#[derive(Clone, Debug, Default)]
pub struct Growth(Arc<(Mutex<State>, Condvar)>);

impl Growth {
    /// Sets the number of bytes that readers may use. In a dump they end with a whole record.
    pub fn set(&self, bytes: u64) {
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

    /// Waits until more than `bytes` may be used, and returns their number; `None` once writing has ended.
    pub fn wait_beyond(&self, bytes: u64) -> Option<u64> {
        let (state, changed) = &*self.0;
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        while !state.ended && state.bytes <= bytes {
            state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        (!state.ended).then_some(state.bytes)
    }

    /// `true` once writing has ended.
    pub fn has_ended(&self) -> bool {
        self.0.0.lock().unwrap_or_else(PoisonError::into_inner).ended
    }

    /// Waits until more than `bytes` may be used or writing has ended, but not longer than `patience`.
    pub fn wait_at_most(&self, bytes: u64, patience: Duration) {
        let (state, changed) = &*self.0;
        let until = Instant::now().checked_add(patience);
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        while !state.ended && state.bytes <= bytes {
            let left = until.map_or(Duration::MAX, |until| until.saturating_duration_since(Instant::now()));
            if left.is_zero() {
                break;
            }
            state = changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// Two are equal if they describe the same writing.
impl PartialEq for Growth {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}
