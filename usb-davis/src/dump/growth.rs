//! How far a dump has been written, for those who read it meanwhile.

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
    /// The dump ends with a whole record at this byte.
    pub(super) fn set(&self, bytes: u64) {
        let (state, changed) = &*self.0;
        state.lock().unwrap_or_else(PoisonError::into_inner).bytes = bytes;
        changed.notify_all();
    }

    /// Nothing more will be written: readers take the file as it is then. To be called however a recording ends, also if
    /// it never began.
    pub fn end(&self) {
        let (state, changed) = &*self.0;
        state.lock().unwrap_or_else(PoisonError::into_inner).ended = true;
        changed.notify_all();
    }

    /// Waits until the dump is longer than `bytes`. Its length, to the end of a whole record; `None` once nothing more
    /// will be written.
    pub fn wait_beyond(&self, bytes: u64) -> Option<u64> {
        let (state, changed) = &*self.0;
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        while !state.ended && state.bytes <= bytes {
            state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        (!state.ended).then_some(state.bytes)
    }
}
