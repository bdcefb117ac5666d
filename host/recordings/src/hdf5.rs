//! HDF5: events as columns, as rows of numbers, or as records, anywhere in the file.
//!
//! | layout | events |
//! |---|---|
//! | DSEC, MPL | `events/{t, x, y, p}`, with `t_offset` next to the group |
//! | M3ED | `prophesee/left/{t, x, y, p}`, with the sensor in `calib/resolution` |
//! | e2calib | `t`, `x`, `y`, `p` at the root |
//! | MVSEC | `davis/left/events`, rows x, y, t, p; with `image_raw` and `imu` in the same group |
//! | Metavision | `CD/events`, records x, y, p, t, compressed with ECF |
//!
//! Column names and time units are determined as for text files. The crate `hdf5-reader` reads the structure of the
//! file; `filters` adds the compressions that HDF5 itself does not include.

mod blosc;
mod ecf;
mod extras;
mod filters;
mod layout;
mod structure;
mod table;
#[cfg(test)]
mod tests;
mod write;

use std::path::{Path, PathBuf};

use evcal_core::event::{Event, Polarity};
use hdf5_reader::Dataset;
use hdf5_reader::error::Error;

pub use self::write::SubPixelEncoder;
use super::bytes::share;
use super::columns::{self, GuessedUnit, PolarityCode};
use super::counter::TimeCounter;
use super::numbers;
use crate::error::{RecordingError, RecordingErrorKind, Usable};
use crate::format::{FileFormat, Head, OpenResult, StreamSummary, Uses};
use crate::options::{Column, Damage, RecordingOptions, TimeUnit};
use crate::read_report::{ReadReport, Truncation};
use crate::reader::{Decode, Opened, RecordingInformation};
use crate::unsupported_format::UnsupportedFormat;
use layout::{Contents, Found, TimedDataset};
use table::{Row, Table};

/// An HDF5 file with events.
pub const FORMAT: FileFormat = FileFormat {
    streams,
    frames: Some(extras::frames),
    extras: Some(extras::open),
    output: Some(&write::OUTPUT),
    uses: Uses { stream: true, columns: true, ..Uses::NONE },
    ..FileFormat::of_events("HDF5", recognise, open)
};

const SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";
/// Class of the layout of a virtual dataset (HDF5 File Format Specification, section IV.A.2.i).
const VIRTUAL: u8 = 3;
/// Number of events per batch.
const BATCH: u64 = 32_768;

/// `true` if the signature is at byte 0, or after a user block (as in MATLAB's files) of 512 bytes or a larger power of
/// two.
fn recognise(head: &Head) -> bool {
    let begins = |start: usize| head.bytes.get(start..).is_some_and(|rest| rest.starts_with(SIGNATURE));
    begins(0) || (9..16).any(|power| begins(1 << power))
}

fn open(path: &Path, options: &RecordingOptions) -> OpenResult {
    let (found, mut notes) = choose(path, options)?;
    let Found { table, sensor, offset, frames, samples, .. } = found;
    let Arranged { table, unit: GuessedUnit { unit, is_doubtful: is_unit_doubtful }, code } =
        arrange(path, table, options, &mut notes)?;
    if let Some(lengths) = table.unequal() {
        let count = table.count();
        notes.push(format!(
            "the arrays of the events have different lengths ({lengths}): the first {count} of each are read, and what follows is lost"
        ));
    }
    let offset = offset.and_then(|offset| offset.microseconds(unit)).unwrap_or(0);
    let others = [(extras::FRAMES, frames), (extras::SAMPLES, samples)];
    let other = others.into_iter().filter_map(|(name, found)| Some((name.to_owned(), length(&found?.data)))).collect();
    let information = RecordingInformation { format: FORMAT.name, sensor, notes, ..RecordingInformation::default() };
    let path = path.to_owned();
    let (damage, counter) = (options.damage, TimeCounter::new(unit));
    let decoder = Decoder { path, table, unit, code, counter, offset, damage, other, next: 0, batch: BATCH };
    Ok(Opened { is_unit_doubtful, ..Opened::new(information, decoder) })
}

/// Returns the number of frames or samples.
fn length(data: &Dataset) -> u64 {
    data.shape().first().copied().unwrap_or(0)
}

/// Selects the requested stream, or the first one with events, and reopens the file with limits for its chunks. Also
/// returns notes about the choice.
fn choose(path: &Path, options: &RecordingOptions) -> Result<(Found, Vec<String>), RecordingError> {
    let mut all = all(path, options)?;
    let list = all.iter().map(|found| found.name.clone()).collect::<Vec<_>>().join(", ");
    let index = match &options.stream {
        Some(wanted) => all.iter().position(|found| found.name == wanted.trim_matches('/')),
        None => Some(all.iter().position(|found| has_events(&found.table)).unwrap_or(0)),
    };
    let count = all.len();
    let Some(index) = index.filter(|index| *index < count) else {
        let kind = match &options.stream {
            Some(wanted) => RecordingErrorKind::NoSuchStream { wanted: wanted.clone(), available: list },
            None => RecordingErrorKind::NoEventStream("groups without arrays t, x, y and p".to_owned()),
        };
        return Err(RecordingError::new(path, kind));
    };
    let found = all.swap_remove(index);
    let notes = match count {
        1 => Vec::new(),
        _ => {
            let first = if index == 0 { "" } else { ", the first ones in the file" };
            vec![format!("the events of {} are read{first}; the file contains {list}", found.name)]
        }
    };
    Ok((with_room(path, found)?, notes))
}

/// `true` if the table has events, or cannot be read, which the reader of the events then reports.
fn has_events(table: &Table) -> bool {
    table.cells(columns::SAMPLE as u64).map_or(true, |rows| !numbers::written_cells(rows).is_empty())
}

/// Returns the streams of events, those named as events first. Other arrays of four columns may be something else, such
/// as attitudes, so they are included only if their values can be events. If nothing remains, all arrays are returned,
/// so that the fault can be reported.
fn all(path: &Path, options: &RecordingOptions) -> Result<Vec<Found>, RecordingError> {
    let file = filters::open(path, filters::Limits::default()).map_err(|error| structure(path, &error))?;
    let Contents { streams, unread } = layout::find(&file).map_err(|error| structure(path, &error))?;
    if let Some((array, what)) = unread.filter(|_| streams.is_empty()) {
        return Err(RecordingError::new(path, RecordingErrorKind::Elements { array, what }));
    }
    let (mut all, others): (Vec<Found>, Vec<Found>) = streams.into_iter().partition(|found| found.is_named);
    let can_be = |found: &Found| arrange(path, found.table.clone(), options, &mut Vec::new()).is_ok();
    let (like_events, others): (Vec<Found>, Vec<Found>) = others.into_iter().partition(can_be);
    all.extend(like_events);
    Ok(if all.is_empty() { others } else { all })
}

/// Finds the stream again in a new handle of the file, with limits for its chunks.
fn with_room(path: &Path, found: Found) -> Result<Found, RecordingError> {
    let file = filters::open(path, found.table.limits()).map_err(|error| structure(path, &error))?;
    let again = layout::find(&file).map_err(|error| structure(path, &error))?.streams;
    let gone = || {
        RecordingError::new(
            path,
            RecordingErrorKind::NoEventStream("content that changed while it was read".to_owned()),
        )
    };
    again.into_iter().find(|again| again.name == found.name).ok_or_else(gone)
}

/// A table whose columns are known.
struct Arranged {
    table: Table,
    unit: GuessedUnit,
    code: PolarityCode,
}

/// Determines the order of the table's columns, the unit of its times, and the numbers for ON and OFF.
fn arrange(
    path: &Path,
    mut table: Table,
    options: &RecordingOptions,
    notes: &mut Vec<String>,
) -> Result<Arranged, RecordingError> {
    let layout = |error| RecordingError::new(path, RecordingErrorKind::Layout(error));
    let sample = table.cells(columns::SAMPLE as u64).map_err(|error| structure(path, &error))?;
    let sample = numbers::written_cells(sample);
    if let Some(order) = table.order_to_find() {
        *order = match &options.columns {
            Some(columns) if columns.as_slice().len() == order.as_slice().len() => columns.clone(),
            Some(_) => return Err(layout(columns::LayoutError::FieldCount(order.as_slice().len()))),
            None => columns::from_values(&sample, notes).map_err(layout)?,
        };
    } else if options.columns.is_some() {
        return Err(layout(columns::LayoutError::Named));
    }
    let stated = options.time_unit.or_else(|| table.unit_of_name());
    let (unit, code) = columns::unit_and_code(&sample, &table.order(), stated, notes);
    Ok(Arranged { table, unit, code })
}

fn streams(path: &Path, options: &RecordingOptions) -> Result<Vec<StreamSummary>, RecordingError> {
    let summary = |found: Found| {
        let (name, count) = (found.name.clone(), found.table.count());
        let mut summaries = vec![StreamSummary {
            packets: 1,
            elements: count,
            times_us: times(path, &found, options),
            ..StreamSummary::new(name)
        }];
        for (name, other) in [(extras::FRAMES, found.frames), (extras::SAMPLES, found.samples)] {
            if let Some(TimedDataset { data, .. }) = other {
                let name = format!("{name} of {}", found.name);
                summaries.push(StreamSummary { packets: 1, elements: length(&data), ..StreamSummary::new(name) });
            }
        }
        summaries
    };
    Ok(all(path, options)?.into_iter().flat_map(summary).collect())
}

/// Returns the times of the first and the last event in µs; `None` if they cannot be read, which the reader of the
/// events reports.
fn times(path: &Path, found: &Found, options: &RecordingOptions) -> Option<(i64, i64)> {
    let Arranged { table, unit: GuessedUnit { unit, .. }, .. } =
        arrange(path, found.table.clone(), options, &mut Vec::new()).ok()?;
    let offset = found.offset.and_then(|offset| offset.microseconds(unit)).unwrap_or(0);
    let time = |row: u64| {
        let rows = table.rows(row, row + 1).ok()?;
        let number = rows.first()?.iter().find(|(column, _)| *column == Column::T)?.1;
        Some(number.microseconds(unit)?.saturating_add(offset))
    };
    Some((time(0)?, time(table.count().checked_sub(1)?)?))
}

/// Converts an error about the structure of the file. It has no useful byte, because the structure is spread over the
/// file.
fn structure(path: &Path, error: &Error) -> RecordingError {
    let (byte, what) = match (unsupported(error), filters::cut_off(path)) {
        _ if is_virtual(error) => {
            return RecordingError::new(path, RecordingErrorKind::Unsupported(UnsupportedFormat::VirtualHdf5));
        }
        (Some(filter), _) => return RecordingError::new(path, RecordingErrorKind::Filter(filter.to_owned())),
        (None, Some((length, promised))) => (
            length,
            format!("the file ends here instead of after {promised} bytes, and the position of its events is unknown"),
        ),
        (None, None) => (0, format!("the structure of the HDF5 file cannot be read: {error}")),
    };
    RecordingError::damaged(path, byte, what, Usable::Nothing)
}

/// Returns the unsupported compression that `error` is about, if it is about one.
fn unsupported(error: &Error) -> Option<&str> {
    match error {
        Error::UnsupportedFilter(filter) => Some(filter),
        Error::Context { source, .. } => unsupported(source),
        _ => None,
    }
}

/// `true` if `error` is about a virtual dataset, which has no data of its own.
fn is_virtual(error: &Error) -> bool {
    match error {
        Error::UnsupportedLayoutClass(VIRTUAL) => true,
        Error::Context { source, .. } => is_virtual(source),
        _ => false,
    }
}

struct Decoder {
    path: PathBuf,
    table: Table,
    unit: TimeUnit,
    code: PolarityCode,
    counter: TimeCounter,
    /// Offset in µs of all times.
    offset: i64,
    damage: Damage,
    /// Numbers of frames and IMU samples, by name.
    other: Vec<(String, u64)>,
    /// Number of events read.
    next: u64,
    /// Number of events that are read at once; reduced before damage.
    batch: u64,
}

impl Decoder {
    fn error(&self, kind: RecordingErrorKind) -> RecordingError {
        RecordingError::new(&self.path, kind)
    }

    /// Handles an event that cannot be read. Returns `true` if more events may follow.
    fn pass_over(&mut self, error: &Error, report: &mut ReadReport) -> Result<bool, RecordingError> {
        if let Some(filter) = unsupported(error) {
            return Err(self.error(RecordingErrorKind::Filter(filter.to_owned())));
        }
        if let Some((byte, promised)) = filters::cut_off(&self.path) {
            let missing = self.table.count() - self.next;
            let lost = format!("{missing} events are missing; the file should have {promised} bytes");
            report.truncated = Some(Truncation { byte, lost });
            return Ok(false);
        }
        if self.damage == Damage::Refuse {
            let kind = RecordingErrorKind::DamagedChunk { event: self.next + 1, what: error.to_string() };
            return Err(self.error(kind));
        }
        report.damaged_packets += 1;
        self.next = self.table.next_chunk(self.next);
        self.batch = BATCH;
        Ok(self.next < self.table.count())
    }
}

fn is_filling(row: &Row) -> bool {
    numbers::is_filling(row.iter().map(|(_, number)| Some(number.value())))
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        report.other_packets.extend(std::mem::take(&mut self.other));
        let rows = match self.table.readable(self.next, self.batch) {
            Ok(rows) => rows,
            Err(error) => return self.pass_over(&error, report),
        };
        // If fewer rows than requested were readable, damage follows; smaller batches avoid decoding up to it
        // repeatedly.
        self.batch = self.batch.min((rows.len() as u64).max(1));
        let (written, unwritten) = rows.split_at(numbers::written(rows.iter(), is_filling));
        if written.is_empty() && !unwritten.is_empty() {
            // All remaining rows are taken as unwritten. There may be very many of them, without any data in the file.
            report.unwritten += self.table.count() - self.next;
            self.next = self.table.count();
            return Ok(false);
        }
        for row in written {
            self.next += 1;
            let mut event = Event { t: 0, x: 0, y: 0, polarity: Polarity::Off };
            for (column, number) in row {
                numbers::put(&mut event, self.next, *column, *number, self.unit, self.code)
                    .map_err(|kind| self.error(kind))?;
            }
            event.t = self.counter.time(event.t, report).saturating_add(self.offset);
            batch.push(event);
        }
        report.unwritten += unwritten.len() as u64;
        self.next += unwritten.len() as u64;
        Ok(self.next < self.table.count())
    }

    fn done(&self) -> Option<f64> {
        Some(share(self.next, self.table.count()))
    }
}
