//! What can go wrong with a recording.

use std::io;
use std::path::{Path, PathBuf};

use usb_davis::capture::CaptureError;

use super::FORMATS;
use super::columns::LayoutError;
use super::ros::ENCODINGS;
use super::text::LineError;

/// Why a recording could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {kind}", path.display())]
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
    #[error("cannot be read: {error}; {advice}")]
    Missing {
        /// What the system said.
        error: io::Error,
        /// What to do.
        advice: &'static str,
    },
    /// A pipe or device.
    #[error("is not an ordinary file; recordings are read several times, so a pipe has to be saved to a file first")]
    NotAFile,
    /// A directory.
    #[error("is a folder: name the recording in it{0}")]
    Directory(String),
    /// No byte in it.
    #[error("is empty")]
    Empty,
    /// A format that others read.
    #[error("is a {format} file, which is not supported; {advice}")]
    Unsupported {
        /// Its name.
        format: &'static str,
        /// What to do.
        advice: &'static str,
    },
    /// Nothing that we know.
    #[error("is in no format known here (known: {}); was it cut off at its beginning?", known_formats())]
    UnknownFormat,
    /// A header, packet or record that breaks its format.
    #[error("byte {byte}: {what}; {advice}")]
    Damaged {
        /// Offset of the damaged part from the start of the file.
        byte: u64,
        /// What is wrong with it.
        what: String,
        /// What to do.
        advice: &'static str,
    },
    /// A line of text that is no event.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, from 1.
        line: u64,
        /// What is wrong with it, and what to do.
        what: LineError,
    },
    /// An event that no camera sends.
    #[error("event {event}: {what}")]
    Event {
        /// Number of the event, from 1.
        event: u64,
        /// What is wrong with it, and what to do.
        what: String,
    },
    /// An option that means nothing to the format.
    #[error("{option} has no effect on a file of this format ({format}): leave it out")]
    NoEffect {
        /// The option.
        option: &'static str,
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
    #[error(
        "its events are packed with {0}, which is not read: write it anew with h5repack -f GZIP=4 IN OUT, where that compression is installed"
    )]
    Filter(String),
    /// A sensor larger than any event camera.
    #[error(
        "says that its sensor has {width} x {height} pixels, which none has (1 to 32767 each can be read): give the true size with --sensor"
    )]
    Sensor {
        /// Width in pixels.
        width: i64,
        /// Height in pixels.
        height: i64,
    },
    /// An address of a pixel means something only with the size of its sensor.
    #[error("does not say how many pixels its camera has: add --sensor WIDTHxHEIGHT")]
    ChipUnknown,
    /// A camera that writes its addresses in a way that is not known.
    #[error("is of a camera whose addresses are not known here ({0}): save it as text with jAER first")]
    Chip(String),
    /// Packets of events in an encoding that is not read.
    #[error(
        "the events of its topic {topic} are encoded as {encoding:?}, which is not read (known: {}): record them with another encoding",
        ENCODINGS.join(", ")
    )]
    EventEncoding {
        /// Name of the topic.
        topic: String,
        /// The encoding.
        encoding: String,
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
    #[error("holds images of several topics ({0}): choose one with --with-stream")]
    SeveralImageTopics(String),
    /// A topic without an image.
    #[error("has no image in its topic {0}: record that topic again")]
    NoImages(String),
    /// Images of a kind that is not read.
    #[error(
        "has images of {topic} in the encoding {encoding:?}; mono8, mono16, bgr8, rgb8, bayer_*8, bayer_*16, JPEG and PNG are read: convert them"
    )]
    ImageEncoding {
        /// The topic.
        topic: String,
        /// The encoding.
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

/// The names of all formats, for a sentence.
fn known_formats() -> String {
    FORMATS.iter().map(|format| format.name).collect::<Vec<_>>().join(", ")
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
