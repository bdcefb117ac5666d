//! What a format of recordings can do, and how it is told from others.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use usb_davis::capture::{Capture, CaptureError};

use super::encode::OutputFormat;
use super::extras::ReadExtras;
use super::options::FormatOption;
use super::pictures::TimedImage;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::options::RecordingOptions;
use crate::reader::Decode;

/// How many bytes of a file are looked at to find its format.
const HEAD_LENGTH: u64 = 65_536;

/// A decoder at the beginning of its file.
pub type Opened = Result<Box<dyn Decode>, RecordingError>;

/// Hands the frames of a file, in their order, to a visitor. The inner error ended them early.
pub type VisitFrames =
    fn(&Path, &RecordingOptions, &mut dyn FnMut(TimedImage)) -> Result<Result<(), RecordingError>, RecordingError>;

/// A reader of frames and inertial samples at the beginning of its file.
pub type OpenExtras = fn(&Path, &RecordingOptions) -> Result<Box<dyn ReadExtras>, RecordingError>;

/// Opens a file for its USB transfers.
pub type OpenTransfers = fn(&Path, &RecordingOptions) -> Result<Capture, CaptureError>;

/// A file format that holds events.
///
/// Adding one takes a module with such a constant and a line in [`FORMATS`](super::FORMATS).
pub struct FileFormat {
    /// Name for the user.
    pub name: &'static str,
    /// Whether a file that begins like this is of this format.
    pub recognise: fn(&Head) -> bool,
    /// Starts reading the events of a file of this format from its beginning.
    pub events: fn(&Path, &RecordingOptions) -> Opened,
    /// Counts what the streams of such a file hold; empty where there is but one stream of events.
    pub streams: fn(&Path, &RecordingOptions) -> Result<Vec<StreamSummary>, RecordingError>,
    /// Shows the frames, where the format holds them.
    pub frames: Option<VisitFrames>,
    /// Reads frames and inertial samples to convert them, where the format holds them.
    pub extras: Option<OpenExtras>,
    /// Reads USB transfers, where the format holds those of a camera.
    pub transfers: Option<OpenTransfers>,
    /// How the format is written, where it is.
    pub output: Option<&'static OutputFormat>,
    /// Which options mean something to it.
    pub uses: Uses,
}

/// Which options mean something to a format, beside those that do to all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Uses {
    /// There may be several streams.
    pub stream: bool,
    /// Columns and unit of the times.
    pub columns: bool,
    /// There may be several devices.
    pub device: bool,
}

impl Uses {
    /// None of them.
    pub const NONE: Self = Self { stream: false, columns: false, device: false };

    /// The first of `options` that is given and means nothing.
    pub fn unused(self, options: &RecordingOptions) -> Option<FormatOption> {
        [
            (FormatOption::Stream, self.stream, options.stream.is_some()),
            (FormatOption::Columns, self.columns, options.columns.is_some()),
            (FormatOption::TimeUnit, self.columns, options.time_unit.is_some()),
            (FormatOption::Device, self.device, options.device.is_some()),
        ]
        .into_iter()
        .find_map(|(option, is_used, is_given)| (is_given && !is_used).then_some(option))
    }

    /// `options` without those that mean nothing.
    pub fn of(self, options: &RecordingOptions) -> RecordingOptions {
        RecordingOptions {
            stream: options.stream.clone().filter(|_| self.stream),
            columns: options.columns.clone().filter(|_| self.columns),
            time_unit: options.time_unit.filter(|_| self.columns),
            device: options.device.filter(|_| self.device),
            ..options.clone()
        }
    }
}

impl FileFormat {
    /// A format with one stream of events and nothing beside it, which is read but not written.
    pub const fn of_events(
        name: &'static str,
        recognise: fn(&Head) -> bool,
        events: fn(&Path, &RecordingOptions) -> Opened,
    ) -> Self {
        let streams = |_: &Path, _: &RecordingOptions| Ok(Vec::new());
        let uses = Uses::NONE;
        Self { name, recognise, events, streams, frames: None, extras: None, transfers: None, output: None, uses }
    }
}

/// How much one stream of a recording holds.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct StreamSummary {
    /// Number, name and kind of the stream.
    pub name: String,
    /// Number of packets.
    pub packets: u64,
    /// Number of events, frames, samples or triggers.
    pub elements: u64,
    /// Times of the first and the last element in µs.
    pub times_us: Option<(i64, i64)>,
    /// Encoding of its frames, if that is not read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unread: Option<String>,
}

impl StreamSummary {
    /// A stream in which nothing was counted yet.
    pub(super) fn new(name: String) -> Self {
        Self { name, packets: 0, elements: 0, times_us: None, unread: None }
    }

    /// Takes note of a packet whose first and last elements have these times in µs.
    pub(super) fn extend(&mut self, times: Option<(i64, i64)>) {
        self.times_us = match (self.times_us, times) {
            (Some((first, _)), Some((_, last))) => Some((first, last)),
            (earlier, later) => earlier.or(later),
        };
    }
}

/// The beginning of a file.
pub struct Head {
    /// The first 64 KiB of the file, or all of it.
    pub bytes: Vec<u8>,
    /// Length of the whole file in bytes.
    pub length: u64,
}

impl Head {
    /// Reads the beginning of the file at `path`, which must be an ordinary file.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        let io = |error: io::Error| match error.kind() {
            io::ErrorKind::NotFound => RecordingError::new(path, RecordingErrorKind::Missing(error)),
            _ => RecordingError::io(path, error),
        };
        let metadata = std::fs::metadata(path).map_err(io)?;
        if metadata.is_dir() {
            return Err(RecordingError::new(path, RecordingErrorKind::Directory { recordings: recordings_in(path) }));
        }
        if !metadata.is_file() {
            return Err(RecordingError::new(path, RecordingErrorKind::NotAFile));
        }
        let mut bytes = Vec::new();
        File::open(path).map_err(io)?.take(HEAD_LENGTH).read_to_end(&mut bytes).map_err(io)?;
        Ok(Self { bytes, length: metadata.len() })
    }

    /// The text that the file begins with, up to the last whole line read, if it is a text file.
    pub fn text(&self) -> Option<&str> {
        let whole = self.length <= self.bytes.len() as u64;
        let end = if whole { self.bytes.len() } else { self.bytes.iter().rposition(|&byte| byte == b'\n')? + 1 };
        let text = std::str::from_utf8(self.bytes.get(..end)?).ok()?;
        let is_text = |character: char| !character.is_control() || matches!(character, '\t' | '\r' | '\n');
        text.chars().all(is_text).then(|| text.trim_start_matches('\u{feff}'))
    }
}

/// The recordings in the folder `path` by their names, those of events first.
fn recordings_in(path: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()))
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name.rsplit_once('.').is_some_and(|(_, extension)| USUAL_EXTENSIONS.contains(&extension)))
        .collect();
    // Beside the events may lie other tables.
    names.sort_by_key(|name| (!name.to_lowercase().contains("event"), name.clone()));
    names
}

/// How names of recordings usually end.
const USUAL_EXTENSIONS: [&str; 17] = [
    "aedat4", "aedat", "dvraw", "raw", "dat", "bag", "mcap", "db3", "h5", "hdf5", "npz", "npy", "csv", "txt", "es",
    "pcap", "pcapng",
];
