//! What a format needs to be written.

use std::fs::File;
use std::io;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use usb_davis::capture::{Capture, CaptureError};
use usb_davis::dump::DumpError;
use usb_davis::protocol::EncodeError;

use super::extras::{Extra, OtherStreams};

/// Why a recording could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The operating system refused.
    #[error("cannot be written: {}", evcal_files::message(.0))]
    Io(#[from] io::Error),
    /// More than a size field can hold.
    #[error("a packet or header is too large for its format")]
    TooLarge,
    /// A DAVIS346 has another sensor.
    #[error("a DAVIS346 has 346x260 pixels; the recording is for a sensor of {}x{}", .0.width, .0.height)]
    Sensor(Sensor),
    /// Columns or rows do not fit.
    #[error("{format} has room for {most} columns and rows; the sensor of the recording has {}x{} pixels", sensor.width, sensor.height)]
    Size {
        /// What is written.
        format: &'static str,
        /// Its largest number of columns or rows.
        most: u16,
        /// That of the recording.
        sensor: Sensor,
    },
    /// A time that the format does not have.
    #[error("ROS has no time of {0} us: times are from 0 on, in ROS 2 before the year 2038; write another format")]
    Time(i64),
    /// Times leap further than a format can follow whose words count time.
    #[error("its times leap from {before} us to {time} us, more than a day, which this format cannot follow")]
    Leap {
        /// The time before.
        before: i64,
        /// That of the event, frame or sample after it.
        time: i64,
    },
    /// A camera could not have sent this.
    #[error("a DAVIS346 could not send this: {0}")]
    Wire(#[from] EncodeError),
    /// A dump refuses it.
    #[error("cannot be written: {0}")]
    Dump(#[from] DumpError),
}

/// Longest leap forward where a format counts all time in words (µs): a day. A time that is wrong would fill the disk.
const LONGEST_LEAP: u64 = 86_400_000_000;

/// Whether a format that counts all time in words can go on from the time `before` to `time` (µs).
///
/// # Errors
/// [`WriteError::Leap`].
pub fn check_leap(before: i64, time: i64) -> Result<(), WriteError> {
    if time > before && time.abs_diff(before) > LONGEST_LEAP {
        return Err(WriteError::Leap { before, time });
    }
    Ok(())
}

/// What is known of a recording before it is written.
#[derive(Clone, Copy, Debug)]
pub struct Description<'a> {
    /// Width and height of the sensor in pixels.
    pub sensor: Sensor,
    /// Model and serial number of the camera; empty if not known.
    pub camera_name: &'a str,
    /// What there will be beside events.
    pub others: OtherStreams,
    /// Time in µs that becomes the zero of a camera's clock, where the format has one.
    pub zero: i64,
}

/// Creates the file and writes what stands before the first event. The file is obtained last, so that none is
/// left behind when the format cannot hold the recording.
pub type CreateFile = fn(&mut dyn FnMut() -> io::Result<File>, &Description) -> Result<Box<dyn Encode>, WriteError>;

/// Copies the USB transfers of a camera to a new file.
pub type CopyTransfers = fn(&mut Capture, File) -> Result<CopiedTransfers, WriteError>;

/// A format to write.
#[derive(Clone, Copy, Debug)]
pub struct OutputFormat {
    /// Name on the command line.
    pub name: &'static str,
    /// Name for the user, where the one on the command line does not tell.
    pub title: Option<&'static str>,
    /// File name extensions that stand for it, in lower case.
    pub extensions: &'static [&'static str],
    /// Whether the size of the sensor is part of it.
    pub holds_sensor: bool,
    /// Whether frames and inertial samples can be kept.
    pub holds_extras: bool,
    /// Creates a file of it.
    pub create: CreateFile,
    /// Copies transfers into it, where it holds those.
    pub copy_transfers: Option<CopyTransfers>,
}

impl PartialEq for OutputFormat {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for OutputFormat {}

/// Transfers that were copied.
#[derive(Debug, Default)]
pub struct CopiedTransfers {
    /// How many.
    pub transfers: u64,
    /// What was lost of them, in a sentence.
    pub lost: Option<String>,
    /// Why reading stopped before the end.
    pub error: Option<CaptureError>,
}

/// Turns events, and what else it has a place for, into the bytes of one format.
pub trait Encode {
    /// Writes `events`, which come after those written before.
    ///
    /// # Errors
    /// When the format cannot hold them or the output refuses.
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError>;

    /// Takes a frame or an inertial sample; false if there is no place for it.
    ///
    /// # Errors
    /// As [`Encode::write`].
    fn extra(&mut self, extra: Extra) -> Result<bool, WriteError> {
        let _ = extra;
        Ok(false)
    }

    /// Everything before `end` (µs) has been given.
    ///
    /// # Errors
    /// As [`Encode::write`].
    fn advance(&mut self, end: i64) -> Result<(), WriteError> {
        let _ = end;
        Ok(())
    }

    /// Writes whatever closes the file.
    ///
    /// # Errors
    /// As [`Encode::write`].
    fn finish(&mut self) -> Result<(), WriteError>;

    /// What could not be kept, in sentences; complete when the file is closed.
    fn lost(&self) -> Vec<String> {
        Vec::new()
    }
}
