//! Reader of the messages of a DAVIS346, with times that continue over gaps and clock resets.

use std::fs::File;
use std::io::{BufReader, Seek};
use std::path::{Path, PathBuf};

use evcal_core::event::{Event, Polarity};
use usb_davis::capture::{Capture, CaptureError, DeviceAddress};
use usb_davis::dump::{DumpHeader, Growth};
use usb_davis::protocol::{AnomalyKind, Decoder, Message, Polarity as WirePolarity, PolarityEvent};
use usb_davis::registers::Dropped;

use super::{FRAMES, INERTIAL, SIGNALS};
use crate::bytes::share;
use crate::error::{RecordingError, RecordingErrorKind, Usable};
use crate::read_report::{ReadReport, RepairedTimes, StreamFaults, Truncation};
use crate::reader::PAUSE_AFTER_RESET;

/// Size of the read buffer in bytes.
const BUFFER: usize = 1 << 18;

/// Converts an event of the camera's stream, with its time `shift` µs later.
pub fn event(event: &PolarityEvent, shift: i64) -> Event {
    Event {
        t: i64::try_from(event.time).unwrap_or(i64::MAX).saturating_add(shift),
        x: event.x,
        y: event.y,
        polarity: match event.polarity {
            WirePolarity::Off => Polarity::Off,
            WirePolarity::On => Polarity::On,
        },
    }
}

/// Clock that makes the camera's times continuous. They restart at zero when the camera's clock is reset; this clock
/// then continues 1 s after the latest time.
#[derive(Clone, Copy, Debug, Default)]
pub struct CameraClock {
    shift: i64,
    latest: Option<i64>,
    resets: u64,
}

impl CameraClock {
    /// Processes a message. Returns the offset in µs that must be added to its times.
    pub fn shift(&mut self, message: &Message<'_>) -> i64 {
        let time = match message {
            Message::Events(events) => events.last().map(|event| event.time),
            Message::Signal(signal) => Some(signal.time),
            Message::Imu(sample) => Some(sample.time),
            Message::Frame(frame) => Some(frame.end),
            Message::TimestampReset { .. } => {
                if let Some(latest) = self.latest {
                    self.shift = latest.saturating_add(PAUSE_AFTER_RESET);
                    self.resets += 1;
                }
                None
            }
            _ => None,
        };
        let time = time.map(|time| i64::try_from(time).unwrap_or(i64::MAX).saturating_add(self.shift));
        self.latest = self.latest.max(time);
        self.shift
    }
}

/// Reader of the messages in a recording of USB transfers.
pub struct Messages {
    path: PathBuf,
    /// Second handle of the capture's file, which shares its position.
    watched: File,
    /// Length of the file; `None` while it is being written.
    length: Option<u64>,
    capture: Capture,
    decoder: Decoder<Vec<u16>>,
    clock: CameraClock,
    other: [u64; 3],
    /// Offset in µs of the times of each repair.
    repair_shifts: Vec<i64>,
    ended: bool,
}

impl Messages {
    /// Opens a dump, a capture or a bare stream. `device` selects one of the devices in a capture.
    pub fn open(path: &Path, device: Option<DeviceAddress>) -> Result<Self, RecordingError> {
        let length = std::fs::metadata(path).map_err(|error| RecordingError::io(path, error))?.len();
        Self::new(path, Some(length), |file| Capture::new(file, device))
    }

    /// Opens a dump that is still being written. At its current end, [`Messages::next`] waits for more.
    pub fn follow(path: &Path, growth: &Growth) -> Result<Self, RecordingError> {
        Self::new(path, None, |file| Capture::follow(file, growth.clone()))
    }

    fn new(
        path: &Path,
        length: Option<u64>,
        open: impl FnOnce(BufReader<File>) -> Result<Capture, CaptureError>,
    ) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::io(path, error);
        let file = File::open(path).map_err(io)?;
        let watched = file.try_clone().map_err(io)?;
        let capture = open(BufReader::with_capacity(BUFFER, file)).map_err(|reason| error(path, reason))?;
        let decoder = capture.header().decoder();
        let clock = CameraClock::default();
        let (other, repair_shifts) = ([0; 3], Vec::new());
        Ok(Self { path: path.to_owned(), watched, length, capture, decoder, clock, other, repair_shifts, ended: false })
    }

    /// Header of the recording, with identity and registers of the camera.
    pub fn header(&self) -> &DumpHeader {
        self.capture.header()
    }

    /// Passes the messages of the next transfer to `sink`, each with the offset in µs of its times. Returns `false` at
    /// the end.
    ///
    /// # Errors
    /// [`RecordingErrorKind::Damaged`], after all messages before the damage.
    pub fn next(&mut self, mut sink: impl FnMut(Message<'_>, i64)) -> Result<bool, RecordingError> {
        // A gap precedes everything else in its transfer.
        let shift = self.clock.shift;
        let (clock, [frames, samples, signals]) = (&mut self.clock, &mut self.other);
        let take = |message: Message<'_>| {
            match message {
                Message::Frame(_) => *frames += 1,
                Message::Imu(_) => *samples += 1,
                Message::Signal(_) => *signals += 1,
                _ => {}
            }
            let shift = clock.shift(&message);
            sink(message, shift);
        };
        let more = self.capture.decode_next(&mut self.decoder, take).map_err(|reason| error(&self.path, reason))?;
        self.repair_shifts.resize(self.capture.repairs().len(), shift);
        self.ended = !more;
        Ok(more)
    }

    /// Fraction of the file that has been read, 0 to 1; `None` if unknown.
    pub fn done(&self) -> Option<f64> {
        let position = (&self.watched).stream_position().ok()?;
        self.length.map(|length| share(position, length))
    }

    /// Reads like [`Messages::next`], but treats damage as the end. The reader of the events finds the same damage and
    /// reports it.
    pub fn next_whole(&mut self, sink: impl FnMut(Message<'_>, i64)) -> Result<bool, RecordingError> {
        self.next(sink).or_else(|error| if error.is_damage() { Ok(false) } else { Err(error) })
    }

    /// Stores the faults so far in `report`.
    pub fn report(&self, report: &mut ReadReport) {
        let repairs = self.capture.repair_counts();
        let repaired_times =
            self.capture.repairs().iter().zip(&self.repair_shifts).map(|(repair, shift)| RepairedTimes {
                from_us: i64::try_from(repair.time).unwrap_or(i64::MAX).saturating_add(*shift),
                restored_us: repair.restored_us,
                excess_us: repair.excess_us,
            });
        let faults = self.decoder.counts().anomalies;
        let faults = faults.iter().filter(|(kind, _)| *kind != AnomalyKind::Gap);
        report.stream = StreamFaults {
            gaps: repairs.gaps,
            repaired_gaps: repairs.repaired,
            restored_us: repairs.restored_us,
            repaired_times: repaired_times.collect(),
            taken_back_us: repairs.taken_back_us,
            clock_resets: self.clock.resets,
            dropped: Dropped::between(&self.header().registers, self.capture.registers()).events,
            faults: faults.map(|(kind, count)| (kind.text(), count)).collect(),
        };
        for (name, count) in [FRAMES, INERTIAL, SIGNALS].into_iter().zip(self.other) {
            if count > 0 {
                report.other_packets.insert(name.to_owned(), count);
            }
        }
        report.frames = self.ended.then_some(self.other[0]);
        let unfinished = self.capture.damage().unfinished;
        if self.ended && unfinished > 0 {
            let byte = std::fs::metadata(&self.path).map_or(0, |file| file.len()).saturating_sub(unfinished);
            report.truncated = Some(Truncation { byte, lost: "a transfer is incomplete".to_owned() });
        }
    }
}

fn error(path: &Path, error: CaptureError) -> RecordingError {
    match error {
        CaptureError::Io(error) => RecordingError::io(path, error),
        CaptureError::Damaged { byte, what } => RecordingError::damaged(path, byte, what, Usable::Before),
        error => RecordingError::new(path, RecordingErrorKind::Capture(error)),
    }
}
