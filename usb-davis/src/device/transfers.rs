//! A queue of bulk transfers that is always full. The only module of this crate with `unsafe` code.
//!
//! libusb completes a transfer by a callback from the thread that handles its events. Here this is our own event thread
//! or, while it waits for an answer, a thread that makes a synchronous request (a register read) with the same context.
//! The callback moves the received data to the backlog, puts an empty buffer into the transfer, and submits it again:
//! the bus never waits for the reader while there is room.
//!
//! Invariants:
//! 1. A transfer, its buffer and the [`Shared`] that it points to are neither freed nor moved while the transfer is
//!    submitted. `State::submitted` counts the submitted transfers. If one never completes, all three and the handle
//!    are leaked instead of freed.
//! 2. [`State`], and with it transfers and buffers, is accessed only under its lock. While a transfer is submitted,
//!    only libusb accesses it and the bytes of its buffer; cancelling a transfer is safe in libusb.
//! 3. The lock is never held while libusb handles events, so a callback never waits for its own thread. Submitting and
//!    cancelling invoke no callback.
//! 4. The callback does not panic: it neither indexes nor unwraps.
//! 5. Callbacks run on the event thread or on the thread that owns the stream, because a request needs the camera,
//!    which the stream borrows. Therefore no callback runs once nothing is submitted and the event thread has ended.

use std::os::raw::{c_int, c_uint, c_void};
use std::ptr::null_mut;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rusb::ffi::{
    self, libusb_alloc_transfer, libusb_cancel_transfer, libusb_free_transfer, libusb_submit_transfer, libusb_transfer,
};
use rusb::{Context, DeviceHandle, UsbContext};

use super::backlog::{Backlog, Queue, StreamStatistics};
use super::error::StreamError;
use crate::dump::{Transfer, TransferStatus};

/// Longest wait of a transfer for data; it is then queued again.
const TRANSFER_TIMEOUT_MS: c_uint = 1000;
/// Interval at which the event thread checks for its end.
const EVENT_TIMEOUT: Duration = Duration::from_millis(100);
/// Pause after an error of libusb's event handling.
const EVENT_PAUSE: Duration = Duration::from_millis(10);
/// Number of consecutive errors of libusb's event handling after which the thread ends.
const EVENT_TRIALS: u32 = 100;
/// Longest wait for cancelled transfers.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);

/// A transfer and its buffer, which is empty while unused.
struct Slot {
    transfer: *mut libusb_transfer,
    buffer: Vec<u8>,
}

// SAFETY: libusb accepts a transfer from any thread; ours use it one at a time (invariant 2).
unsafe impl Send for Slot {}

struct State {
    backlog: Backlog,
    slots: Vec<Slot>,
    /// Numbers of the slots whose transfer waits to be queued until there is room.
    idle: Vec<usize>,
    submitted: usize,
    stopping: bool,
    end: Option<StreamError>,
    /// `true` once no thread handles events any more, so that submitted transfers will not complete.
    events_ended: bool,
}

/// State shared by the reader, the event thread and the callbacks.
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    started: Instant,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The running queue.
pub(super) struct Transfers {
    shared: Arc<Shared>,
    events: Option<JoinHandle<()>>,
    context: Context,
    handle: Arc<DeviceHandle<Context>>,
    /// The buffer that the reader uses.
    current: Option<Vec<u8>>,
}

impl Transfers {
    /// Queues transfers from `endpoint`.
    pub(super) fn start(
        context: &Context,
        handle: &Arc<DeviceHandle<Context>>,
        endpoint: u8,
        queue: Queue,
    ) -> Result<Self, rusb::Error> {
        let state = State {
            backlog: Backlog::new(queue),
            slots: Vec::new(),
            idle: Vec::new(),
            submitted: 0,
            stopping: false,
            end: None,
            events_ended: false,
        };
        let shared = Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new(), started: Instant::now() });
        let (context, handle) = (context.clone(), Arc::clone(handle));
        let mut transfers = Self { shared, events: None, context, handle, current: None };
        transfers.allocate(endpoint)?;
        let submitted = transfers.submit_all();
        // Also needed if some transfers could not be submitted: the submitted ones must be cancelled.
        transfers.handle_events();
        submitted.map(|()| transfers)
    }

    /// Allocates the transfers without submitting them.
    fn allocate(&self, endpoint: u8) -> Result<(), rusb::Error> {
        let mut state = self.shared.lock();
        for _ in 0..state.backlog.transfers() {
            // SAFETY: no preconditions. A null pointer is an error.
            let transfer = unsafe { libusb_alloc_transfer(0) };
            if transfer.is_null() {
                return Err(rusb::Error::NoMem);
            }
            // SAFETY: the transfer is ours and not submitted; handle and `Shared` outlive it (invariant 1); buffer and
            // length are set by `submit`.
            unsafe {
                ffi::libusb_fill_bulk_transfer(
                    transfer,
                    self.handle.as_raw(),
                    endpoint,
                    null_mut(),
                    0,
                    completed,
                    Arc::as_ptr(&self.shared).cast_mut().cast::<c_void>(),
                    TRANSFER_TIMEOUT_MS,
                );
            }
            state.slots.push(Slot { transfer, buffer: Vec::new() });
        }
        Ok(())
    }

    fn submit_all(&self) -> Result<(), rusb::Error> {
        let mut state = self.shared.lock();
        (0..state.slots.len()).try_for_each(|index| submit(index, &mut state))
    }

    fn handle_events(&mut self) {
        if self.shared.lock().submitted > 0 {
            let (context, shared) = (self.context.clone(), Arc::clone(&self.shared));
            self.events = Some(std::thread::spawn(move || {
                handle_events(&shared, |timeout| context.handle_events(Some(timeout)), std::thread::sleep);
            }));
        }
    }

    /// Returns the start of the stream, the zero of host times.
    pub(super) fn started(&self) -> Instant {
        self.shared.started
    }

    /// Returns the next transfer.
    pub(super) fn next(&mut self, timeout: Duration) -> Result<Option<Transfer<'_>>, StreamError> {
        let deadline = Instant::now() + timeout;
        let mut state = self.shared.lock();
        if let Some(used) = self.current.take() {
            state.backlog.give_back(used);
            while state.backlog.has_room()
                && let Some(idle) = state.idle.pop()
            {
                requeue(idle, &mut state);
            }
        }
        loop {
            if let Some(received) = state.backlog.pop() {
                let payload = self.current.insert(received.buffer);
                return Ok(Some(Transfer {
                    host_ns: Some(received.host_ns),
                    gap_before: received.gap_before,
                    status: received.status,
                    payload: payload.get(..received.length).unwrap_or(&[]),
                }));
            }
            if let Some(end) = state.end
                && (state.submitted == 0 || state.events_ended)
            {
                return Err(end);
            }
            let Some(left) = deadline.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) else {
                return Ok(None);
            };
            state = self.shared.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Returns `true` if the endpoint halted before any data arrived.
    pub(super) fn halted_at_once(&self) -> bool {
        let state = self.shared.lock();
        state.end == Some(StreamError::Stalled) && state.backlog.statistics.bytes == 0
    }

    pub(super) fn statistics(&self) -> StreamStatistics {
        self.shared.lock().backlog.statistics
    }

    /// Cancels all transfers and waits for them. Their data can still be read.
    pub(super) fn stop(&mut self) {
        let deadline = Instant::now() + STOP_TIMEOUT;
        let mut state = self.shared.lock();
        state.stopping = true;
        state.end.get_or_insert(StreamError::Stopped);
        for slot in &state.slots {
            // SAFETY: the transfer is not freed (invariant 1). Cancelling a transfer that is not submitted is an error
            // without effect.
            unsafe { libusb_cancel_transfer(slot.transfer) };
        }
        while state.submitted > 0 && !state.events_ended {
            let Some(left) = deadline.checked_duration_since(Instant::now()) else { break };
            state = self.shared.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Drop for Transfers {
    fn drop(&mut self) {
        self.stop();
        if self.shared.lock().submitted > 0 {
            // Invariant 1: the transfers, the data that they point to, and the handle are leaked.
            std::mem::forget((Arc::clone(&self.shared), Arc::clone(&self.handle)));
            return;
        }
        if let Some(events) = self.events.take() {
            self.context.interrupt_handle_events();
            // The thread does not panic, and it ends because nothing is submitted any more.
            let _ = events.join();
        }
        for slot in self.shared.lock().slots.drain(..) {
            // SAFETY: allocated by `libusb_alloc_transfer`, not submitted, and no callback runs (invariant 5).
            unsafe { libusb_free_transfer(slot.transfer) };
        }
    }
}

/// Handles events by `handle` until nothing is submitted any more, or until too many consecutive errors.
fn handle_events(
    shared: &Shared,
    mut handle: impl FnMut(Duration) -> Result<(), rusb::Error>,
    mut pause: impl FnMut(Duration),
) {
    let mut failures = 0;
    loop {
        match handle(EVENT_TIMEOUT) {
            Ok(()) | Err(rusb::Error::Interrupted) => failures = 0,
            Err(error) => {
                failures += 1;
                if failures >= EVENT_TRIALS {
                    shared.lock().end.get_or_insert(StreamError::Events(error));
                    break;
                }
                pause(EVENT_PAUSE);
            }
        }
        let state = shared.lock();
        if state.submitted == 0 && (state.stopping || state.end.is_some()) {
            break;
        }
    }
    shared.lock().events_ended = true;
    shared.changed.notify_all();
}

/// Submits the transfer of a slot with an empty buffer. The transfer must not be submitted already.
fn submit(index: usize, state: &mut State) -> Result<(), rusb::Error> {
    let buffer = state.backlog.buffer();
    let Some(slot) = state.slots.get_mut(index) else { return Ok(()) };
    slot.buffer = buffer;
    // SAFETY: the transfer is not submitted, and the state is locked (invariant 2). The buffer stays at its address
    // until the transfer is complete (invariant 1).
    let code = unsafe {
        (*slot.transfer).buffer = slot.buffer.as_mut_ptr();
        (*slot.transfer).length = c_int::try_from(slot.buffer.len()).unwrap_or(c_int::MAX);
        libusb_submit_transfer(slot.transfer)
    };
    if code == 0 {
        state.submitted += 1;
        return Ok(());
    }
    Err(match code {
        ffi::constants::LIBUSB_ERROR_NO_DEVICE => rusb::Error::NoDevice,
        ffi::constants::LIBUSB_ERROR_BUSY => rusb::Error::Busy,
        ffi::constants::LIBUSB_ERROR_NO_MEM => rusb::Error::NoMem,
        ffi::constants::LIBUSB_ERROR_NOT_SUPPORTED => rusb::Error::NotSupported,
        ffi::constants::LIBUSB_ERROR_INVALID_PARAM => rusb::Error::InvalidParam,
        ffi::constants::LIBUSB_ERROR_IO => rusb::Error::Io,
        _ => rusb::Error::Other,
    })
}

/// Submits the transfer of a slot again, or marks the slot as idle if there is no room.
fn requeue(index: usize, state: &mut State) {
    if state.stopping || state.end.is_some() {
        return;
    }
    if !state.backlog.has_room() {
        state.backlog.statistics.starved += 1;
        state.idle.push(index);
        return;
    }
    if let Err(error) = submit(index, state) {
        state.end.get_or_insert(match error {
            rusb::Error::NoDevice => StreamError::Unplugged,
            error => StreamError::Queue(error),
        });
    }
}

/// Callback of libusb for a completed transfer (thread: see invariant 5).
extern "system" fn completed(transfer: *mut libusb_transfer) {
    use ffi::constants::{
        LIBUSB_TRANSFER_CANCELLED, LIBUSB_TRANSFER_COMPLETED, LIBUSB_TRANSFER_NO_DEVICE, LIBUSB_TRANSFER_OVERFLOW,
        LIBUSB_TRANSFER_STALL, LIBUSB_TRANSFER_TIMED_OUT,
    };
    // SAFETY: `allocate` created the transfer and made it point to `Shared`; both are alive because it was submitted
    // until now (invariant 1). libusb no longer uses it.
    let (code, length, shared) = unsafe {
        ((*transfer).status, (*transfer).actual_length, &*(*transfer).user_data.cast::<Shared>().cast_const())
    };
    let status = match code {
        LIBUSB_TRANSFER_COMPLETED => TransferStatus::Completed,
        LIBUSB_TRANSFER_TIMED_OUT => TransferStatus::TimedOut,
        LIBUSB_TRANSFER_CANCELLED => TransferStatus::Cancelled,
        LIBUSB_TRANSFER_STALL => TransferStatus::Stalled,
        LIBUSB_TRANSFER_NO_DEVICE => TransferStatus::NoDevice,
        LIBUSB_TRANSFER_OVERFLOW => TransferStatus::Overflow,
        _ => TransferStatus::Error,
    };
    let host_ns = u64::try_from(shared.started.elapsed().as_nanos()).unwrap_or(u64::MAX);
    let mut state = shared.lock();
    state.submitted = state.submitted.saturating_sub(1);
    let Some(index) = state.slots.iter().position(|slot| slot.transfer == transfer) else { return };
    let buffer = state.slots.get_mut(index).map_or_else(Vec::new, |slot| std::mem::take(&mut slot.buffer));
    let length = usize::try_from(length).unwrap_or(0);
    match status {
        TransferStatus::NoDevice => {
            state.end.get_or_insert(StreamError::Unplugged);
        }
        TransferStatus::Stalled => {
            state.end.get_or_insert(StreamError::Stalled);
        }
        status => {
            if let Err(end) = state.backlog.take_in(buffer, length, status, host_ns) {
                state.end.get_or_insert(end);
            }
            if status != TransferStatus::Cancelled {
                requeue(index, &mut state);
            }
        }
    }
    shared.changed.notify_all();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shared(submitted: usize) -> Shared {
        let state = State {
            backlog: Backlog::new(Queue::default()),
            slots: Vec::new(),
            idle: Vec::new(),
            submitted,
            stopping: false,
            end: None,
            events_ended: false,
        };
        Shared { state: Mutex::new(state), changed: Condvar::new(), started: Instant::now() }
    }

    #[test]
    fn persistent_errors_of_event_handling_end_the_stream() {
        let shared = shared(3);
        let (mut calls, mut paused) = (0, Duration::ZERO);
        let fail = |_| {
            calls += 1;
            Err(rusb::Error::Io)
        };
        handle_events(&shared, fail, |pause| paused += pause);
        assert_eq!((calls, paused), (EVENT_TRIALS, EVENT_PAUSE * (EVENT_TRIALS - 1)));
        let state = shared.lock();
        assert_eq!((state.end, state.events_ended), (Some(StreamError::Events(rusb::Error::Io)), true));
    }

    #[test]
    fn occasional_errors_of_event_handling_do_not_end_the_stream() {
        let shared = shared(1);
        let mut calls = 0;
        let sometimes = |_| {
            calls += 1;
            if calls == 1000 {
                let mut state = shared.lock();
                (state.submitted, state.stopping) = (0, true);
            }
            if calls % 50 == 0 { Ok(()) } else { Err(rusb::Error::Io) }
        };
        handle_events(&shared, sometimes, |_| {});
        assert_eq!((calls, shared.lock().end), (1000, None));
    }
}
