//! Conversion of recordings from one format to another.
//!
//! Events pass the same reader as for a calibration, so a converted recording gives the same calibration as the
//! original. Frames and IMU samples are kept if both formats support them; the report lists what was lost.

use std::fmt;
use std::path::{Path, PathBuf};

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use serde::{Serialize, Serializer};
use usb_davis::capture::CaptureError;

use super::counted::counted;
use super::encode::{CopyTransfers, Description, Encode, OutputFormat, WriteError};
use super::extras::{Extra, Extras};
use super::given_sensor::{OtherSensor, check_outside, check_stated};
use super::likely_sensor::{add_sensor, likely_sensor_of, likely_words};
use super::write::output_extensions;
use crate::error::RecordingError;
use crate::format::OpenTransfers;
use crate::read_report::ReadReport;
use crate::reader::EventReader;
use crate::recording::Recording;
use crate::remedies::remedy_of_capture;
use evcal_files::{FileError, NewFile, remedies};

/// Returns the output format for the extension of `path`.
///
/// # Errors
/// [`ConvertError::Extension`] if there is none.
pub fn output_of(path: &Path) -> Result<OutputFormat, ConvertError> {
    OutputFormat::from_extension(path).ok_or_else(|| ConvertError::Extension(path.to_owned()))
}

/// Moment at which times in the output are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeOrigin {
    /// The same as in the recording.
    #[default]
    Kept,
    /// 1970-01-01 (Unix time), computed from the date in the camera's recording.
    Unix,
}

/// Result of a conversion.
#[derive(Debug, Default, Serialize)]
pub struct ConversionReport {
    /// Events written.
    pub events: u64,
    /// Frames written.
    pub frames: u64,
    /// IMU samples written.
    pub inertial_samples: u64,
    /// Transfers copied, if both formats store USB transfers of a camera.
    pub transfers: u64,
    /// Content that the output lacks or stores with less detail, in sentences.
    pub lost: Vec<String>,
    /// Counts and corrections of the reader.
    pub report: ReadReport,
    /// Assumptions of the reader.
    pub notes: Vec<String>,
    /// Error that ended reading early; the output contains everything before it.
    #[serde(serialize_with = "as_text")]
    pub error: Option<ConvertError>,
}

/// Error that prevents a conversion.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConvertError {
    /// The recording cannot be opened.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// The requested sensor is not the sensor of the recording.
    #[error("{0}")]
    OtherSensor(#[from] OtherSensor),
    /// The camera's stream cannot be read.
    #[error("{}: {error}", path.display())]
    Capture {
        /// Path of the recording.
        path: PathBuf,
        /// Cause.
        #[source]
        error: CaptureError,
    },
    /// The output cannot be written.
    #[error("{}: {error}", path.display())]
    Write {
        /// Path of the output.
        path: PathBuf,
        /// Cause.
        #[source]
        error: WriteError,
    },
    /// No format has this extension.
    #[error("{}: unknown extension; known are {}", .0.display(), output_extensions())]
    Extension(PathBuf),
    /// The sensor size is unknown.
    #[error("{} does not say how many pixels the sensor has{}", file.display(), likely_words(*likely))]
    SensorUnknown {
        /// Path of the recording.
        file: PathBuf,
        /// Smallest usual sensor that contains all events.
        likely: Option<Sensor>,
    },
    /// Reading stopped before the first event, frame or sample.
    #[error("{0}; nothing was written, because nothing precedes it")]
    Nothing(#[source] Box<ConvertError>),
    /// Transfers are copied with their times, which cannot be changed.
    #[error("{}: USB transfers are copied unchanged, so their times cannot count from 1970", .0.display())]
    CopiedTimes(PathBuf),
    /// The recording does not contain the date at which it began.
    #[error("{} does not say when it began: times cannot count from 1970", .0.display())]
    StartUnknown(PathBuf),
}

remedies! { ConvertError, say;
    Self::Recording(error) => error.remedy(say);
    Self::OtherSensor(error) => error.remedy(say);
    Self::Capture { error, .. } => remedy_of_capture(error, say);
    Self::Write { error, .. } => error.remedy(say);
    Self::Nothing(error) => error.remedy(say);
    Self::Extension(_) => "or give the format with {}", say.to?;
    Self::SensorUnknown { likely, .. } => Some(add_sensor(*likely, say));
    Self::CopiedTimes(_) => "leave out {}", say.unix_time?;
}

fn as_text<S: Serializer>(error: &Option<ConvertError>, to: S) -> Result<S::Ok, S::Error> {
    error.as_ref().map(ConvertError::to_string).serialize(to)
}

/// Frames and samples later than this (µs) after the last event have a damaged time.
const AFTERWARDS: i64 = 60_000_000;

/// Changes that are made to a recording during conversion.
pub struct Change<'a> {
    /// Changes a batch of events; times must stay in order.
    pub events: &'a mut dyn FnMut(&mut Vec<Event>),
    /// Changes a frame or an IMU sample, except its times.
    pub extra: &'a mut dyn FnMut(&mut Extra),
}

/// Progress of a conversion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConversionProgress {
    /// Events converted so far.
    pub events: u64,
    /// Fraction of the recording converted, 0 to 1; `None` if unknown.
    pub done: Option<f64>,
}

/// Writes the content of `recording` to a file at `path`. An existing file is replaced once the new one is complete.
/// Calls `progress` after each batch.
///
/// # Errors
/// [`ConvertError`] if the conversion cannot begin or the output cannot be written. If reading fails later, everything
/// before the error is written, and the report contains the error.
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

/// Converts like [`convert`], but applies `change` to the content. USB transfers are therefore decoded instead of
/// copied.
///
/// # Errors
/// As for [`convert`].
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
    let mut extras = if target.contains_extras { recording.open_extras()? } else { Extras::default() };
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
        None if target.contains_sensor => {
            let (file, likely) = (recording.path().to_owned(), likely_sensor_of(recording));
            return Err(ConvertError::SensorUnknown { file, likely });
        }
        None => Sensor::new(0, 0),
    };
    let camera_name = information.camera_name.as_deref().unwrap_or_default();
    let description = Description { sensor, camera_name, others: extras.streams(), zero };
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
        report.lost.push("frames or IMU samples more than a minute after the last event".to_owned());
    }
    check_outside(recording, reader.report())?;
    // An existing file is not replaced by an empty one.
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
    report.notes.extend(extras.chosen().into_iter().chain(extras.passed_over()));
    report.lost.extend(extras.left_out(&report.report));
    Ok(report)
}

/// Changes a frame or an IMU sample, shifts its times by `shift` µs, writes it, and counts it if the output
/// supports it.
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

/// Returns the time in µs since 1970 at which a camera's recording began, if it contains it.
fn start(recording: &Recording) -> Result<Option<i64>, ConvertError> {
    let Some(open) = recording.format().transfers else { return Ok(None) };
    let unreadable = |error| ConvertError::Capture { path: recording.path().to_owned(), error };
    let start = open(recording.path(), recording.options()).map_err(unreadable)?.header().start_unix_ns;
    Ok(i64::try_from(start / 1000).ok().filter(|start| *start > 0))
}

/// Returns the time in µs that becomes zero on the camera's clock: 0 if the events begin within the first hour, else
/// the first time of all, because the camera's stream needs one word for every 33 ms before the first event.
fn zero(events: Option<i64>, extras: Option<i64>) -> i64 {
    const LATEST_START: i64 = 3_600_000_000;
    let first = events.into_iter().chain(extras).min().unwrap_or(0);
    if (0..LATEST_START).contains(&events.unwrap_or(first)) { 0 } else { first }
}

/// Reads the next events. Returns `false` at the end and after an error, which is stored in `report`.
fn next(reader: &mut EventReader, events: &mut Vec<Event>, report: &mut ConversionReport) -> bool {
    reader.next_batch(events).unwrap_or_else(|error| {
        report.error = Some(error.into());
        false
    })
}

impl fmt::Display for ConversionReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.transfers > 0 {
            f.write_str(&counted(self.transfers, "transfer as it was", "transfers as they were"))?;
        } else {
            f.write_str(&counted(self.events, "event", "events"))?;
            if self.frames > 0 || self.inertial_samples > 0 {
                let frames = counted(self.frames, "frame", "frames");
                write!(f, ", {frames}, {}", counted(self.inertial_samples, "IMU sample", "IMU samples"))?;
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
