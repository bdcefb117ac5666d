//! The thread that looks for the board.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

use evcal_core::event::Event;
use usb_davis::capture::GapRepair;
use usb_davis::dump::{DumpHeader, Transfer, TransferStatus};
use usb_davis::protocol::{Decoder, Message};

use super::{LiveCoverage, LiveSettings};
use crate::board::Board;
use crate::detection::DetectionStage;
use crate::detection::settings::DetectionSettings;
use crate::recording::davis::{CameraClock, event};

/// Chunks that are searched in one go: a fifth of a second, unless the settings say otherwise.
const CHUNKS_TOGETHER: usize = 2;

/// What was seen so far.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Boards, coverage and tilts.
    pub coverage: LiveCoverage,
    /// Transfers that were left out because the detector was busy.
    pub left_out: u64,
}

/// A transfer on its way to the detector.
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

struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
    coverage: Mutex<LiveCoverage>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Looks for the board in transfers while they come.
pub struct Watcher {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    longest_wait_ns: u64,
    /// A transfer was left out since the latest one taken.
    gap: bool,
    left_out: u64,
}

impl Watcher {
    /// Starts a detector with these settings for the camera that `header` describes.
    pub fn start(detection: &DetectionSettings, live: &LiveSettings, board: &Board, header: &DumpHeader) -> Self {
        let sensor = header.registers.layout().dvs.size().into();
        let shared = Arc::new(Shared {
            queue: Mutex::default(),
            filled: Condvar::new(),
            coverage: Mutex::new(LiveCoverage::new(live, board, sensor)),
        });
        let (of_thread, detection, pattern) = (Arc::clone(&shared), detection.clone(), board.pattern);
        let longest_wait_ns = (live.longest_wait.max(0.0) * 1e9) as u64;
        let decoder = Decoder::new(header.registers.layout());
        let thread = thread::spawn(move || {
            let stage = DetectionStage::for_board(&detection, sensor, pattern, 0);
            look(&of_thread, decoder, stage);
        });
        Self { shared, thread: Some(thread), longest_wait_ns, gap: false, left_out: 0 }
    }

    /// Takes a transfer, or leaves it out if the oldest one that waits is too old. Does not block.
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

    /// What was seen so far.
    pub fn seen(&self) -> Seen {
        Seen { coverage: lock(&self.shared.coverage).clone(), left_out: self.left_out }
    }

    /// Waits until everything taken has been looked at, [`super::LiveSettings::longest_wait`] of it at
    /// most.
    pub fn finish(mut self) -> Seen {
        self.end();
        self.seen()
    }

    fn end(&mut self) {
        lock(&self.shared.queue).ended = true;
        self.shared.filled.notify_one();
        if let Some(thread) = self.thread.take() {
            // If it panicked, what it had seen before still counts.
            let _ = thread.join();
        }
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.end();
    }
}

/// The detector's thread.
fn look(shared: &Shared, mut decoder: Decoder, mut stage: DetectionStage<'_>) {
    let (mut repair, mut clock) = (GapRepair::default(), CameraClock::default());
    let mut events: Vec<Event> = Vec::new();
    let (mut first, mut latest) = (None, i64::MIN);
    while let Some(piece) = next(shared) {
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
        for event in &mut events {
            latest = latest.max(event.t);
            event.t = latest - *first.get_or_insert(latest);
        }
        stage.push(&events);
        if stage.waiting_chunks() >= CHUNKS_TOGETHER {
            tell(shared, &mut stage);
        }
    }
    tell(shared, &mut stage);
}

/// The next piece; `None` when there will be no more.
fn next(shared: &Shared) -> Option<Piece> {
    let mut queue = lock(&shared.queue);
    loop {
        if let Some(piece) = queue.waiting.pop_front() {
            return Some(piece);
        }
        if queue.ended {
            return None;
        }
        queue = shared.filled.wait(queue).unwrap_or_else(PoisonError::into_inner);
    }
}

fn tell(shared: &Shared, stage: &mut DetectionStage<'_>) {
    let frames = stage.take_frames();
    let mut coverage = lock(&shared.coverage);
    frames.iter().for_each(|frame| coverage.add(frame));
}
