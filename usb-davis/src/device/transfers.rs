//! A queue of bulk transfers that is always full. The only `unsafe` of this crate.
//!
//! libusb completes a transfer by a call back from its event loop, which here runs on a thread of
//! its own. The call back puts the full buffer into a queue, an empty one into the transfer, and
//! submits it again: the bus never waits for the reader as long as there are empty buffers.
//!
//! Invariants:
//! 1. A [`Slot`] is boxed, and neither it, its transfer nor its buffer is freed or moved while the
//!    transfer is submitted. `State::submitted` counts those that are.
//! 2. A slot is touched only by the call back of its transfer, or, while the transfer is not
//!    submitted, by whoever holds the lock of `State`.
//! 3. The event thread runs until no transfer is submitted. If one never comes back, its memory and
//!    the handle are leaked, not freed.
//! 4. The call back does not panic: it neither indexes nor unwraps.

use std::collections::VecDeque;
use std::os::raw::{c_int, c_uint, c_void};
use std::ptr::null_mut;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rusb::ffi::{
    self, libusb_alloc_transfer, libusb_cancel_transfer, libusb_free_transfer, libusb_submit_transfer, libusb_transfer,
};
use rusb::{Context, DeviceHandle, UsbContext};

use super::error::StreamError;
use crate::dump::{Transfer, TransferStatus};

/// No transfer waits longer than this for data; it is queued again then.
const TRANSFER_TIMEOUT_MS: c_uint = 1000;
/// How often the event thread looks up.
const EVENT_TIMEOUT: Duration = Duration::from_millis(100);
/// Longest wait for transfers that were called back.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);

/// Transfers and memory of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Queue {
    /// Transfers queued at a time, 8 to 32 (cut to that).
    pub transfers: usize,
    /// Bytes of each, rounded up to packets of 1024, at least one.
    pub transfer_bytes: usize,
    /// Full buffers that may wait for the reader, beside those queued. All buffers together are the
    /// memory of the stream.
    pub waiting: usize,
}

impl Default for Queue {
    /// 32 transfers of 128 KiB, 4 MiB of the 16 that Linux grants by default: at 50 MB/s the process
    /// may sleep for 80 ms before the camera must drop. Up to 512 waiting (64 MiB, 1.3 s).
    fn default() -> Self {
        Self { transfers: 32, transfer_bytes: 128 * 1024, waiting: 512 }
    }
}

/// What a stream has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamStatistics {
    /// Transfers that brought something.
    pub transfers: u64,
    /// Bytes they brought.
    pub bytes: u64,
    /// Transfers that could not be queued again at once, because all buffers were full: the reader
    /// is too slow. The camera may have dropped events then; its own counters know
    /// ([`super::Camera::read_drop_counters`]).
    pub starved: u64,
    /// Largest number of full buffers that waited to be read.
    pub waiting_most: usize,
}

/// A full buffer.
struct Filled {
    buffer: Vec<u8>,
    length: usize,
    status: TransferStatus,
    host_ns: u64,
}

/// What the reader, the event thread and the call backs share.
struct State {
    filled: VecDeque<Filled>,
    empty: Vec<Vec<u8>>,
    /// Buffers that may still be made.
    reserve: usize,
    /// Slots whose transfer found no empty buffer.
    idle: Vec<SlotPointer>,
    submitted: usize,
    stopping: bool,
    end: Option<StreamError>,
    statistics: StreamStatistics,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    started: Instant,
    transfer_bytes: usize,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Slot {
    transfer: *mut libusb_transfer,
    buffer: Vec<u8>,
    shared: Arc<Shared>,
}

#[derive(Clone, Copy)]
struct SlotPointer(*mut Slot);

// SAFETY: a slot is used by one thread at a time (invariant 2).
unsafe impl Send for SlotPointer {}

/// The running queue.
pub(super) struct Transfers {
    shared: Arc<Shared>,
    slots: Vec<SlotPointer>,
    events: Option<JoinHandle<()>>,
    handle: Arc<DeviceHandle<Context>>,
    /// The buffer that the reader has.
    current: Vec<u8>,
}

impl Transfers {
    /// Queues transfers from `endpoint`.
    pub(super) fn start(
        context: &Context,
        handle: &Arc<DeviceHandle<Context>>,
        endpoint: u8,
        queue: Queue,
    ) -> Result<Self, rusb::Error> {
        let count = queue.transfers.clamp(8, 32);
        let transfer_bytes = queue.transfer_bytes.clamp(1024, 1 << 24).next_multiple_of(1024);
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                filled: VecDeque::new(),
                empty: Vec::new(),
                reserve: queue.waiting.max(1),
                idle: Vec::new(),
                submitted: 0,
                stopping: false,
                end: None,
                statistics: StreamStatistics::default(),
            }),
            changed: Condvar::new(),
            started: Instant::now(),
            transfer_bytes,
        });
        let mut transfers = Self {
            shared: Arc::clone(&shared),
            slots: Vec::new(),
            events: None,
            handle: Arc::clone(handle),
            current: Vec::new(),
        };
        let mut state = shared.lock();
        for _ in 0..count {
            // SAFETY: no preconditions. A null pointer is an error.
            let transfer = unsafe { libusb_alloc_transfer(0) };
            if transfer.is_null() {
                return Err(rusb::Error::NoMem);
            }
            let slot = Slot { transfer, buffer: vec![0; transfer_bytes], shared: Arc::clone(&shared) };
            let pointer = SlotPointer(Box::into_raw(Box::new(slot)));
            transfers.slots.push(pointer);
            // SAFETY: the transfer is ours and not submitted; the handle outlives it (invariant 3);
            // buffer and length are set by `submit`.
            unsafe {
                ffi::libusb_fill_bulk_transfer(
                    transfer,
                    handle.as_raw(),
                    endpoint,
                    null_mut(),
                    0,
                    completed,
                    pointer.0.cast::<c_void>(),
                    TRANSFER_TIMEOUT_MS,
                );
            }
            if let Err(error) = submit(pointer, &mut state) {
                drop(state);
                transfers.run_events(context);
                return Err(error);
            }
        }
        drop(state);
        transfers.run_events(context);
        Ok(transfers)
    }

    fn run_events(&mut self, context: &Context) {
        let (context, shared) = (context.clone(), Arc::clone(&self.shared));
        self.events = Some(std::thread::spawn(move || {
            loop {
                let failed = context.handle_events(Some(EVENT_TIMEOUT));
                let mut state = shared.lock();
                if let Err(error) = failed
                    && error != rusb::Error::Interrupted
                {
                    state.end.get_or_insert(StreamError::Queue(error));
                }
                if state.submitted == 0 && (state.stopping || state.end.is_some()) {
                    break;
                }
            }
        }));
    }

    /// The next full buffer.
    pub(super) fn next(&mut self, timeout: Duration) -> Result<Option<Transfer<'_>>, StreamError> {
        let deadline = Instant::now() + timeout;
        let mut state = self.shared.lock();
        let used = std::mem::take(&mut self.current);
        if !used.is_empty() {
            state.empty.push(used);
            if let Some(idle) = state.idle.pop() {
                requeue(idle, &mut state);
            }
        }
        loop {
            if let Some(filled) = state.filled.pop_front() {
                self.current = filled.buffer;
                return Ok(Some(Transfer {
                    host_ns: Some(filled.host_ns),
                    gap_before: false,
                    status: filled.status,
                    payload: self.current.get(..filled.length).unwrap_or(&[]),
                }));
            }
            if let Some(end) = state.end
                && state.submitted == 0
            {
                return Err(end);
            }
            let Some(left) = deadline.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) else {
                return Ok(None);
            };
            state = self.shared.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    pub(super) fn statistics(&self) -> StreamStatistics {
        self.shared.lock().statistics
    }

    /// Calls all transfers back and waits for them. What they bring can still be read.
    pub(super) fn stop(&mut self) {
        let deadline = Instant::now() + STOP_TIMEOUT;
        {
            let mut state = self.shared.lock();
            state.stopping = true;
            state.end.get_or_insert(StreamError::Stopped);
            for slot in &self.slots {
                // SAFETY: the transfer lives as long as `self` (invariant 1). Cancelling one that
                // is not submitted is an error without effect.
                unsafe { libusb_cancel_transfer((*slot.0).transfer) };
            }
        }
        let mut state = self.shared.lock();
        while state.submitted > 0 {
            let Some(left) = deadline.checked_duration_since(Instant::now()) else { break };
            state = self.shared.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Drop for Transfers {
    fn drop(&mut self) {
        self.stop();
        if self.shared.lock().submitted > 0 {
            // Invariant 3: the slots stay as they are, and so does the handle.
            std::mem::forget(Arc::clone(&self.handle));
            return;
        }
        if let Some(events) = self.events.take() {
            // It does not panic, and it ends because nothing is submitted any more.
            let _ = events.join();
        }
        for slot in self.slots.drain(..) {
            // SAFETY: made by `Box::into_raw` and `libusb_alloc_transfer`, not submitted, and the
            // event thread, the only other user, has ended.
            unsafe {
                let slot = Box::from_raw(slot.0);
                libusb_free_transfer(slot.transfer);
            }
        }
    }
}

/// Submits the transfer of a slot that has a buffer.
fn submit(slot: SlotPointer, state: &mut State) -> Result<(), rusb::Error> {
    // SAFETY: the transfer is not submitted, and the caller holds the lock (invariant 2).
    let code = unsafe {
        let slot = &mut *slot.0;
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

/// Gives a slot an empty buffer and submits it; puts it aside if there is none.
fn requeue(slot: SlotPointer, state: &mut State) {
    if state.stopping || state.end.is_some() {
        return;
    }
    // SAFETY: its transfer is not submitted, and the caller holds the lock (invariant 2).
    let place = unsafe { &mut *slot.0 };
    let buffer = state.empty.pop().or_else(|| {
        state.reserve = state.reserve.checked_sub(1)?;
        Some(vec![0; place.shared.transfer_bytes])
    });
    let Some(buffer) = buffer else {
        state.statistics.starved += 1;
        state.idle.push(slot);
        return;
    };
    place.buffer = buffer;
    if let Err(error) = submit(slot, state) {
        state.end.get_or_insert(match error {
            rusb::Error::NoDevice => StreamError::Unplugged,
            error => StreamError::Queue(error),
        });
    }
}

/// libusb calls this from the event thread when a transfer is over.
extern "system" fn completed(transfer: *mut libusb_transfer) {
    use ffi::constants::{
        LIBUSB_TRANSFER_CANCELLED, LIBUSB_TRANSFER_COMPLETED, LIBUSB_TRANSFER_NO_DEVICE, LIBUSB_TRANSFER_OVERFLOW,
        LIBUSB_TRANSFER_STALL, LIBUSB_TRANSFER_TIMED_OUT,
    };
    // SAFETY: `user_data` is the slot that this transfer belongs to, alive because the transfer was
    // submitted until now (invariant 1), and ours to touch (invariant 2).
    let (status, length, pointer, slot) = unsafe {
        let pointer = SlotPointer((*transfer).user_data.cast::<Slot>());
        ((*transfer).status, (*transfer).actual_length, pointer, &mut *pointer.0)
    };
    let status = match status {
        LIBUSB_TRANSFER_COMPLETED => TransferStatus::Completed,
        LIBUSB_TRANSFER_TIMED_OUT => TransferStatus::TimedOut,
        LIBUSB_TRANSFER_CANCELLED => TransferStatus::Cancelled,
        LIBUSB_TRANSFER_STALL => TransferStatus::Stalled,
        LIBUSB_TRANSFER_NO_DEVICE => TransferStatus::NoDevice,
        LIBUSB_TRANSFER_OVERFLOW => TransferStatus::Overflow,
        _ => TransferStatus::Error,
    };
    let shared = Arc::clone(&slot.shared);
    let mut state = shared.lock();
    state.submitted -= 1;
    let length = usize::try_from(length).unwrap_or(0).min(slot.buffer.len());
    let buffer = std::mem::take(&mut slot.buffer);
    // After a failure the bytes may be anything: they are not handed over.
    if status.is_good() && length > 0 {
        let host_ns = u64::try_from(shared.started.elapsed().as_nanos()).unwrap_or(u64::MAX);
        state.filled.push_back(Filled { buffer, length, status, host_ns });
        let waiting = state.filled.len();
        let statistics = &mut state.statistics;
        statistics.transfers += 1;
        statistics.bytes += length as u64;
        statistics.waiting_most = statistics.waiting_most.max(waiting);
    } else {
        state.empty.push(buffer);
    }
    match status {
        TransferStatus::Completed | TransferStatus::TimedOut => requeue(pointer, &mut state),
        TransferStatus::Cancelled => {}
        TransferStatus::NoDevice => {
            state.end.get_or_insert(StreamError::Unplugged);
        }
        TransferStatus::Stalled => {
            state.end.get_or_insert(StreamError::Stalled);
        }
        TransferStatus::Error | TransferStatus::Overflow => {
            state.end.get_or_insert(StreamError::Failed(status));
        }
    }
    shared.changed.notify_all();
}
