//! What can go wrong with a recording.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use evcal_files::visible;
use usb_davis::capture::CaptureError;

use super::columns::LayoutError;
use super::counted::counted;
use super::foreign::ForeignFormat;
use super::options::{FormatOption, TimeUnit};
use super::text::error::LineError;

/// Why a recording could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {kind}", visible::path(path))]
pub struct RecordingError {
    /// The file.
    pub path: PathBuf,
    /// What happened.
    pub kind: RecordingErrorKind,
}

/// What happened to a recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingErrorKind {
    /// The operating system refused.
    #[error("cannot be read: {0}")]
    Io(io::Error),
    /// There is no such file.
    #[error("cannot be read: {0}")]
    Missing(io::Error),
    /// A pipe or device.
    #[error("is not an ordinary file; recordings are read several times, so a pipe has to be saved to a file first")]
    NotAFile,
    /// A directory.
    #[error("is a folder, and no recording")]
    Directory {
        /// Names of the files in it that may be recordings, those of events first.
        recordings: Vec<String>,
    },
    /// No byte in it.
    #[error("is empty")]
    Empty,
    /// A format that others read.
    #[error("is a {0} file, which is not supported")]
    Unsupported(ForeignFormat),
    /// Nothing that we know.
    #[error("is in no format known here (known: {}); was it cut off at its beginning?", known.join(", "))]
    UnknownFormat {
        /// Names of the formats that are.
        known: Vec<&'static str>,
    },
    /// A header, packet or record that breaks its format.
    #[error("byte {byte}: {what}; {usable}")]
    Damaged {
        /// Offset of the damaged part from the start of the file.
        byte: u64,
        /// What is wrong with it.
        what: String,
        /// What can be used all the same.
        usable: Usable,
    },
    /// The list of the files of a bag cannot be understood.
    #[error("the list of the files of the bag cannot be read: {0}")]
    BagMetadata(String),
    /// A chunk of an HDF5 file cannot be unpacked.
    #[error("event {event}: its chunk cannot be unpacked ({what}); {}", Usable::Around)]
    DamagedChunk {
        /// Number of its first event, from 1.
        event: u64,
        /// What the library of HDF5 said.
        what: String,
    },
    /// A line of text that is no event.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, from 1.
        line: u64,
        /// What is wrong with it.
        what: LineError,
    },
    /// An event that no camera sends.
    #[error("event {event}: {what}")]
    Event {
        /// Number of the event, from 1.
        event: u64,
        /// What is wrong with it.
        what: String,
    },
    /// A time that is none in the unit of the file.
    #[error("event {event}: its time, {value}, is not a time in {unit}")]
    EventTime {
        /// Number of the event, from 1.
        event: u64,
        /// What stands there.
        value: f64,
        /// The unit expected.
        unit: TimeUnit,
    },
    /// An option that means nothing to the format.
    #[error("{option} has no effect on a file of this format ({format})")]
    NoEffect {
        /// The option.
        option: FormatOption,
        /// Name of the format.
        format: &'static str,
    },
    /// A column whose elements are not read.
    #[error(
        "its array {array} holds {what}, which are not read: write it as whole numbers or as floating-point numbers of 32 or 64 bits"
    )]
    Elements {
        /// Its name.
        array: String,
        /// What its elements are.
        what: &'static str,
    },
    /// A compression of HDF5 that is not read.
    #[error("its events are packed with {0}, which is not read")]
    Filter(String),
    /// A sensor larger than any event camera.
    #[error("says that its sensor has {width} x {height} pixels, which none has (1 to 32767 each can be read)")]
    Sensor {
        /// Width in pixels.
        width: i64,
        /// Height in pixels.
        height: i64,
    },
    /// An address of a pixel means something only with the size of its sensor.
    #[error("does not say how many pixels its camera has")]
    ChipUnknown,
    /// A camera that writes its addresses in a way that is not known.
    #[error("is of a camera whose addresses are not known here ({0}): save it as text with jAER first")]
    Chip(String),
    /// Packets of events in an encoding that is not read.
    #[error(
        "the events of its topic {topic} are encoded as {encoding:?}, which is not read (known: {}): record them with another encoding",
        known.join(", ")
    )]
    EventEncoding {
        /// Name of the topic.
        topic: String,
        /// The encoding.
        encoding: String,
        /// Those that are read.
        known: &'static [&'static str],
    },
    /// No stream of events, but this; empty where there is nothing.
    #[error("{}", without_events(.0))]
    NoEventStream(String),
    /// The stream asked for is not there.
    #[error("has no event stream {wanted:?}; its event streams: {available}")]
    NoSuchStream {
        /// Name or number asked for.
        wanted: String,
        /// Those that exist.
        available: String,
    },
    /// The topic asked for is not there.
    #[error("has no topic {wanted:?} with events or images; it has {available}")]
    NoSuchTopic {
        /// Its name.
        wanted: String,
        /// Those that exist.
        available: String,
    },
    /// Images of several cameras.
    #[error("holds images of several topics ({0})")]
    SeveralImageTopics(String),
    /// A topic without an image.
    #[error("has no image in its topic {0}: record that topic again")]
    NoImages(String),
    /// Images of a kind that is not read.
    #[error(
        "has images of {topic} in the encoding {encoding:?}; mono, bgr, rgb, bgra, rgba and bayer_* of 8 and 16 bits, uyvy, yuyv, nv21, nv24, JPEG and PNG are read: convert them"
    )]
    ImageEncoding {
        /// The topic.
        topic: String,
        /// The encoding.
        encoding: String,
    },
    /// Frames of the camera whose pixels are stored in a way that is not read.
    #[error(
        "{} in an encoding that is not read ({encoding}); convert them to mono8 or mono16",
        counted(*.count, "frame is", "frames are")
    )]
    FrameEncoding {
        /// How many.
        count: u64,
        /// Name of the encoding.
        encoding: String,
    },
    /// An image has another size than those before it.
    #[error("image {image} of {topic} has {} x {} pixels, those before it another size: record one camera, in one size", size.0, size.1)]
    ImageSize {
        /// The topic.
        topic: String,
        /// Number of the image, from 1.
        image: u64,
        /// Its width and height.
        size: (u16, u16),
    },
    /// Time stamps of images stand still or go back.
    #[error(
        "image {image} of {topic} is stamped {time} µs, not after {before} µs of the image before it: let the driver of the camera stamp each image"
    )]
    ImageTime {
        /// The topic.
        topic: String,
        /// Number of the image, from 1.
        image: u64,
        /// Its time stamp.
        time: i64,
        /// That of the image before.
        before: i64,
    },
    /// A database of which the latest part is in another file.
    #[error("is not whole: the latest messages are in {log}; merge them with sqlite3 and `PRAGMA wal_checkpoint(TRUNCATE)`", log = log.display())]
    Unmerged {
        /// The other file.
        log: PathBuf,
    },
    /// The columns of a text file are not clear.
    #[error("{0}")]
    Layout(#[source] LayoutError),
    /// A recording of USB transfers cannot be read.
    #[error("{0}")]
    Capture(#[source] CaptureError),
}

/// What of a damaged file can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Usable {
    /// Nothing: what is damaged says where the rest is.
    Nothing,
    /// What stands before the damage.
    Before,
    /// What stands before the damage and, with [`Damage::Skip`](super::Damage::Skip), what stands behind it.
    Around,
}

impl fmt::Display for Usable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Nothing => "nothing can be read without it",
            Self::Before => "the events before it can be used",
            Self::Around => "the events before it can be used, and those behind it where damage is left out",
        })
    }
}

impl RecordingError {
    pub(crate) fn new(path: &Path, kind: RecordingErrorKind) -> Self {
        Self { path: path.to_owned(), kind }
    }

    pub(crate) fn io(path: &Path, error: io::Error) -> Self {
        Self::new(path, RecordingErrorKind::Io(error))
    }
}

/// What a recording without events holds.
fn without_events(held: &str) -> String {
    match held {
        "" => "holds nothing at all: name a recording that has events".to_owned(),
        held => format!("holds no events, only {held}; name a recording that has some"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_recording_without_events_holds_is_told() {
        for (held, told) in [
            ("", "holds nothing at all: name a recording that has events"),
            ("0 frames (FRME)", "holds no events, only 0 frames (FRME); name a recording that has some"),
        ] {
            assert_eq!(RecordingErrorKind::NoEventStream(held.to_owned()).to_string(), told);
        }
    }
}
