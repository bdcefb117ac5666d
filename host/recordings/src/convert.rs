//! From one format of recordings to another.
//!
//! Events go through the same reader as for a calibration, so that a converted recording calibrates
//! as the original does. Frames and inertial samples are kept where both formats hold them; the
//! report names what is not.

use std::fmt;
use std::path::{Path, PathBuf};

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use serde::{Serialize, Serializer};
use usb_davis::capture::CaptureError;

use super::encode::{CopyTransfers, Description, Encode, OutputFormat, WriteError};
use super::extras::{Extra, NoExtras, left_out};
use super::given_sensor::{OtherSensor, check_outside, check_stated};
use super::likely_sensor::{likely_sensor_of, likely_words};
use super::write::output_extensions;
use crate::error::RecordingError;
use crate::format::OpenTransfers;
use crate::read_report::ReadReport;
use crate::reader::EventReader;
use crate::recording::Recording;
use evcal_files::{FileError, NewFile};

/// The format that the extension of `path` stands for.
///
/// # Errors
/// [`ConvertError::Extension`] when there is none.
pub fn output_of(path: &Path) -> Result<OutputFormat, ConvertError> {
    OutputFormat::from_extension(path).ok_or_else(|| ConvertError::Extension(path.to_owned()))
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
#[derive(Debug, Default, Serialize)]
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
    #[serde(serialize_with = "as_text")]
    pub error: Option<ConvertError>,
}

/// Why nothing was converted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConvertError {
    /// The recording cannot be opened.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// The sensor that was asked for is not that of the recording.
    #[error("{0}")]
    OtherSensor(#[from] OtherSensor),
    /// The camera's stream cannot be read.
    #[error("{}: {error}", path.display())]
    Capture {
        /// The recording.
        path: PathBuf,
        /// Why.
        #[source]
        error: CaptureError,
    },
    /// The output cannot be written.
    #[error("{}: {error}", path.display())]
    Write {
        /// The output.
        path: PathBuf,
        /// Why.
        #[source]
        error: WriteError,
    },
    /// No format has this extension.
    #[error("{}: unknown extension; known are {}", .0.display(), output_extensions())]
    Extension(PathBuf),
    /// The sensor size is not known.
    #[error("{} does not say how many pixels the sensor has{}", file.display(), likely_words(*likely))]
    SensorUnknown {
        /// The recording.
        file: PathBuf,
        /// The smallest usual sensor that has all its pixels.
        likely: Option<Sensor>,
    },
    /// Reading stopped before there was anything to write.
    #[error("{0}; nothing was written, for nothing stands before it")]
    Nothing(#[source] Box<ConvertError>),
    /// Times of transfers that are copied stay as they are.
    #[error("{}: transfers of a camera are copied as they are, and their times cannot count from 1970", .0.display())]
    CopiedTimes(PathBuf),
    /// The recording does not say when it began.
    #[error("{} does not say when it began: times cannot count from 1970", .0.display())]
    StartUnknown(PathBuf),
}

fn as_text<S: Serializer>(error: &Option<ConvertError>, to: S) -> Result<S::Ok, S::Error> {
    error.as_ref().map(ConvertError::to_string).serialize(to)
}

/// What comes later than this after the last event has a damaged time (µs).
const AFTERWARDS: i64 = 60_000_000;

/// What is done to a recording on its way.
pub struct Change<'a> {
    /// Changes a batch of events; times must stay in order.
    pub events: &'a mut dyn FnMut(&mut Vec<Event>),
    /// Changes a frame or an inertial sample, not its times.
    pub extra: &'a mut dyn FnMut(&mut Extra),
}

/// How far a conversion is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConversionProgress {
    /// Events done.
    pub events: u64,
    /// Which part of the recording that is, 0 to 1; `None` where that is not known.
    pub done: Option<f64>,
}

/// Writes the content of `recording` to a file at `path`; one that was there is replaced when the new one is whole. `progress` is told how far it is.
///
/// # Errors
/// [`ConvertError`] if it cannot begin or the output cannot be written. Should the recording break
/// off, what came before is written, and the report says so.
pub fn convert(
    recording: &Recording,
    path: &Path,
    target: OutputFormat,
    origin: TimeOrigin,
    progress: impl FnMut(ConversionProgress),
) -> Result<ConversionReport, ConvertError> {
    if let (Some(open), Some(copy)) = (recording.format().transfers, target.copy_transfers) {
        if origin == TimeOrigin::Unix {
            return Err(ConvertError::CopiedTimes(recording.path().to_owned()));
        }
        return copy_transfers(recording, path, open, copy);
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
    target: OutputFormat,
    origin: TimeOrigin,
    mut change: Change,
    mut progress: impl FnMut(ConversionProgress),
) -> Result<ConversionReport, ConvertError> {
    check_stated(recording)?;
    let mut reader = recording.open()?;
    let mut events = Vec::new();
    let mut report = ConversionReport::default();
    let mut more = next(&mut reader, &mut events, &mut report);
    let mut extras = if target.holds_extras { recording.open_extras()? } else { Box::new(NoExtras) };
    let shift = match origin {
        TimeOrigin::Kept => 0,
        TimeOrigin::Unix => start(recording)?.ok_or_else(|| ConvertError::StartUnknown(recording.path().to_owned()))?,
    };
    let later = |time: i64| time.saturating_add(shift);
    let zero = zero(events.first().map(|event| later(event.t)), extras.first_time().map(later));
    let failed = |error| ConvertError::Write { path: path.to_owned(), error };
    let information = reader.information();
    let sensor = match information.sensor {
        Some(sensor) => sensor,
        None if target.holds_sensor => {
            let (file, likely) = (recording.path().to_owned(), likely_sensor_of(recording));
            return Err(ConvertError::SensorUnknown { file, likely });
        }
        None => Sensor::new(0, 0),
    };
    let camera_name = information.camera_name.as_deref().unwrap_or_default();
    let description = Description { sensor, camera_name, others: extras.held(), zero };
    let mut file = None;
    let mut create = || {
        let new = NewFile::create(path).map_err(|error| error.error)?;
        file.insert(new).handle()
    };
    let mut output = (target.create)(&mut create, &description).map_err(failed)?;
    let mut latest = zero.saturating_sub(shift);
    while more {
        let last = events.last().map_or(latest, |event| event.t);
        latest = last;
        events.iter_mut().for_each(|event| event.t = event.t.saturating_add(shift));
        (change.events)(&mut events);
        output.write(&events).map_err(failed)?;
        report.events += events.len() as u64;
        while let Some(extra) = extras.next_until(last, &mut report.lost) {
            write_extra(&mut *output, extra, &mut change, shift, &mut report).map_err(failed)?;
        }
        output.advance(last.saturating_add(shift)).map_err(failed)?;
        progress(ConversionProgress { events: reader.report().events, done: reader.done() });
        more = next(&mut reader, &mut events, &mut report);
    }
    let end = latest.saturating_add(AFTERWARDS);
    while let Some(extra) = extras.next_until(end, &mut report.lost) {
        write_extra(&mut *output, extra, &mut change, shift, &mut report).map_err(failed)?;
    }
    if extras.next_until(i64::MAX, &mut report.lost).is_some() {
        report.lost.push("frames or inertial samples more than a minute after the last event".to_owned());
    }
    check_outside(recording, reader.report())?;
    // What was there is not replaced by nothing.
    if report.events + report.frames + report.inertial_samples == 0
        && let Some(error) = report.error.take()
    {
        return Err(ConvertError::Nothing(Box::new(error)));
    }
    output.finish().map_err(failed)?;
    report.lost.extend(output.lost());
    drop(output);
    if let Some(file) = file {
        file.finish().map_err(|error| failed(error.error.into()))?;
    }
    report.report = reader.report().clone();
    report.notes = reader.information().notes.clone();
    report.notes.extend(extras.chosen());
    report.lost.extend(left_out(&*extras, &report.report));
    Ok(report)
}

/// Changes, moves and writes a frame or an inertial sample, and counts it if it is kept.
fn write_extra(
    output: &mut dyn Encode,
    mut extra: Extra,
    change: &mut Change,
    shift: i64,
    report: &mut ConversionReport,
) -> Result<(), WriteError> {
    (change.extra)(&mut extra);
    let extra = extra.later(shift);
    let counted = match extra {
        Extra::Frame(_) => &mut report.frames,
        Extra::Inertial(_) => &mut report.inertial_samples,
    };
    *counted += u64::from(output.extra(extra)?);
    Ok(())
}

/// Copies the USB transfers of `recording` into a new file at `path`.
fn copy_transfers(
    recording: &Recording,
    path: &Path,
    open: OpenTransfers,
    copy: CopyTransfers,
) -> Result<ConversionReport, ConvertError> {
    let unreadable = |error| ConvertError::Capture { path: recording.path().to_owned(), error };
    let mut capture = open(recording.path(), recording.options()).map_err(unreadable)?;
    let failed = |error| ConvertError::Write { path: path.to_owned(), error };
    let unwritten = |error: FileError| failed(error.error.into());
    let file = NewFile::create(path).map_err(unwritten)?;
    let handle = file.handle().map_err(|error| failed(error.into()))?;
    let mut copied = copy(&mut capture, handle).map_err(failed)?;
    if copied.transfers == 0
        && let Some(error) = copied.error.take()
    {
        return Err(ConvertError::Nothing(Box::new(unreadable(error))));
    }
    file.finish().map_err(unwritten)?;
    Ok(ConversionReport {
        transfers: copied.transfers,
        lost: copied.lost.into_iter().collect(),
        error: copied.error.map(unreadable),
        ..ConversionReport::default()
    })
}

/// When the recording of a camera began, in µs since 1970, if it says so.
fn start(recording: &Recording) -> Result<Option<i64>, ConvertError> {
    let Some(open) = recording.format().transfers else { return Ok(None) };
    let unreadable = |error| ConvertError::Capture { path: recording.path().to_owned(), error };
    let start = open(recording.path(), recording.options()).map_err(unreadable)?.header().start_unix_ns;
    Ok(i64::try_from(start / 1000).ok().filter(|start| *start > 0))
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
        report.error = Some(error.into());
        false
    })
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
        let mut warnings = self.report.warnings();
        if self.events == 0 && self.transfers == 0 && self.error.is_none() {
            warnings.push("the recording holds no events".to_owned());
        }
        for (name, texts) in [("not kept", &self.lost), ("warning", &warnings), ("note", &self.notes)] {
            texts.iter().try_for_each(|text| write!(f, "\n{name}: {text}"))?;
        }
        Ok(())
    }
}
