//! The interface of a recording format: how it is recognised, read and written.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use usb_davis::capture::{Capture, CaptureError};

use super::encode::OutputFormat;
use super::extras::{Extras, Items};
use super::options::FormatOption;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::options::RecordingOptions;
use crate::reader::Opened;

/// Number of bytes from the start of a file that are examined to find its format.
pub(crate) const HEAD_LENGTH: u64 = 65_536;

/// Result of opening a file for its events.
pub type OpenResult = Result<Opened, RecordingError>;

/// Opens the frames of a file, in file order. Other items may be among them.
pub type OpenFrames = fn(&Path, &RecordingOptions) -> Result<Items, RecordingError>;

/// Opens a reader of frames and IMU samples at the beginning of the file.
pub type OpenExtras = fn(&Path, &RecordingOptions) -> Result<Extras, RecordingError>;

/// Opens a capture of USB transfers.
pub type OpenTransfers = fn(&Path, &RecordingOptions) -> Result<Capture, CaptureError>;

/// A file format that holds events.
///
/// To add a format, write a module with such a constant and add it to [`FORMATS`](super::FORMATS).
pub struct FileFormat {
    /// Name for the user.
    pub name: &'static str,
    /// Returns `true` if the head of a file matches this format.
    pub recognise: fn(&Head) -> bool,
    /// Opens a file of this format for its events.
    pub events: fn(&Path, &RecordingOptions) -> OpenResult,
    /// Returns the files that are read for the recording at this path.
    pub files: fn(&Path) -> Vec<PathBuf>,
    /// Counts the packets and elements of each stream. Empty for formats with a single event stream.
    pub streams: fn(&Path, &RecordingOptions) -> Result<Vec<StreamSummary>, RecordingError>,
    /// Opens the frames, if the format can contain any.
    pub frames: Option<OpenFrames>,
    /// Opens frames and IMU samples for conversion, if the format can contain any.
    pub extras: Option<OpenExtras>,
    /// Opens the USB transfers of a camera, if the format stores them.
    pub transfers: Option<OpenTransfers>,
    /// Writer of the format, if there is one.
    pub output: Option<&'static OutputFormat>,
    /// Options that apply to this format.
    pub uses: Uses,
}

/// Options that apply to a format, in addition to those that apply to all formats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Uses {
    /// The file may contain several streams.
    pub stream: bool,
    /// The file is a table with columns and a time unit.
    pub columns: bool,
    /// The file may contain several devices.
    pub device: bool,
    /// The file can be read while it is written.
    pub growth: bool,
}

impl Uses {
    /// No such options.
    pub const NONE: Self = Self { stream: false, columns: false, device: false, growth: false };

    /// Returns the first of `options` that is given but does not apply.
    pub fn unused(self, options: &RecordingOptions) -> Option<FormatOption> {
        [
            (FormatOption::Stream, self.stream, options.stream.is_some()),
            (FormatOption::Columns, self.columns, options.columns.is_some()),
            (FormatOption::TimeUnit, self.columns, options.time_unit.is_some()),
            (FormatOption::Device, self.device, options.device.is_some()),
            (FormatOption::Growth, self.growth, options.growth.is_some()),
        ]
        .into_iter()
        .find_map(|(option, is_used, is_given)| (is_given && !is_used).then_some(option))
    }

    /// Returns `options` without the options that do not apply.
    pub fn of(self, options: &RecordingOptions) -> RecordingOptions {
        RecordingOptions {
            stream: options.stream.clone().filter(|_| self.stream),
            columns: options.columns.clone().filter(|_| self.columns),
            time_unit: options.time_unit.filter(|_| self.columns),
            device: options.device.filter(|_| self.device),
            growth: options.growth.clone().filter(|_| self.growth),
            ..options.clone()
        }
    }
}

impl FileFormat {
    /// Creates a read-only format with one event stream, without frames or IMU samples.
    pub const fn of_events(
        name: &'static str,
        recognise: fn(&Head) -> bool,
        events: fn(&Path, &RecordingOptions) -> OpenResult,
    ) -> Self {
        let streams = |_: &Path, _: &RecordingOptions| Ok(Vec::new());
        let (files, uses): (fn(&Path) -> Vec<PathBuf>, _) = (|path: &Path| vec![path.to_owned()], Uses::NONE);
        Self {
            name,
            recognise,
            events,
            files,
            streams,
            frames: None,
            extras: None,
            transfers: None,
            output: None,
            uses,
        }
    }
}

/// Content of one stream of a recording.
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
    /// Encoding of the frames, if it is not supported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unread: Option<String>,
}

impl StreamSummary {
    /// Creates the summary of a stream without packets.
    pub(super) fn new(name: String) -> Self {
        Self { name, packets: 0, elements: 0, times_us: None, unread: None }
    }

    /// Extends the time range by a packet whose first and last elements have these times in µs.
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
    /// Reads the beginning of the file at `path`, which must be a regular file.
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

    /// Returns the text at the beginning, up to the last whole line that was read; `None` if the file is not a text
    /// file.
    pub fn text(&self) -> Option<&str> {
        let whole = self.length <= self.bytes.len() as u64;
        let end = if whole { self.bytes.len() } else { self.bytes.iter().rposition(|&byte| byte == b'\n')? + 1 };
        let text = std::str::from_utf8(self.bytes.get(..end)?).ok()?;
        let is_text = |character: char| !character.is_control() || matches!(character, '\t' | '\r' | '\n');
        text.chars().all(is_text).then(|| text.trim_start_matches('\u{feff}'))
    }
}

/// Returns the names of the files in the folder `path` that look like recordings, those with "event" in their name
/// first.
fn recordings_in(path: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()))
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name.rsplit_once('.').is_some_and(|(_, extension)| USUAL_EXTENSIONS.contains(&extension)))
        .collect();
    // The folder may also contain tables of other data.
    names.sort_by_key(|name| (!name.to_lowercase().contains("event"), name.clone()));
    names
}

/// Usual extensions of recordings.
const USUAL_EXTENSIONS: [&str; 17] = [
    "aedat4", "aedat", "dvraw", "raw", "dat", "bag", "mcap", "db3", "h5", "hdf5", "npz", "npy", "csv", "txt", "es",
    "pcap", "pcapng",
];
