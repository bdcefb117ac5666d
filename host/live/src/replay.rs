//! Replay of a recording as if it came from a camera now; also of one that is still being written.

use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

use super::latest::Latest;
use super::observer::{Observer, Seen};
use super::picture::{EventPicture, PICTURE_INTERVAL};
use event_recordings::{EventReader, Recording, RecordingError};

/// Length of the pieces in which events are passed on (µs of the sensor).
const PIECE: i64 = 10_000;
/// Largest number of events of a piece: 6.5 million per second. Files may contain very many events of one time.
const LARGEST_PIECE: usize = 1 << 16;
/// Largest number of batches that are read ahead.
const BATCHES_AHEAD: usize = 4;
/// Largest number of pieces that wait for the detector.
const PIECES_AHEAD: usize = 32;
/// Time between two attempts to pass a piece to a busy detector.
const FULL: Duration = Duration::from_millis(2);
/// Time between two reported states (s of the sensor).
const STATUS_INTERVAL: f64 = 1.0;

/// Result of a replay.
#[derive(Debug)]
pub struct ReplayReport {
    /// Number of events passed on.
    pub events: u64,
    /// Time of these events (s).
    pub seconds: f64,
    /// State at the end.
    pub seen: Seen,
    /// Error that ended the replay before the end of the recording, if the recording is damaged.
    pub damage: Option<RecordingError>,
}

/// Plays `recording` to `observer` until it ends, enough was seen, or `show` breaks.
///
/// `speed` is in seconds of the recording per second; `None` means as fast as the detector. `show` is called with a
/// picture 30 times a second, also while no events arrive, `on_progress` with the state once per second of the recording's time, whatever
/// the speed.
///
/// # Errors
/// [`RecordingError`] if no event can be read.
pub fn replay(
    recording: &Recording,
    sensor: Sensor,
    speed: Option<f64>,
    observer: Observer<'_>,
    latest: &Latest,
    on_progress: impl FnMut(&Seen) + Send,
    mut show: impl FnMut(&EventPicture) -> ControlFlow<()>,
) -> Result<ReplayReport, RecordingError> {
    let reader = recording.open()?;
    let (read, batches) = sync_channel(BATCHES_AHEAD);
    // A recording that is still being written may never get a further event. The thread that waits for it is left behind.
    thread::Builder::new()
        .name("reading".to_owned())
        .spawn(move || pass_on(reader, &read))
        .map_err(|error| RecordingError::io(recording.path(), error))?;
    thread::scope(|scope| {
        let (sender, pieces) = sync_channel::<Vec<Event>>(PIECES_AHEAD);
        let observing = scope.spawn(move || observe(observer, &pieces, latest, on_progress));
        let mut clock = Clock { speed, began: Instant::now() };
        let mut picture = EventPicture::new(sensor);
        let mut due = Instant::now() + PICTURE_INTERVAL;
        let (mut count, mut start, mut last) = (0, None, 0);
        let damage = 'played: loop {
            let mut batch = match batches.recv_timeout(due.saturating_duration_since(Instant::now())) {
                Ok(Ok(batch)) => batch,
                Ok(Err(error)) if count > 0 => break Some(error),
                Ok(Err(error)) => return Err(error),
                Err(RecvTimeoutError::Disconnected) => break None,
                Err(RecvTimeoutError::Timeout) => {
                    due = Instant::now() + PICTURE_INTERVAL;
                    if show(&picture).is_break() {
                        break None;
                    }
                    picture.clear();
                    continue;
                }
            };
            let start = *start.get_or_insert_with(|| batch.first().map_or(0, |event| event.t));
            batch.iter_mut().for_each(|event| event.t -= start);
            let pieces = batch.chunk_by(|a, b| a.t.div_euclid(PIECE) == b.t.div_euclid(PIECE));
            for piece in pieces.flat_map(|piece| piece.chunks(LARGEST_PIECE)) {
                last = piece.last().map_or(last, |event| event.t);
                let mut is_due = false;
                while !is_due {
                    let now = Instant::now();
                    is_due = clock.wait(last, due.saturating_duration_since(now));
                    if now >= due {
                        // Pictures that could not be shown in time are skipped.
                        due = (due + PICTURE_INTERVAL).max(now);
                        if show(&picture).is_break() {
                            break 'played None;
                        }
                        picture.clear();
                    }
                }
                picture.add(piece.iter().copied());
                count += piece.len() as u64;
                let mut waiting = Some(piece.to_vec());
                while let Some(piece) = waiting.take() {
                    match sender.try_send(piece) {
                        Ok(()) => {}
                        // The detector waits for a calibration, or is slower than the recording. Pictures are shown
                        // meanwhile.
                        Err(TrySendError::Full(piece)) => {
                            waiting = Some(piece);
                            thread::sleep(due.saturating_duration_since(Instant::now()).min(FULL));
                            if Instant::now() >= due {
                                due = Instant::now() + PICTURE_INTERVAL;
                                if show(&picture).is_break() {
                                    break 'played None;
                                }
                                picture.clear();
                            }
                        }
                        // Enough was seen.
                        Err(TrySendError::Disconnected(_)) => break 'played None,
                    }
                }
            }
        };
        drop(sender);
        let seen = observing.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        // The remaining events belong to the last picture.
        let _ = show(&picture);
        Ok(ReplayReport { events: count, seconds: last as f64 * 1e-6, seen, damage })
    })
}

/// Reads all events, until nobody takes them any more.
fn pass_on(mut reader: EventReader, read: &SyncSender<Result<Vec<Event>, RecordingError>>) {
    loop {
        let mut batch = Vec::new();
        let (next, is_last) = match reader.next_batch(&mut batch) {
            Ok(true) => (Ok(batch), false),
            Ok(false) => return,
            Err(error) => (Err(error), true),
        };
        if read.send(next).is_err() || is_last {
            return;
        }
    }
}

/// Runs the detector's thread.
fn observe(
    mut observer: Observer<'_>,
    pieces: &Receiver<Vec<Event>>,
    latest: &Latest,
    mut on_progress: impl FnMut(&Seen),
) -> Seen {
    let mut next = STATUS_INTERVAL;
    for piece in pieces {
        if !observer.push(&piece) {
            continue;
        }
        let seen = observer.seen();
        let is_enough = seen.is_enough();
        if seen.t >= next {
            next = (seen.t / STATUS_INTERVAL).floor() * STATUS_INTERVAL + STATUS_INTERVAL;
            on_progress(&seen);
        }
        latest.set(seen);
        if is_enough {
            break;
        }
    }
    observer.finish();
    latest.set(observer.seen());
    observer.seen()
}

/// Clock that determines when an event is due.
struct Clock {
    speed: Option<f64>,
    began: Instant,
}

impl Clock {
    /// Waits for time `t` (µs) of the recording, for at most `patience`; returns `true` if it has come.
    fn wait(&mut self, t: i64, patience: Duration) -> bool {
        let Some(speed) = self.speed else { return true };
        let due = Duration::try_from_secs_f64(t as f64 * 1e-6 / speed).unwrap_or(Duration::MAX);
        let left = due.saturating_sub(self.began.elapsed());
        thread::sleep(left.min(patience));
        left <= patience
    }
}
