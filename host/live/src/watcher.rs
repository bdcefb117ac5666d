//! The thread that searches for the board.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use evcal_core::event::Event;
use usb_davis::capture::GapRepair;
use usb_davis::dump::{DumpHeader, Transfer, TransferStatus};
use usb_davis::protocol::{Decoder, Message};

use super::checkpoint::Checkpoints;
use super::latest::Latest;
use super::observer::{Memory, Observer, Seen};
use evcal_calibrate::settings::LiveSettings;
use evcal_detection::detection::settings::DetectionSettings;
use evcal_geometry::board::Board;
use evcal_solve::initial::InitialSettings;
use event_recordings::davis::{CameraClock, event};

/// Interval at which checkpoints are updated while nothing arrives.
const PATIENCE: Duration = Duration::from_millis(100);
/// Time without an event after which the camera is reported silent, also the interval between such reports.
const SILENCE: Duration = Duration::from_secs(1);

/// A transfer queued for the detector.
struct Piece {
    host_ns: u64,
    gap_before: bool,
    payload: Vec<u8>,
}

#[derive(Default)]
struct Queue {
    waiting: VecDeque<Piece>,
    ended: bool,
}

#[derive(Default)]
struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Searches for the board in transfers as they arrive.
pub struct Watcher {
    shared: Arc<Shared>,
    latest: Latest,
    thread: Option<JoinHandle<Memory>>,
    longest_wait_ns: u64,
    /// `true` if a transfer was skipped since the latest one that was accepted.
    gap: bool,
    left_out: u64,
}

impl Watcher {
    /// Starts a detector with these settings for the camera in `header`; `checkpoints` calibrate its recording. The
    /// knowledge from earlier recordings is used if they are calibrated together.
    pub fn start(
        detection: &DetectionSettings,
        initial: &InitialSettings,
        live: &LiveSettings,
        board: &Board,
        header: &DumpHeader,
        checkpoints: Checkpoints,
        memory: Option<Memory>,
    ) -> Self {
        let sensor = header.registers.layout().dvs.size().into();
        let shared = Arc::new(Shared::default());
        let observer = Observer::new(detection, initial, live, board, sensor);
        let observer = match memory {
            Some(memory) => observer.with_memory(memory),
            None => observer,
        };
        let (latest, memory) = (Latest::new(observer.seen()), observer.into_memory());
        let longest_wait_ns = (live.longest_wait.max(0.0) * 1e9) as u64;
        let decoder = Decoder::new(header.registers.layout());
        let (of_thread, latest_of_thread) = (Arc::clone(&shared), latest.clone());
        let (detection, initial, live, board) = (detection.clone(), initial.clone(), live.clone(), *board);
        let thread = thread::spawn(move || {
            let observer = Observer::new(&detection, &initial, &live, &board, sensor);
            let observer = observer.with_memory(memory).with_checkpoints(checkpoints);
            run_detector(&of_thread, decoder, observer, &latest_of_thread)
        });
        Self { shared, latest, thread: Some(thread), longest_wait_ns, gap: false, left_out: 0 }
    }

    /// Accepts a transfer, or skips it if the oldest waiting one is too old. Does not block.
    pub fn take(&mut self, transfer: &Transfer<'_>) {
        let host_ns = transfer.host_ns.unwrap_or(0);
        let mut queue = lock(&self.shared.queue);
        let oldest = queue.waiting.front().map_or(host_ns, |piece| piece.host_ns);
        if host_ns.saturating_sub(oldest) > self.longest_wait_ns {
            self.gap = true;
            self.left_out += 1;
            return;
        }
        let gap_before = std::mem::take(&mut self.gap) || transfer.gap_before || !transfer.status.is_good();
        queue.waiting.push_back(Piece { host_ns, gap_before, payload: transfer.payload.to_vec() });
        drop(queue);
        self.shared.filled.notify_one();
    }

    /// Returns the current state.
    pub fn seen(&self) -> Seen {
        Seen { left_out: self.left_out, ..Seen::clone(&self.latest.get()) }
    }

    /// Returns the latest state for other threads, without [`Seen::left_out`].
    pub fn latest(&self) -> Latest {
        self.latest.clone()
    }

    /// Waits until all accepted transfers have been processed. They are at most the latest
    /// [`LiveSettings::longest_wait`](evcal_calibrate::settings::LiveSettings::longest_wait) seconds. Returns the
    /// state, and the knowledge for later recordings.
    pub fn finish(mut self) -> (Seen, Option<Memory>) {
        let memory = self.end();
        (self.seen(), memory)
    }

    fn end(&mut self) -> Option<Memory> {
        lock(&self.shared.queue).ended = true;
        self.shared.filled.notify_one();
        // If the thread panicked, the state before still counts.
        self.thread.take().and_then(|thread| thread.join().ok())
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.end();
    }
}

/// Runs the detector's thread.
fn run_detector(shared: &Shared, mut decoder: Decoder, mut observer: Observer<'_>, seen: &Latest) -> Memory {
    let (mut repair, mut clock) = (GapRepair::default(), CameraClock::default());
    let mut events: Vec<Event> = Vec::new();
    let (mut first, mut latest) = (None, i64::MIN);
    let (mut heard, mut silence) = (Instant::now(), SILENCE);
    while let Some(piece) = next(shared) {
        if heard.elapsed() >= silence {
            observer.silence(heard.elapsed().as_secs_f64());
            silence += SILENCE;
            seen.set(observer.seen());
        }
        let Some(piece) = piece else {
            if observer.check() {
                seen.set(observer.seen());
            }
            continue;
        };
        let transfer = Transfer {
            host_ns: Some(piece.host_ns),
            gap_before: piece.gap_before,
            status: TransferStatus::Completed,
            payload: &piece.payload,
        };
        events.clear();
        repair.decode(&transfer, &mut decoder, |message| {
            let shift = clock.shift(&message);
            if let Message::Events(new) = message {
                events.extend(new.iter().map(|wire| event(wire, shift)));
            }
        });
        if !events.is_empty() {
            (heard, silence) = (Instant::now(), SILENCE);
        }
        for event in &mut events {
            latest = latest.max(event.t);
            event.t = latest - *first.get_or_insert(latest);
        }
        if observer.push(&events) {
            seen.set(observer.seen());
        }
    }
    observer.finish();
    seen.set(observer.seen());
    observer.into_memory()
}

/// Returns the next piece, or no piece after a while; `None` if there will be no more.
fn next(shared: &Shared) -> Option<Option<Piece>> {
    let mut queue = lock(&shared.queue);
    if queue.waiting.is_empty() && !queue.ended {
        queue = shared.filled.wait_timeout(queue, PATIENCE).unwrap_or_else(PoisonError::into_inner).0;
    }
    match queue.waiting.pop_front() {
        None if queue.ended => None,
        piece => Some(piece),
    }
}
