//! Pictures of the events for display, each with the events since the previous picture.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use usb_davis::dump::{DumpHeader, Transfer};
use usb_davis::protocol::{Frame, Message};

use event_recordings::davis::event;
use event_recordings::pictures::GreyImage;

/// Time between two pictures.
pub const PICTURE_INTERVAL: Duration = Duration::from_millis(33);
/// Largest number of events of one polarity that is counted per pixel.
const MOST: u8 = 15;
/// Limit in bytes of data waiting to be decoded; beyond it all waiting data are skipped.
const MOST_WAITING: usize = 4 << 20;

/// Events of each pixel since the previous picture.
#[derive(Clone, Debug)]
pub struct EventPicture {
    sensor: Sensor,
    /// Event counts of each pixel, row by row: OFF events in the upper four bits, ON events in the lower four, at most
    /// 15 each.
    pixels: Vec<u8>,
    /// Number of ON and OFF events.
    counts: [u64; 2],
    /// Times of the very first event and of the latest one (µs, as in the events).
    times: Option<(i64, i64)>,
}

impl EventPicture {
    /// Creates an empty picture.
    pub fn new(sensor: Sensor) -> Self {
        let pixels = vec![0; usize::from(sensor.width) * usize::from(sensor.height)];
        Self { sensor, pixels, counts: [0; 2], times: None }
    }

    /// Returns the size of the sensor.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns one byte per pixel, row by row: OFF events in the upper four bits, ON events in the lower four.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Returns the number of ON and OFF events.
    pub fn counts(&self) -> [u64; 2] {
        self.counts
    }

    /// Returns the time of the latest event since the first (s).
    pub fn seconds(&self) -> f64 {
        self.times.map_or(0.0, |(first, latest)| (latest - first) as f64 * 1e-6)
    }

    /// Adds events; events outside the sensor are ignored.
    pub fn add(&mut self, events: impl IntoIterator<Item = Event>) {
        for event in events {
            let (first, latest) = self.times.unwrap_or((event.t, event.t));
            self.times = Some((first, latest.max(event.t)));
            if event.x >= self.sensor.width {
                continue;
            }
            let index = usize::from(event.y) * usize::from(self.sensor.width) + usize::from(event.x);
            let Some(pixel) = self.pixels.get_mut(index) else { continue };
            let (on, off) = (*pixel & MOST, *pixel >> 4);
            match event.polarity {
                Polarity::On => {
                    self.counts[0] += 1;
                    *pixel = off << 4 | (on + 1).min(MOST);
                }
                Polarity::Off => {
                    self.counts[1] += 1;
                    *pixel = (off + 1).min(MOST) << 4 | on;
                }
            }
        }
    }

    /// Starts the next picture.
    pub fn clear(&mut self) {
        self.pixels.fill(0);
        self.counts = [0; 2];
    }
}

#[derive(Default)]
struct Queue {
    waiting: VecDeque<(bool, Vec<u8>)>,
    bytes: usize,
    gap: bool,
    ended: bool,
}

#[derive(Default)]
struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
}

/// A thread that converts the camera's transfers to pictures, with its own decoder. Passing a transfer to it never
/// blocks.
pub struct PictureFeed {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    left_out: AtomicU64,
}

impl PictureFeed {
    /// Starts the thread for the camera in `header`; `show` is called with a picture 30 times a second, with the latest
    /// frame while `are_frames_wanted`.
    pub fn start(
        header: &DumpHeader,
        are_frames_wanted: impl Fn() -> bool + Send + 'static,
        mut show: impl FnMut(&EventPicture, Option<&GreyImage>) + Send + 'static,
    ) -> Self {
        let shared = Arc::new(Shared::default());
        let (width, height) = header.registers.layout().dvs.size();
        let (of_thread, mut decoder) = (Arc::clone(&shared), header.decoder());
        let thread = thread::spawn(move || {
            let mut picture = EventPicture::new(Sensor::new(width, height));
            let mut due = Instant::now() + PICTURE_INTERVAL;
            let mut frame = None;
            while let Some(pieces) = next(&of_thread, due.saturating_duration_since(Instant::now())) {
                let are_frames_wanted = are_frames_wanted();
                for (gap, payload) in pieces {
                    if gap {
                        decoder.gap(|_| {});
                    }
                    decoder.decode(&payload, |message| match message {
                        Message::Events(events) => picture.add(events.iter().map(|wire| event(wire, 0))),
                        Message::Frame(new) if are_frames_wanted => frame = grey(&new),
                        _ => {}
                    });
                }
                let now = Instant::now();
                if now >= due {
                    due = (due + PICTURE_INTERVAL).max(now);
                    show(&picture, frame.as_ref().filter(|_| are_frames_wanted));
                    picture.clear();
                }
            }
        });
        Self { shared, thread: Some(thread), left_out: AtomicU64::new(0) }
    }

    /// Returns the number of transfers skipped because the pictures lagged behind.
    pub fn left_out(&self) -> u64 {
        self.left_out.load(Ordering::Relaxed)
    }

    /// Accepts a transfer without blocking: if the pictures lag behind, all waiting transfers are skipped.
    pub fn take(&self, transfer: &Transfer<'_>) {
        let mut queue = self.shared.queue.lock().unwrap_or_else(PoisonError::into_inner);
        if queue.bytes + transfer.payload.len() > MOST_WAITING {
            self.left_out.fetch_add(queue.waiting.len() as u64, Ordering::Relaxed);
            queue.waiting.clear();
            queue.bytes = 0;
            queue.gap = true;
        }
        let gap = std::mem::take(&mut queue.gap) || transfer.gap_before || !transfer.status.is_good();
        queue.bytes += transfer.payload.len();
        queue.waiting.push_back((gap, transfer.payload.to_vec()));
        drop(queue);
        self.shared.filled.notify_one();
    }
}

impl Drop for PictureFeed {
    fn drop(&mut self) {
        self.shared.queue.lock().unwrap_or_else(PoisonError::into_inner).ended = true;
        self.shared.filled.notify_one();
        if let Some(thread) = self.thread.take() {
            // A missing last picture does not matter.
            let _ = thread.join();
        }
    }
}

/// Converts a frame for display, including frames that cannot be used for calibration.
fn grey(frame: &Frame<'_>) -> Option<GreyImage> {
    // Use 8 of the 10 bits.
    let pixels = frame.pixels.iter().map(|pixel| (pixel >> 2).min(255) as u8).collect();
    GreyImage::new(usize::from(frame.region.width), usize::from(frame.region.height), pixels)
}

/// Returns the waiting transfers, after at most `patience`; `None` at the end.
fn next(shared: &Shared, patience: Duration) -> Option<VecDeque<(bool, Vec<u8>)>> {
    let queue = shared.queue.lock().unwrap_or_else(PoisonError::into_inner);
    let waits = |queue: &mut Queue| queue.waiting.is_empty() && !queue.ended;
    let waited = shared.filled.wait_timeout_while(queue, patience, waits).unwrap_or_else(PoisonError::into_inner);
    let mut queue = waited.0;
    queue.bytes = 0;
    let pieces = std::mem::take(&mut queue.waiting);
    (!queue.ended).then_some(pieces)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use usb_davis::configuration::Configuration;
    use usb_davis::dump::TransferStatus;
    use usb_davis::protocol::{Encoder, Layout, Region, Shutter};

    use super::*;
    use event_recordings::davis::dump::davis346_header;

    fn transfer(payload: &[u8]) -> Transfer<'_> {
        Transfer { host_ns: None, gap_before: false, status: TransferStatus::Completed, payload }
    }

    #[test]
    fn transfers_left_out_of_slow_pictures_are_counted() {
        let header = davis346_header("test", &Configuration::calibration());
        let (shown, is_shown) = channel();
        let (go_on, wait) = channel::<()>();
        let show = move |_: &EventPicture, _: Option<&GreyImage>| {
            let _ = shown.send(());
            let _ = wait.recv();
        };
        let feed = PictureFeed::start(&header, || false, show);
        is_shown.recv().unwrap();
        let piece = vec![0; MOST_WAITING / 4];
        (0..4).for_each(|_| feed.take(&transfer(&piece)));
        assert_eq!(feed.left_out(), 0);
        feed.take(&transfer(&piece));
        assert_eq!(feed.left_out(), 4);
        drop(go_on);
    }

    #[test]
    fn the_latest_frame_is_shown_while_it_is_wanted() {
        let header = davis346_header("test", &Configuration::calibration());
        let pixels: Vec<u16> = (0..346 * 260).map(|index| (index % 1000) as u16).collect();
        let frame = Frame {
            // Rolling shutter: unusable for calibration, but displayed.
            shutter: Shutter::Rolling,
            start: 0,
            end: 22_400,
            exposure_start: Some(9200),
            exposure_end: Some(13_200),
            exposure_cycles: 0,
            region: Region { x: 0, y: 0, width: 346, height: 260 },
            damaged_columns: 0,
            pixels: &pixels,
        };
        let mut bytes = Vec::new();
        Encoder::new(Layout::DAVIS346).frame(&frame, &mut bytes).unwrap();
        for wanted in [false, true] {
            let (shown, frames) = channel();
            let feed = PictureFeed::start(
                &header,
                move || wanted,
                move |_, frame| {
                    let _ = shown.send(frame.map(|frame| frame.pixels.clone()));
                },
            );
            feed.take(&transfer(&bytes));
            // The transfer may arrive at any time between two pictures.
            let frame = frames.iter().take(if wanted { 300 } else { 3 }).find_map(|frame| frame);
            assert_eq!(frame.is_some(), wanted);
            let expected = |frame: &Vec<u8>| frame.iter().zip(&pixels).all(|(eight, ten)| u16::from(*eight) == ten / 4);
            assert!(frame.as_ref().is_none_or(expected));
        }
    }

    #[test]
    fn pixels_count_both_polarities_up_to_15() {
        let mut picture = EventPicture::new(Sensor::new(4, 3));
        let event = |x, y, polarity| Event { t: 7, x, y, polarity };
        picture.add([event(1, 2, Polarity::On), event(1, 2, Polarity::Off), event(1, 2, Polarity::On)]);
        picture.add((0..40).map(|_| event(3, 0, Polarity::Off)));
        picture.add([event(4, 0, Polarity::On), event(0, 3, Polarity::On)]);
        assert_eq!((picture.pixels()[9], picture.pixels()[3], picture.pixels()[4]), (0x12, 0xf0, 0));
        assert_eq!(picture.counts(), [2, 41]);
        picture.clear();
        assert!(picture.pixels().iter().all(|pixel| *pixel == 0));
    }
}
