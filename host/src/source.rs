//! Recordings: files of events in any of the formats listed in [`FORMATS`].
//!
//! - The format is found from the content of a file, not from its name ([`sniff`]).
//! - Readers stream: [`Recording::open`] starts a new pass from the beginning, and
//!   [`EventReader::next_batch`] hands out a few ten thousand events at a time. Nothing holds the
//!   whole recording.
//! - A file that ends too early is read to its last whole event or packet, and [`ReadReport::truncated`]
//!   tells what was lost. A damaged packet is an error that names its byte; everything before it
//!   has been handed out by then.
//! - No content of a file makes a reader panic.
//!
//! Times are those of the file, in microseconds, non-decreasing (see [`EventReader::next_batch`]);
//! pixel (0, 0) is the top-left one.
//!
//! A new format is one file with a [`Format`] in it and one line in [`FORMATS`].

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

pub mod aedat4;
pub mod davis;
mod error;
pub mod event_calib;
mod foreign;
mod options;
mod reader;
pub mod text;
pub mod write;

pub use error::{SourceError, SourceErrorKind};
pub use options::{Column, Columns, Damage, OptionError, SourceOptions, TimeUnit};
pub use reader::{Decode, EventReader, ReadReport, Truncation};

use crate::circle_track;

/// The formats, in the order in which they are tried.
pub const FORMATS: &[&Format] =
    &[&aedat4::FORMAT, &davis::FORMAT, &text::FORMAT, &event_calib::FORMAT, &davis::BARE_FORMAT];

/// The largest sensor width or height that can be read.
pub const MAX_SENSOR_SIZE: u16 = 32_767;

/// How many bytes of a file are looked at to find its format.
const HEAD_LENGTH: u64 = 65_536;

/// A file format that holds events.
pub struct Format {
    /// Name for the user.
    pub name: &'static str,
    /// Whether a file that begins like this is of this format.
    pub recognise: fn(&Head) -> bool,
    /// Starts reading a file of this format from its beginning.
    pub open: fn(&Path, &SourceOptions) -> Result<Box<dyn Decode>, SourceError>,
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
    pub fn read(path: &Path) -> Result<Self, SourceError> {
        let io = |error| SourceError::io(path, error);
        let metadata = std::fs::metadata(path).map_err(io)?;
        if !metadata.is_file() {
            return Err(SourceError::new(path, SourceErrorKind::NotAFile));
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

/// What a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingKind {
    /// Events, in the format of this name.
    Events {
        /// [`Format::name`].
        format: &'static str,
    },
    /// Circles that a detector found: see [`crate::circle_track`].
    CircleTrack,
}

/// What the file at `path` holds, found from its content.
///
/// # Errors
/// When the file cannot be read, is empty, or is of no known format.
pub fn sniff(path: &Path) -> Result<RecordingKind, SourceError> {
    let head = Head::read(path)?;
    if head.text().is_some_and(circle_track::is_circle_track) {
        return Ok(RecordingKind::CircleTrack);
    }
    Ok(RecordingKind::Events { format: find_format(path, &head)?.name })
}

fn find_format(path: &Path, head: &Head) -> Result<&'static Format, SourceError> {
    if head.bytes.is_empty() {
        return Err(SourceError::new(path, SourceErrorKind::Empty));
    }
    if let Some((format, advice)) = foreign::recognise(&head.bytes) {
        return Err(SourceError::new(path, SourceErrorKind::Unsupported { format, advice }));
    }
    FORMATS
        .iter()
        .find(|format| (format.recognise)(head))
        .copied()
        .ok_or_else(|| SourceError::new(path, SourceErrorKind::UnknownFormat))
}

/// What is known of a recording before its first event is read.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceInformation {
    /// Name of the format.
    pub format: &'static str,
    /// Width and height of the sensor in pixels: from [`SourceOptions::sensor`], else from the file.
    pub sensor: Option<(u16, u16)>,
    /// Model and serial number of the camera, as the file gives it.
    pub camera_name: Option<String>,
    /// What the reader took for granted or noticed, in sentences for the user.
    pub notes: Vec<String>,
}

/// A file of events that can be read as often as needed.
#[derive(Clone)]
pub struct Recording {
    path: PathBuf,
    options: SourceOptions,
    format: &'static Format,
}

impl Recording {
    /// Finds the format of the file at `path`.
    ///
    /// # Errors
    /// When the file cannot be read, is empty, holds no events or is of no known format.
    pub fn new(path: impl Into<PathBuf>, options: SourceOptions) -> Result<Self, SourceError> {
        let path = path.into();
        let head = Head::read(&path)?;
        if head.text().is_some_and(circle_track::is_circle_track) {
            return Err(SourceError::new(&path, SourceErrorKind::CircleTrack));
        }
        let format = find_format(&path, &head)?;
        Ok(Self { path, options, format })
    }

    /// Where the recording is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Name of its format.
    pub fn format(&self) -> &'static str {
        self.format.name
    }

    /// Starts a pass through the recording, from its first event.
    ///
    /// # Errors
    /// When the file cannot be opened or its header cannot be understood.
    pub fn open(&self) -> Result<EventReader, SourceError> {
        let decoder = (self.format.open)(&self.path, &self.options)?;
        EventReader::new(&self.path, decoder, &self.options)
    }
}
