//! A recording's frames for display next to its events.

use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use event_recordings::pictures::GreyImage;
use event_recordings::{Recording, RecordingError};

/// Interval at which the reader checks whether the next frame is due.
const PATIENCE: Duration = Duration::from_millis(10);

/// State shared by the reader and the display.
#[derive(Default)]
struct Shared {
    /// Time of the events shown (µs since the first).
    now: AtomicI64,
    newest: Mutex<Option<Arc<GreyImage>>>,
    ended: AtomicBool,
}

/// Reads the frames of a recording on its own thread, and keeps each back until the display shows events of its time.
pub struct FrameFeed(Arc<Shared>);

impl FrameFeed {
    /// Starts to read `recording`. If it cannot be read, there are no frames; the reader of its events reports the
    /// error.
    pub fn start(recording: Recording) -> Self {
        let shared = Arc::new(Shared::default());
        let of_thread = Arc::clone(&shared);
        thread::spawn(move || {
            let Ok(first) = first_time(&recording) else { return };
            let _ = recording.visit_frames(|frame| {
                let due = frame.exposure.0.saturating_sub(first);
                while of_thread.now.load(Ordering::Relaxed) < due && !of_thread.ended.load(Ordering::Relaxed) {
                    thread::sleep(PATIENCE);
                }
                if let Ok(image) = frame.image {
                    *of_thread.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(image));
                }
            });
        });
        Self(shared)
    }

    /// Sets the time of the display to `t` (s since the first event), and returns the latest frame read up to then.
    pub fn at(&self, t: f64) -> Option<Arc<GreyImage>> {
        self.0.now.store((t * 1e6) as i64, Ordering::Relaxed);
        self.0.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for FrameFeed {
    fn drop(&mut self) {
        self.0.ended.store(true, Ordering::Relaxed);
    }
}

/// Returns the time of the first event (µs, as in the file).
fn first_time(recording: &Recording) -> Result<i64, RecordingError> {
    let (mut reader, mut events) = (recording.open()?, Vec::new());
    while events.is_empty() && reader.next_batch(&mut events)? {}
    Ok(events.first().map_or(0, |event| event.t))
}
