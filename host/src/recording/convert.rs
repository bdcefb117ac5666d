//! From one format of recordings to another.
//!
//! Events go through the same reader as for a calibration, so that a converted recording calibrates
//! as the original does. Frames and inertial samples are kept where both formats hold them; the
//! report names what is not.

pub(crate) mod extras;
mod sink;
mod transfers;

use std::fmt;
use std::path::{Path, PathBuf};

use evcal_core::event::Event;
use serde::Serialize;
use usb_davis::capture::CaptureError;

use crate::recording::aedat4::header::Compression;
use crate::recording::write::{OutputFormat, WriteError};
use crate::recording::{EventReader, ReadReport, Recording, RecordingError};
use evcal_core::sensor::Sensor;
use extras::{Extra, Extras};
use sink::Sink;

/// A format to convert to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// What a DAVIS346 sends over USB.
    Dvraw,
    /// Events, with frames and inertial samples if it is AEDAT4.
    Events(OutputFormat),
}

impl Target {
    /// The format that the extension of `path` stands for: `.dvraw`, or one of
    /// [`OutputFormat::from_extension`].
    pub fn from_extension(path: &Path) -> Result<Self, ConvertError> {
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("dvraw")) {
            return Ok(Self::Dvraw);
        }
        OutputFormat::from_extension(path).map(Self::Events).map_err(|_| ConvertError::Extension(path.to_owned()))
    }

    /// Whether frames and inertial samples can be kept.
    const fn holds_more_than_events(self) -> bool {
        matches!(self, Self::Dvraw | Self::Events(OutputFormat::Aedat4(_)))
    }
}

/// From when times count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeOrigin {
    /// As in the recording.
    #[default]
    Kept,
    /// From 1970, by the time at which a recording of a camera began.
    Unix,
}

/// What was converted.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ConversionReport {
    /// Events written, as far as they were decoded.
    pub events: u64,
    /// Frames written.
    pub frames: u64,
    /// Inertial samples written.
    pub inertial_samples: u64,
    /// Transfers copied, where both formats are those of the camera's stream.
    pub transfers: u64,
    /// What the output does not hold, or holds otherwise, in sentences.
    pub lost: Vec<String>,
    /// What the reader met.
    pub report: ReadReport,
    /// What the reader took for granted.
    pub notes: Vec<String>,
    /// Why reading stopped before the end; what came before is in the output.
    pub error: Option<String>,
}

/// Why nothing was converted.
#[derive(Debug, thiserror::Error)]
pub enum ConvertError {
    /// The recording cannot be opened.
    #[error(transparent)]
    Source(#[from] RecordingError),
    /// The camera's stream cannot be read.
    #[error("{}: {error}", path.display())]
    Capture {
        /// The recording.
        path: PathBuf,
        /// Why.
        error: CaptureError,
    },
    /// The output cannot be written.
    #[error("{}: {error}", path.display())]
    Write {
        /// The output.
        path: PathBuf,
        /// Why.
        error: WriteError,
    },
    /// No format has this extension.
    #[error("{}: unknown extension; use .dvraw, .aedat4, .csv, .txt or .bin, or name the format with --to", .0.display())]
    Extension(PathBuf),
    /// The output is there already.
    #[error("{} is there already and is not overwritten: choose another name", .0.display())]
    Exists(PathBuf),
    /// The sensor size is not known.
    #[error("{} does not say how many pixels the sensor has: add --sensor WIDTHxHEIGHT", .0.display())]
    SensorUnknown(PathBuf),
    /// The recording does not say when it began.
    #[error("{} does not say when it began: times cannot count from 1970", .0.display())]
    StartUnknown(PathBuf),
}

/// What comes later than this after the last event has a damaged time (µs).
const AFTERWARDS: i64 = 60_000_000;

/// Names of the formats that hold what a camera sends.
const CAMERA_STREAMS: [&str; 2] = [crate::recording::davis::FORMAT.name, crate::recording::davis::BARE_FORMAT.name];

/// What is done to a recording on its way.
pub struct Change<'a> {
    /// Changes a batch of events; times must stay in order.
    pub events: &'a mut dyn FnMut(&mut Vec<Event>),
    /// Changes a frame or an inertial sample, not its times.
    pub(crate) extra: &'a mut dyn FnMut(&mut Extra),
}

/// Writes the content of `recording` to a new file at `path`. `progress` is told the number of events
/// done.
///
/// # Errors
/// [`ConvertError`] if it cannot begin or the output cannot be written. Should the recording break
/// off, what came before is written, and the report says so.
pub fn convert(
    recording: &Recording,
    path: &Path,
    target: Target,
    origin: TimeOrigin,
    progress: impl FnMut(u64),
) -> Result<ConversionReport, ConvertError> {
    let from_camera = CAMERA_STREAMS.contains(&recording.format());
    if from_camera && target == Target::Dvraw && !path.exists() {
        return transfers::copy(recording.path(), path);
    }
    let unchanged = Change { events: &mut |_| {}, extra: &mut |_| {} };
    convert_changed(recording, path, target, origin, unchanged, progress)
}

/// As [`convert`], of a recording that is changed on its way: transfers of a camera are never copied.
///
/// # Errors
/// As there.
pub fn convert_changed(
    recording: &Recording,
    path: &Path,
    target: Target,
    origin: TimeOrigin,
    change: Change,
    mut progress: impl FnMut(u64),
) -> Result<ConversionReport, ConvertError> {
    if path.exists() {
        return Err(ConvertError::Exists(path.to_owned()));
    }
    let mut reader = recording.open()?;
    let mut events = Vec::new();
    let mut report = ConversionReport::default();
    let mut more = next(&mut reader, &mut events, &mut report);
    let mut extras = match target.holds_more_than_events() {
        true => Extras::open(recording.path(), recording.format())?,
        false => Extras::none(),
    };
    let shift = match origin {
        TimeOrigin::Kept => 0,
        TimeOrigin::Unix => extras::start(recording.path(), recording.format())?
            .ok_or_else(|| ConvertError::StartUnknown(recording.path().to_owned()))?,
    };
    let zero = zero(events.first().map(|event| event.t), extras.first_time());
    let failed = |error| ConvertError::Write { path: path.to_owned(), error };
    let information = reader.information();
    let sensor = match (information.sensor, target) {
        (Some(sensor), _) => sensor,
        // It holds no sensor size.
        (None, Target::Events(OutputFormat::EventCalib)) => Sensor::new(0, 0),
        (None, _) => return Err(ConvertError::SensorUnknown(recording.path().to_owned())),
    };
    let camera_name = information.camera_name.as_deref().unwrap_or_default();
    let mut sink = Sink::create(path, target, sensor, camera_name, extras.held(), zero).map_err(failed)?;
    let mut latest = zero;
    while more {
        let last = events.last().map_or(latest, |event| event.t);
        latest = last;
        events.iter_mut().for_each(|event| event.t = event.t.saturating_add(shift));
        (change.events)(&mut events);
        sink.events(&events).map_err(failed)?;
        report.events += events.len() as u64;
        while let Some(mut extra) = extras.next_until(last, &mut report.lost) {
            (change.extra)(&mut extra);
            sink.extra(extra.later(shift)).map_err(failed)?;
        }
        sink.advance(last.saturating_add(shift)).map_err(failed)?;
        progress(reader.report().events);
        more = next(&mut reader, &mut events, &mut report);
    }
    let end = latest.saturating_add(AFTERWARDS);
    while let Some(mut extra) = extras.next_until(end, &mut report.lost) {
        (change.extra)(&mut extra);
        sink.extra(extra.later(shift)).map_err(failed)?;
    }
    if extras.next_until(i64::MAX, &mut report.lost).is_some() {
        report.lost.push("frames or inertial samples more than a minute after the last event".to_owned());
    }
    let written = sink.finish(&mut report.lost).map_err(failed)?;
    report.report = reader.report().clone();
    report.notes = reader.information().notes.clone();
    (report.frames, report.inertial_samples) = (written.frames, written.inertial_samples);
    let left_out = extras.left_out(&report.report);
    report.lost.extend(left_out);
    Ok(report)
}

/// Time that becomes the zero of a camera's clock: 0 as long as the events begin in the hour after it,
/// else the first time of all. The camera's stream spends a word on every 33 ms before.
fn zero(events: Option<i64>, extras: Option<i64>) -> i64 {
    const LATEST_START: i64 = 3_600_000_000;
    let first = events.into_iter().chain(extras).min().unwrap_or(0);
    if (0..LATEST_START).contains(&events.unwrap_or(first)) { 0 } else { first }
}

/// The next events; false at the end, which may be an error.
fn next(reader: &mut EventReader, events: &mut Vec<Event>, report: &mut ConversionReport) -> bool {
    reader.next_batch(events).unwrap_or_else(|error| {
        report.error = Some(error.to_string());
        false
    })
}

/// Formats by their names on the command line.
impl std::str::FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "dvraw" => Ok(Self::Dvraw),
            "aedat4" => Ok(Self::Events(OutputFormat::Aedat4(Compression::Zstd))),
            "csv" => Ok(Self::Events(OutputFormat::Text)),
            "bin" => Ok(Self::Events(OutputFormat::EventCalib)),
            _ => Err("write dvraw, aedat4, csv or bin (EventCalib)".to_owned()),
        }
    }
}

impl fmt::Display for ConversionReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.transfers > 0 {
            write!(f, "{} transfers as they were", self.transfers)?;
        } else {
            write!(f, "{} events", self.events)?;
            if self.frames > 0 || self.inertial_samples > 0 {
                write!(f, ", {} frames, {} inertial samples", self.frames, self.inertial_samples)?;
            }
        }
        let warnings = self.report.stream.notes();
        for (name, texts) in [("not kept", &self.lost), ("warning", &warnings), ("note", &self.notes)] {
            texts.iter().try_for_each(|text| write!(f, "\n{name}: {text}"))?;
        }
        Ok(())
    }
}
