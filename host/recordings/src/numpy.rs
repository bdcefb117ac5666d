//! NumPy arrays: npy (a single array) and npz (a ZIP archive of named arrays).
//!
//! | content | is read as |
//! |---|---|
//! | structured array | events, by the names of its fields |
//! | array of N × 4 or 4 × N numbers | events, by columns as in a text file |
//! | npy with one number per event, or two of `xy`, and other columns in files next to it | events, by the names of the files |
//! | folder of such npy files | events, if one of the files has times |
//! | npz with arrays `t`, `x`, `y`, `p` of one length, or `t`, `xy`, `p` | events, by the names of the arrays |
//!
//! Column names and time units are determined as for text files.

mod archive;
mod header;
mod literal;
mod table;
#[cfg(test)]
mod tests;
mod write;

use std::io::Read;
use std::path::Path;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::bytes::share;
use super::columns::{self, GuessedUnit, PolarityCode};
use super::counter::TimeCounter;
use super::numbers::{self, NumberType};
use crate::error::{RecordingError, RecordingErrorKind, Usable};
use crate::format::{FileFormat, OpenResult, Uses};
use crate::options::{Column, Columns, RecordingOptions, TimeUnit};
use crate::read_report::{ReadReport, Truncation};
use crate::reader::{Decode, Opened, RecordingInformation};
use table::{Named, Part, Table};
pub use write::OUTPUT;

/// An npy file.
pub const ARRAY_FORMAT: FileFormat = FileFormat {
    files: |path| table::files(path),
    uses: Uses { columns: true, ..Uses::NONE },
    ..FileFormat::of_events("NumPy array", |head| head.bytes.starts_with(header::MAGIC), open_array)
};

/// A folder of npy files with one column each. It is recognised by the files in it.
pub const FOLDER_FORMAT: FileFormat = FileFormat {
    files: |path| table::times_in(path).map_or_else(Vec::new, |times| table::files(&times)),
    uses: Uses { columns: true, ..Uses::NONE },
    ..FileFormat::of_events("NumPy arrays", |_| false, open_folder)
};

/// `true` if `path` is a folder of npy files of one recording.
pub fn is_folder(path: &Path) -> bool {
    table::times_in(path).is_some()
}

/// An npz file.
pub const ARCHIVE_FORMAT: FileFormat = FileFormat {
    output: Some(&OUTPUT),
    uses: Uses { stream: true, columns: true, ..Uses::NONE },
    ..FileFormat::of_events("NumPy archive", |head| head.bytes.starts_with(archive::MAGIC), open_archive)
};

/// Largest number of events per batch.
const BATCH: u64 = 16_384;
/// Largest size of a batch in bytes, unless a single record is larger: records may have 64 KiB.
const BATCH_BYTES: u64 = 1 << 22;

fn open_array(path: &Path, options: &RecordingOptions) -> OpenResult {
    let table = table::of_array(path)?;
    open(ARRAY_FORMAT.name, path, table, None, Vec::new(), options)
}

fn open_folder(path: &Path, options: &RecordingOptions) -> OpenResult {
    let nothing = || RecordingError::new(path, RecordingErrorKind::NoEventStream(String::new()));
    let times = table::times_in(path).ok_or_else(nothing)?;
    open(FOLDER_FORMAT.name, &times, table::of_array(&times)?, None, Vec::new(), options)
}

fn open_archive(path: &Path, options: &RecordingOptions) -> OpenResult {
    let members = archive::members(path)?;
    let found = table::of_archive(path, &members, options.stream.as_deref())?;
    let (table, name) = likeliest(path, found, options)?;
    let notes = name.map(|name| format!("the events of the array {name} are read")).into_iter().collect();
    open(ARCHIVE_FORMAT.name, path, table, table::sensor(path, &members), notes, options)
}

/// Returns the first table that can contain events. If there is none, returns the first table, so that its fault is
/// reported.
fn likeliest(path: &Path, found: Vec<Named>, options: &RecordingOptions) -> Result<Named, RecordingError> {
    let can_be = |(table, _): &Named| {
        let sample = sample(path, table)?;
        Ok(layout(table, &sample, options, &mut Vec::new()).is_ok())
    };
    let mut first = None;
    for named in found {
        if can_be(&named)? {
            return Ok(named);
        }
        first.get_or_insert(named);
    }
    first.ok_or_else(|| RecordingError::new(path, RecordingErrorKind::NoEventStream(String::new())))
}

fn open(
    format: &'static str,
    path: &Path,
    table: Table,
    sensor: Option<Sensor>,
    mut notes: Vec<String>,
    options: &RecordingOptions,
) -> OpenResult {
    let sample = sample(path, &table)?;
    let (columns, (GuessedUnit { unit, is_doubtful: is_unit_doubtful }, code)) =
        layout(&table, &sample, options, &mut notes)
            .map_err(|error| RecordingError::new(path, RecordingErrorKind::Layout(error)))?;
    let sources = sources(path, &table, columns.as_slice())?;
    let fields = sources.iter().flat_map(|source| &source.fields);
    let unread = fields.into_iter().find(|(column, _, number)| *column != Column::Ignored && number.is_none());
    if let Some((column, ..)) = unread {
        let array = format!("{column:?}").to_lowercase();
        let what = "floating-point numbers of 16 bits, or elements that are not numbers";
        return Err(RecordingError::new(path, RecordingErrorKind::Elements { array, what }));
    }
    let information = RecordingInformation { format, sensor, notes, ..RecordingInformation::default() };
    let path = path.to_owned();
    let (counter, count) = (TimeCounter::new(unit), table.count);
    let decoder = Decoder { path, sources, unit, code, counter, events: 0, left: count, count };
    Ok(Opened { is_unit_doubtful, ..Opened::new(information, decoder) })
}

/// Determines the columns, the unit of the times, and the numbers for ON and OFF.
fn layout(
    table: &Table,
    sample: &[Vec<columns::Cell>],
    options: &RecordingOptions,
    notes: &mut Vec<String>,
) -> Result<(Columns, (GuessedUnit, PolarityCode)), columns::LayoutError> {
    let named = table.names.as_ref().map(|names| {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        (columns::from_names(&names), names.join(", "))
    });
    let unit_of_name = named.as_ref().and_then(|((_, unit), _)| *unit);
    let columns = match (&options.columns, named) {
        // Arrays that have names have no order of columns, so an option cannot state one.
        (Some(_), Some(_)) if table.parts.len() > 1 => return Err(columns::LayoutError::Named),
        (Some(columns), _) if columns.as_slice().len() == table.width() => columns.clone(),
        (Some(_), _) => return Err(columns::LayoutError::FieldCount(table.width())),
        (None, Some(((Some(columns), _), _))) => columns,
        (None, Some(((None, _), names))) => return Err(columns::LayoutError::Names(names)),
        (None, None) => columns::from_values(sample, notes)?,
    };
    let guessed = columns::unit_and_code(sample, columns.as_slice(), options.time_unit.or(unit_of_name), notes);
    Ok((columns, guessed))
}

/// Reads the first rows.
fn sample(path: &Path, table: &Table) -> Result<Vec<Vec<columns::Cell>>, RecordingError> {
    let all = vec![Column::Ignored; table.width()];
    let mut sources = sources(path, table, &all)?;
    let wanted = table.count.min(columns::SAMPLE as u64).min(rows_at_once(&sources));
    // The pass that follows reports damage.
    sources.iter_mut().for_each(|source| drop(source.fill(wanted)));
    let count = sources.iter().map(Source::records).min().unwrap_or(0);
    let nothing = columns::Cell { value: None, is_polarity: false };
    let cell = |source: &Source, row: usize, offset: usize, number: Option<NumberType>| {
        let bytes = source.record(row).and_then(|record| record.get(offset..));
        number.and_then(|number| number.read(bytes?)).map_or(nothing, numbers::Number::cell)
    };
    let row = |row: usize| {
        let fields = sources.iter().flat_map(|source| source.fields.iter().map(move |field| (source, field)));
        fields.map(|(source, (_, offset, number))| cell(source, row, *offset, *number)).collect()
    };
    Ok(numbers::written_cells((0..count).map(row).collect()))
}

/// Opens the parts of `table`, whose fields are assigned to `columns`.
fn sources(path: &Path, table: &Table, columns: &[Column]) -> Result<Vec<Source>, RecordingError> {
    let mut columns = columns.iter().copied();
    table.parts.iter().map(|part| Source::open(path, part, &mut columns)).collect()
}

/// Returns the number of rows that are read at once from these parts.
fn rows_at_once(sources: &[Source]) -> u64 {
    let row: u64 = sources.iter().map(|source| source.record as u64).sum();
    (BATCH_BYTES / row.max(1)).clamp(1, BATCH)
}

/// Reader of one part of a table.
struct Source {
    input: Box<dyn Read + Send>,
    /// Offset of the next record in the file; of the whole part if it is compressed.
    byte: u64,
    compressed: bool,
    record: usize,
    fields: Vec<(Column, usize, Option<NumberType>)>,
    bytes: Vec<u8>,
}

impl Source {
    fn open(path: &Path, part: &Part, columns: &mut impl Iterator<Item = Column>) -> Result<Self, RecordingError> {
        let mut input = part.location.open(path)?;
        // If the file ends before that, the following reads return nothing.
        let _ = std::io::copy(&mut input.by_ref().take(part.skip), &mut std::io::sink());
        let fields = part.fields.iter().zip(columns).map(|(&(offset, number), column)| (column, offset, number));
        let byte = part.location.start + if part.location.is_compressed() { 0 } else { part.skip };
        let (compressed, fields) = (part.location.is_compressed(), fields.collect());
        Ok(Self { input, byte, compressed, record: part.record, fields, bytes: Vec::new() })
    }

    /// Reads the next `count` records. Returns the fault of the file if there are fewer.
    fn fill(&mut self, count: u64) -> Result<(), Fault> {
        if !self.compressed {
            self.byte += self.bytes.len() as u64;
        }
        self.bytes.clear();
        let length = count * self.record as u64;
        let read = self.input.by_ref().take(length).read_to_end(&mut self.bytes);
        match read {
            Ok(read) if read as u64 == length => Ok(()),
            Ok(_) => {
                let rest = self.bytes.len() % self.record;
                let byte = self.byte + if self.compressed { 0 } else { (self.bytes.len() - rest) as u64 };
                Err(Fault::Short(Truncation {
                    byte,
                    lost: "the array has fewer elements than its header states".to_owned(),
                }))
            }
            Err(error) if error.kind() == std::io::ErrorKind::InvalidData || self.compressed => {
                Err(Fault::Damaged { byte: self.byte, what: format!("the array is damaged: {error}") })
            }
            Err(error) => Err(Fault::Io(error)),
        }
    }

    /// Number of whole records that were read.
    fn records(&self) -> usize {
        self.bytes.len() / self.record
    }

    fn record(&self, index: usize) -> Option<&[u8]> {
        self.bytes.get(index * self.record..(index + 1) * self.record)
    }
}

/// Reason why a part has no more records.
enum Fault {
    Short(Truncation),
    Damaged { byte: u64, what: String },
    Io(std::io::Error),
}

struct Decoder {
    path: std::path::PathBuf,
    sources: Vec<Source>,
    unit: TimeUnit,
    code: PolarityCode,
    counter: TimeCounter,
    /// Number of events read, and number of rows left.
    events: u64,
    left: u64,
    count: u64,
}

impl Decoder {
    fn is_filling(&self, row: usize) -> bool {
        let number = |record: &[u8], offset: usize, number: Option<NumberType>| {
            Some(number?.read(record.get(offset..)?)?.value())
        };
        let values = self.sources.iter().flat_map(|source| {
            let record = source.record(row).unwrap_or_default();
            let read = source.fields.iter().filter(|(column, ..)| *column != Column::Ignored);
            read.map(move |(_, offset, kind)| number(record, *offset, *kind))
        });
        numbers::is_filling(values)
    }

    fn event(&mut self, row: usize) -> Result<Event, RecordingErrorKind> {
        self.events += 1;
        let mut event = Event { t: 0, x: 0, y: 0, polarity: Polarity::Off };
        for source in &self.sources {
            let record = source.record(row).unwrap_or_default();
            for (column, offset, number) in &source.fields {
                let number = number.and_then(|number| number.read(record.get(*offset..)?));
                if let Some(number) = number {
                    numbers::put(&mut event, self.events, *column, number, self.unit, self.code)?;
                }
            }
        }
        Ok(event)
    }
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let count = self.left.min(rows_at_once(&self.sources));
        let mut fault = None;
        for source in &mut self.sources {
            fault = fault.or(source.fill(count).err());
        }
        let rows = self.sources.iter().map(Source::records).min().unwrap_or(0);
        let written = numbers::written(0..rows, |row| self.is_filling(row));
        report.unwritten += (rows - written) as u64;
        for row in 0..written {
            let event = self.event(row).map_err(|kind| RecordingError::new(&self.path, kind))?;
            batch.push(Event { t: self.counter.time(event.t, report), ..event });
        }
        self.left -= count;
        match fault {
            None => Ok(self.left > 0),
            Some(Fault::Short(truncation)) => {
                report.truncated = Some(truncation);
                Ok(false)
            }
            Some(Fault::Damaged { byte, what }) => Err(RecordingError::damaged(&self.path, byte, what, Usable::Before)),
            Some(Fault::Io(error)) => Err(RecordingError::io(&self.path, error)),
        }
    }

    fn done(&self) -> Option<f64> {
        Some(share(self.count - self.left, self.count))
    }
}
