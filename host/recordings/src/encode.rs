//! The interface of a format's writer.

use std::fs::File;
use std::io;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_files::remedies;
use usb_davis::capture::{Capture, CaptureError};
use usb_davis::dump::DumpError;
use usb_davis::protocol::EncodeError;

use super::extras::{Extra, OtherStreams};

/// Error while writing a recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The operating system reported an error.
    #[error("cannot be written: {}", evcal_files::message(.0))]
    Io(#[from] io::Error),
    /// A packet or header exceeds what its size field can express.
    #[error("a packet or header is too large for its format")]
    TooLarge,
    /// The format is for a DAVIS346 only.
    #[error("a DAVIS346 has 346x260 pixels; the recording is for a sensor of {}x{}", .0.width, .0.height)]
    Sensor(Sensor),
    /// The sensor has more columns or rows than the format supports.
    #[error("{format} supports at most {most} columns and rows; the sensor of the recording has {}x{} pixels", sensor.width, sensor.height)]
    Size {
        /// Name of the output format.
        format: &'static str,
        /// Largest number of columns or rows of that format.
        most: u16,
        /// Sensor of the recording.
        sensor: Sensor,
    },
    /// A time is outside the range of the format.
    #[error("ROS has no time of {0} us: times are from 0 on, in ROS 2 before the year 2038; write another format")]
    Time(i64),
    /// The jump in time between two elements is too long for a format that counts time in words.
    #[error("its times jump from {before} us to {time} us, more than a day, which this format does not support")]
    Jump {
        /// Time before the jump in µs.
        before: i64,
        /// Time of the event, frame or sample after the jump in µs.
        time: i64,
    },
    /// The pauses are too long together for a format that counts time in words.
    #[error("up to {time} us, its pauses have more than 30 days together, which this format does not support")]
    Pauses {
        /// Time in µs of the event, frame or sample after the last pause.
        time: i64,
    },
    /// A camera could not have sent this data.
    #[error("a DAVIS346 could not send this: {0}")]
    Wire(#[from] EncodeError),
    /// The dump cannot be written.
    #[error("cannot be written: {0}")]
    Dump(#[from] DumpError),
}

remedies! { WriteError, say;
    Self::Jump { .. } | Self::Pauses { .. } =>
        "if the unit of its timestamps is wrong, give it with {}; otherwise cut the recording there", say.time_unit;
}

/// Longest jump forward in µs for formats that count time in words: one day. A damaged time could otherwise fill the
/// disk.
const LONGEST_JUMP: u64 = 86_400_000_000;

/// Length in µs above which a jump forward is a pause. All pauses of a recording together may have 30 days.
pub const PAUSE: u64 = 1_000_000;
const ALL_PAUSES: u64 = 30 * LONGEST_JUMP;

/// The pauses so far in a file of a format that counts time in words.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pauses {
    /// Length of all pauses in µs.
    length: u64,
}

impl Pauses {
    /// Checks that the format can continue from the time `before` to `time` (µs).
    ///
    /// # Errors
    /// [`WriteError::Jump`] or [`WriteError::Pauses`].
    pub fn check(&mut self, before: i64, time: i64) -> Result<(), WriteError> {
        let step = if time > before { time.abs_diff(before) } else { 0 };
        if step > LONGEST_JUMP {
            return Err(WriteError::Jump { before, time });
        }
        if step > PAUSE {
            self.length += step;
        }
        if self.length > ALL_PAUSES { Err(WriteError::Pauses { time }) } else { Ok(()) }
    }
}

/// Properties of a recording that are known before it is written.
#[derive(Clone, Copy, Debug)]
pub struct Description<'a> {
    /// Width and height of the sensor in pixels.
    pub sensor: Sensor,
    /// Model and serial number of the camera; empty if unknown.
    pub camera_name: &'a str,
    /// Streams to be written in addition to the events.
    pub others: OtherStreams,
    /// Time in µs that becomes zero on the camera's clock, for formats with such a clock.
    pub zero: i64,
}

/// Creates the file and writes everything that precedes the first event. The file is requested last, so that no file
/// remains if the format does not support the recording.
pub type CreateFile = fn(&mut dyn FnMut() -> io::Result<File>, &Description) -> Result<Box<dyn Encode>, WriteError>;

/// Copies the USB transfers of a camera into a new file.
pub type CopyTransfers = fn(&mut Capture, File) -> Result<CopiedTransfers, WriteError>;

/// A format that can be written.
#[derive(Clone, Copy, Debug)]
pub struct OutputFormat {
    /// Name on the command line.
    pub name: &'static str,
    /// Name for the user, if the one on the command line is not clear.
    pub title: Option<&'static str>,
    /// File name extensions of the format, in lower case.
    pub extensions: &'static [&'static str],
    /// `true` if the file contains the size of the sensor.
    pub contains_sensor: bool,
    /// `true` if the file can contain frames and IMU samples.
    pub contains_extras: bool,
    /// Creates a file of this format.
    pub create: CreateFile,
    /// Copies USB transfers into a new file, if the format stores them.
    pub copy_transfers: Option<CopyTransfers>,
}

impl OutputFormat {
    /// Creates a format of events only, whose files contain the size of the sensor.
    pub(crate) const fn of_events(name: &'static str, extensions: &'static [&'static str], create: CreateFile) -> Self {
        let (contains_sensor, contains_extras) = (true, false);
        Self { name, title: None, extensions, contains_sensor, contains_extras, create, copy_transfers: None }
    }
}

impl PartialEq for OutputFormat {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for OutputFormat {}

/// Result of copying USB transfers.
#[derive(Debug, Default)]
pub struct CopiedTransfers {
    /// Number of transfers copied.
    pub transfers: u64,
    /// Description of what was lost, as a sentence.
    pub lost: Option<String>,
    /// Error that ended reading early.
    pub error: Option<CaptureError>,
}

/// Encoder of one format: turns events, and frames and IMU samples if supported, into bytes.
pub trait Encode {
    /// Writes `events`, which follow those written before.
    ///
    /// # Errors
    /// When the format does not support them or the output cannot be written.
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError>;

    /// Writes a frame or an IMU sample. Returns `false` if the format does not support it.
    ///
    /// # Errors
    /// As [`Encode::write`].
    fn extra(&mut self, extra: Extra) -> Result<bool, WriteError> {
        let _ = extra;
        Ok(false)
    }

    /// Announces that all events, frames and samples before `end` (µs) have been written.
    ///
    /// # Errors
    /// As [`Encode::write`].
    fn advance(&mut self, end: i64) -> Result<(), WriteError> {
        let _ = end;
        Ok(())
    }

    /// Writes the end of the file.
    ///
    /// # Errors
    /// As [`Encode::write`].
    fn finish(&mut self) -> Result<(), WriteError>;

    /// Describes what was lost, in sentences. Complete after [`Encode::finish`].
    fn lost(&self) -> Vec<String> {
        Vec::new()
    }
}
