//! HDF5: events as columns, as rows of numbers, or as records, wherever in the file they are.
//!
//! | layout | events |
//! |---|---|
//! | DSEC, MPL | `events/{t, x, y, p}`, `t_offset` beside the group |
//! | M3ED | `prophesee/left/{t, x, y, p}`, the sensor in `calib/resolution` |
//! | e2calib | `t`, `x`, `y`, `p` at the root |
//! | MVSEC | `davis/left/events`, rows x, y, t, p; the sensor from `image_raw` |
//! | Metavision | `CD/events`, records x, y, p, t, compressed with ECF |
//!
//! Names, units of time and what is guessed are those of text files. The structure of the file is read by the crate
//! `hdf5-reader`; its compressions that HDF5 itself does not bring are in [`filters`].

mod blosc;
mod ecf;
mod filters;
mod layout;
mod structure;
mod table;
mod write;

use std::path::{Path, PathBuf};

use evcal_core::event::{Event, Polarity};

use super::bytes::share;
use super::{
    Column, Decode, FileFormat, Opened, ReadReport, RecordingError, RecordingErrorKind, RecordingInformation,
    RecordingOptions, StreamSummary, TimeUnit, columns, numbers,
};
use layout::Found;
use table::Table;

/// An HDF5 file with events.
pub const FORMAT: FileFormat = FileFormat {
    streams,
    output: Some(&write::OUTPUT),
    ..FileFormat::of_events("HDF5", |head| head.bytes.starts_with(b"\x89HDF\r\n\x1a\n"), open)
};

/// Events of a batch.
const BATCH: u64 = 32_768;

fn open(path: &Path, options: &RecordingOptions) -> Opened {
    let file = filters::open(path, filters::Limits::default()).map_err(|error| structure(path, &error))?;
    let all = layout::find(&file).map_err(|error| structure(path, &error))?;
    let list = || all.iter().map(|found| found.name.clone()).collect::<Vec<_>>().join(", ");
    let found = match &options.stream {
        Some(wanted) => all.iter().find(|found| found.name == wanted.trim_matches('/')),
        None => all.first(),
    };
    let found = found.ok_or_else(|| {
        let kind = match &options.stream {
            Some(wanted) => RecordingErrorKind::NoSuchStream { wanted: wanted.clone(), available: list() },
            None => RecordingErrorKind::NoEventStream("no group of arrays t, x, y and p".to_owned()),
        };
        RecordingError::new(path, kind)
    })?;
    let mut notes = match all.len() {
        1 => Vec::new(),
        _ => vec![format!("events of {} are read; there are {}", found.name, list())],
    };
    let Found { table, sensor, offset, .. } = with_room(path, found)?;
    let (table, unit) = arrange(path, table, options, &mut notes)?;
    let offset = offset.and_then(|offset| offset.microseconds(unit)).unwrap_or(0);
    let information = RecordingInformation { format: FORMAT.name, sensor, camera_name: None, began: None, notes };
    Ok(Box::new(Decoder { path: path.to_owned(), information, table, unit, offset, next: 0 }))
}

/// The same, in a handle of the file that has room for its chunks.
fn with_room(path: &Path, found: &Found) -> Result<Found, RecordingError> {
    let file = filters::open(path, found.table.limits()).map_err(|error| structure(path, &error))?;
    let again = layout::find(&file).map_err(|error| structure(path, &error))?;
    let gone = || RecordingError::new(path, RecordingErrorKind::NoEventStream("none any more".to_owned()));
    again.into_iter().find(|again| again.name == found.name).ok_or_else(gone)
}

/// The table with its columns in order, and its unit of time.
fn arrange(
    path: &Path,
    mut table: Table,
    options: &RecordingOptions,
    notes: &mut Vec<String>,
) -> Result<(Table, TimeUnit), RecordingError> {
    let layout = |error| RecordingError::new(path, RecordingErrorKind::Layout(error));
    let sample = table.cells(columns::SAMPLE as u64).map_err(|error| structure(path, &error))?;
    if let Some(order) = table.order_to_find() {
        *order = match &options.columns {
            Some(columns) if columns.as_slice().len() == order.as_slice().len() => columns.clone(),
            Some(_) => return Err(layout(columns::LayoutError::FieldCount(order.as_slice().len()))),
            None => columns::from_values(&sample, notes).map_err(layout)?,
        };
    }
    let unit = options.time_unit.unwrap_or_else(|| {
        let place = table.place_of(Column::T);
        let times: Vec<f64> = sample.iter().filter_map(|row| row.get(place?)?.value).collect();
        columns::unit_from_values(&times, notes)
    });
    Ok((table, unit))
}

fn streams(path: &Path, options: &RecordingOptions) -> Result<Vec<StreamSummary>, RecordingError> {
    let file = filters::open(path, filters::Limits::default()).map_err(|error| structure(path, &error))?;
    let all = layout::find(&file).map_err(|error| structure(path, &error))?;
    let summary = |found: &Found| {
        let (table, unit) = arrange(path, with_room(path, found)?.table, options, &mut Vec::new())?;
        let time = |row: u64| {
            let rows = table.rows(row, row + 1).ok()?;
            let number = rows.first()?.iter().find(|(column, _)| *column == Column::T)?.1;
            number.microseconds(unit)
        };
        let last = table.count().checked_sub(1);
        let times_us = last.and_then(|last| Some((time(0)?, time(last)?)));
        Ok(StreamSummary { name: found.name.clone(), packets: 1, elements: table.count(), times_us })
    };
    all.iter().map(summary).collect()
}

/// HDF5 has no one place for a fault: its structure is spread over the file.
fn structure(path: &Path, error: &hdf5_reader::error::Error) -> RecordingError {
    let what = format!("the structure of the HDF5 file cannot be read: {error}");
    let advice = "was it closed, and copied as a whole? h5dump tells more";
    RecordingError::new(path, RecordingErrorKind::Damaged { byte: 0, what, advice })
}

struct Decoder {
    path: PathBuf,
    information: RecordingInformation,
    table: Table,
    unit: TimeUnit,
    /// Added to all times, in microseconds.
    offset: i64,
    /// Events read.
    next: u64,
}

impl Decode for Decoder {
    fn information(&self) -> &RecordingInformation {
        &self.information
    }

    fn decode(&mut self, batch: &mut Vec<Event>, _: &mut ReadReport) -> Result<bool, RecordingError> {
        let end = self.table.count().min(self.next + BATCH);
        let at = |event: u64, what: String| RecordingError::new(&self.path, RecordingErrorKind::Event { event, what });
        let rows = self.table.rows(self.next, end).map_err(|error| {
            at(self.next + 1, format!("it cannot be unpacked: {error}; the events before it can be used"))
        })?;
        for row in &rows {
            self.next += 1;
            let mut event = Event { t: 0, x: 0, y: 0, polarity: Polarity::Off };
            for (column, number) in row {
                numbers::put(&mut event, self.next, *column, *number, self.unit)
                    .map_err(|kind| RecordingError::new(&self.path, kind))?;
            }
            event.t = event.t.saturating_add(self.offset);
            batch.push(event);
        }
        Ok(self.next < self.table.count())
    }

    fn done(&self) -> Option<f64> {
        Some(share(self.next, self.table.count()))
    }
}
