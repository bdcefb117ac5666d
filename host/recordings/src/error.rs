//! Errors of reading recordings.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use evcal_files::visible;
use usb_davis::capture::CaptureError;

use super::columns::LayoutError;
use super::counted::counted;
use super::options::{Damage, FormatOption, TimeUnit};
use super::text::error::LineError;
use super::unsupported_format::UnsupportedFormat;

/// Limit of the number of events in a file: this constant, plus [`EVENTS_PER_BYTE`] times its size. The densest encodings have
/// 6 events per byte, and noise keeps compression from gaining a factor of 5.
const FEWEST_ALLOWED: u64 = 1 << 24;
const EVENTS_PER_BYTE: u64 = 32;

/// Returns the largest number of events that files with this number of bytes may contain. A few kilobytes that repeat
/// themselves would otherwise fill any memory.
pub(crate) fn most_events(bytes: u64) -> u64 {
    bytes.saturating_mul(EVENTS_PER_BYTE).saturating_add(FEWEST_ALLOWED)
}

/// Error while reading a recording, with the file's path.
#[derive(Debug, thiserror::Error)]
#[error("{}: {kind}", visible::path(path))]
pub struct RecordingError {
    /// Path of the file or folder.
    pub path: PathBuf,
    /// Cause of the error.
    pub kind: RecordingErrorKind,
}

/// Cause of a [`RecordingError`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingErrorKind {
    /// The operating system reported an error.
    #[error("cannot be read: {0}")]
    Io(io::Error),
    /// The file does not exist.
    #[error("cannot be read: {0}")]
    Missing(io::Error),
    /// The file is not the one that was opened: its content, or the file of this name, is another.
    #[error("changed while it was read: copy it, or wait until no other program writes it")]
    Changed,
    /// The path is a pipe or a device.
    #[error("is not an ordinary file; recordings are read several times, so a pipe has to be saved to a file first")]
    NotAFile,
    /// The path is a folder, but not a recording (as the folder of a ROS 2 bag is).
    #[error("is a folder, not a recording")]
    Directory {
        /// Names of files in the folder that may be recordings; those with "event" in their name come first.
        recordings: Vec<String>,
    },
    /// The file has no bytes.
    #[error("is empty")]
    Empty,
    /// The file has a format that is recognised but not supported.
    #[error("is a {0} file, which is not supported")]
    Unsupported(UnsupportedFormat),
    /// The content matches no known format.
    #[error("has an unknown format (known: {}); was it cut off at its beginning?", known.join(", "))]
    UnknownFormat {
        /// Names of the known formats.
        known: Vec<&'static str>,
    },
    /// A header, packet or record violates its format.
    #[error("byte {byte}: {what}; {usable}")]
    Damaged {
        /// Offset of the damaged part from the start of the file.
        byte: u64,
        /// Description of the fault.
        what: String,
        /// Part of the file that can be used nevertheless.
        usable: Usable,
    },
    /// The `metadata.yaml` of a bag is invalid.
    #[error("the list of the files of the bag cannot be read: {0}")]
    BagMetadata(String),
    /// A chunk of an HDF5 file cannot be unpacked.
    #[error("event {event}: its chunk cannot be unpacked ({what}); {}", Usable::Around)]
    DamagedChunk {
        /// Number of its first event, from 1.
        event: u64,
        /// Message of the HDF5 library.
        what: String,
    },
    /// A line of text is not an event.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, from 1.
        line: u64,
        /// Fault of the line.
        what: LineError,
    },
    /// An event has an invalid coordinate, polarity or other value.
    #[error("event {event}: {what}")]
    Event {
        /// Number of the event, from 1.
        event: u64,
        /// Fault of the event.
        what: String,
    },
    /// All compressed parts of the file together are larger than those of files of its size can be.
    #[error("unpacks to more than {most} bytes from {bytes}, which no recording does: its content is a repetition")]
    TooLargeUnpacked {
        /// Limit of their size in bytes.
        most: u64,
        /// Size of the file in bytes.
        bytes: u64,
    },
    /// The file has more events than files of its size can have: its content repeats itself.
    #[error("has more than {most} events in {bytes} bytes, which no recording has: its content is a repetition")]
    TooManyEvents {
        /// Largest number of events in files of this size.
        most: u64,
        /// Size in bytes.
        bytes: u64,
    },
    /// A time is not valid in the unit of the file.
    #[error("event {event}: its time, {value}, is not a number or is out of range (unit: {unit})")]
    EventTime {
        /// Number of the event, from 1.
        event: u64,
        /// Value in the file.
        value: f64,
        /// Expected unit.
        unit: TimeUnit,
    },
    /// An option does not apply to the format.
    #[error("{option} has no effect on a file of this format ({format})")]
    NoEffect {
        /// The option.
        option: FormatOption,
        /// Name of the format.
        format: &'static str,
    },
    /// An array has an unsupported element type.
    #[error(
        "its array {array} holds {what}, which are not supported: write it as whole numbers or as floating-point numbers of 32 or 64 bits"
    )]
    Elements {
        /// Name of the array.
        array: String,
        /// Description of its elements.
        what: &'static str,
    },
    /// An HDF5 compression is not supported.
    #[error("its events are compressed with {0}, which is not supported")]
    Filter(String),
    /// Width or height of the sensor is not between 1 and 32767.
    #[error("states a sensor of {width} x {height} pixels, which is not possible (1 to 32767 each are supported)")]
    Sensor {
        /// Width in pixels.
        width: i64,
        /// Height in pixels.
        height: i64,
    },
    /// The file does not state the size of the sensor, and pixel addresses cannot be decoded without it.
    #[error("does not say how many pixels its camera has")]
    ChipUnknown,
    /// The camera is not supported: its address format is unknown.
    #[error("is from a camera with an unknown address format ({0}): save it as text with jAER first")]
    Chip(String),
    /// Event packets have an unsupported encoding.
    #[error(
            "the events of its topic {topic} are encoded as {encoding:?}, which is not supported (known: {}): record them with another encoding",
        known.join(", ")
    )]
    EventEncoding {
        /// Name of the topic.
        topic: String,
        /// Name of the encoding.
        encoding: String,
        /// Names of the supported encodings.
        known: &'static [&'static str],
    },
    /// The recording has no event stream. The text lists its other content; the text is empty if the recording has no content.
    #[error("{}", without_events(.0))]
    NoEventStream(String),
    /// The requested stream does not exist.
    #[error("has no event stream {wanted:?}; its event streams: {available}")]
    NoSuchStream {
        /// Requested name or number.
        wanted: String,
        /// List of the existing streams.
        available: String,
    },
    /// The requested topic does not exist.
    #[error("has no topic {wanted:?} with events or images; it has {available}")]
    NoSuchTopic {
        /// Requested name.
        wanted: String,
        /// List of the existing topics.
        available: String,
    },
    /// Several topics contain images, so one must be chosen.
    #[error("holds images of several topics ({0})")]
    SeveralImageTopics(String),
    /// A topic contains no image.
    #[error("has no image in its topic {0}: record that topic again")]
    NoImages(String),
    /// Images have an unsupported encoding.
    #[error(
        "has images of {topic} in the encoding {encoding:?}, which is not supported; convert them to mono, bgr, rgb, bgra, rgba or bayer_* of 8 or 16 bits, uyvy, yuyv, nv21, nv24, JPEG or PNG"
    )]
    ImageEncoding {
        /// Name of the topic.
        topic: String,
        /// Name of the encoding.
        encoding: String,
    },
    /// Frames have an unsupported pixel encoding.
    #[error(
            "{} in an unsupported encoding ({encoding}); convert them to mono8 or mono16",
        counted(*.count, "frame is", "frames are")
    )]
    FrameEncoding {
        /// Number of frames.
        count: u64,
        /// Name of the encoding.
        encoding: String,
    },
    /// The size of the images changes.
    #[error("image {image} of {topic} has {} x {} pixels, unlike those before it: record one camera, in one size", size.0, size.1)]
    ImageSize {
        /// Name of the topic.
        topic: String,
        /// Number of the image, from 1.
        image: u64,
        /// Width and height of the image in pixels.
        size: (u16, u16),
    },
    /// Timestamps of images do not increase.
    #[error(
        "image {image} of {topic} has the timestamp {time} µs, which is not later than that of the previous image, {before} µs: let the driver of the camera timestamp each image"
    )]
    ImageTime {
        /// Name of the topic.
        topic: String,
        /// Number of the image, from 1.
        image: u64,
        /// Timestamp of the image in µs.
        time: i64,
        /// Timestamp of the previous image in µs.
        before: i64,
    },
    /// The latest messages of an SQLite database are in a separate file (its write-ahead log).
    #[error("is incomplete: the latest messages are in {log}; merge them with sqlite3 and `PRAGMA wal_checkpoint(TRUNCATE)`", log = log.display())]
    Unmerged {
        /// Path of the separate file.
        log: PathBuf,
    },
    /// A change of an SQLite database was interrupted, and a separate file contains what it replaced.
    #[error("was not written to its end: what its last change replaced is in {journal}; let sqlite3 undo it with `PRAGMA integrity_check`", journal = journal.display())]
    Interrupted {
        /// Path of the separate file.
        journal: PathBuf,
    },
    /// The columns of a text file are ambiguous.
    #[error("{0}")]
    Layout(#[source] LayoutError),
    /// A USB capture cannot be read.
    #[error("{0}")]
    Capture(#[source] CaptureError),
}

/// Usable part of a damaged file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Usable {
    /// Nothing, because the damaged part describes all other parts or contains their positions.
    Nothing,
    /// The part before the damage.
    Before,
    /// The part before the damage and, with [`Damage::Skip`](super::Damage::Skip), the part after it.
    Around,
    /// The part after the damage, with [`Damage::Skip`](super::Damage::Skip).
    After,
    /// Nothing, because no event precedes the damage.
    NoEvents,
}

impl fmt::Display for Usable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Nothing => {
                "nothing can be read, because the damaged part describes the others or says where they are"
            }
            Self::Before => "the events before it can be used",
            Self::Around => "the events before it can be used, and the events after it if damage is skipped",
            Self::After => "no events are before it, but the events after it can be used if damage is skipped",
            Self::NoEvents => "no events are before it",
        })
    }
}

impl RecordingErrorKind {
    /// Returns `true` if the file contains more than files of its size can contain. Its events are of no use, and each further pass
    /// takes as long as the first.
    pub fn is_repetition(&self) -> bool {
        matches!(self, Self::TooManyEvents { .. } | Self::TooLargeUnpacked { .. })
    }

    /// Creates the error of a file of this size with too many events.
    pub(crate) fn too_many(bytes: u64) -> Self {
        Self::TooManyEvents { most: most_events(bytes), bytes }
    }
}

impl RecordingError {
    pub(crate) fn new(path: &Path, kind: RecordingErrorKind) -> Self {
        Self { path: path.to_owned(), kind }
    }

    /// Creates an error about a part of the file that violates its format.
    pub(crate) fn damaged(path: &Path, byte: u64, what: impl Into<String>, usable: Usable) -> Self {
        Self::new(path, RecordingErrorKind::Damaged { byte, what: what.into(), usable })
    }

    /// `true` if a part of the file violates its format.
    pub(crate) fn is_damage(&self) -> bool {
        matches!(self.kind, RecordingErrorKind::Damaged { .. })
    }

    /// `true` if this is damage that is to be skipped.
    pub(crate) fn is_skipped(&self, damage: Damage) -> bool {
        damage == Damage::Skip && self.is_damage()
    }

    /// Returns the error as that of a recording without events before the damage.
    pub(crate) fn of_the_start(mut self) -> Self {
        if let RecordingErrorKind::Damaged { usable, .. } = &mut self.kind {
            *usable = match *usable {
                Usable::Around => Usable::After,
                Usable::Before => Usable::NoEvents,
                other => other,
            };
        }
        self
    }

    /// Creates the error of a file that cannot be read.
    pub fn io(path: &Path, error: io::Error) -> Self {
        Self::new(path, RecordingErrorKind::Io(error))
    }
}

/// Treats damage as the end of the file, where the reader of the events reports the damage.
pub(crate) fn up_to_damage<T>(read: Result<Option<T>, RecordingError>) -> Result<Option<T>, RecordingError> {
    read.or_else(|error| if error.is_damage() { Ok(None) } else { Err(error) })
}

/// Describes a recording without events.
fn without_events(content: &str) -> String {
    match content {
        "" => "is a recording without content: give the path of one with events".to_owned(),
        content => format!("holds no events, only {content}; give the path of a recording with events"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_content_of_a_recording_without_events_is_named() {
        for (content, message) in [
            ("", "is a recording without content: give the path of one with events"),
            ("0 frames (FRME)", "holds no events, only 0 frames (FRME); give the path of a recording with events"),
        ] {
            assert_eq!(RecordingErrorKind::NoEventStream(content.to_owned()).to_string(), message);
        }
    }
}
