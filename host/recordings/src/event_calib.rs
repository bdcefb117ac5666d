//! The binary format of EventCalib, published code for calibrating event cameras.
//!
//! The file has no header. Each event is a record of 25 bytes, little-endian: f64 time in seconds, f64 x, f64 y
//! (pixels), u8 polarity (0 or 1). The format is recognised by plausible values in the first records.

use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use evcal_core::event::{Event, Polarity};

use super::bytes::share;
use super::encode::{Encode, OutputFormat, WriteError};
use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, Head, OpenResult};
use crate::options::RecordingOptions;
use crate::read_report::{ReadReport, Truncation};
use crate::reader::{Decode, MAX_SENSOR_SIZE, Opened, RecordingInformation};

/// EventCalib binary.
pub const FORMAT: FileFormat =
    FileFormat { output: Some(&OUTPUT), ..FileFormat::of_events("EventCalib binary", recognise, open) };

/// EventCalib binary as an output format.
pub const OUTPUT: OutputFormat = OutputFormat {
    title: Some("EventCalib"),
    contains_sensor: false,
    ..OutputFormat::of_events("bin", &["bin"], |file, _| {
        Ok(Box::new(Encoder(BufWriter::with_capacity(1 << 18, file()?))))
    })
};

const RECORD: usize = 25;
const BATCH: usize = 32_768;
/// Number of records that must have plausible values.
const SAMPLE: usize = 64;
/// Limit of times in seconds (3000 years).
const MAX_TIME: f64 = 1e11;

/// A record, split into its fields.
struct Record {
    t: f64,
    x: f64,
    y: f64,
    polarity: u8,
}

fn record(bytes: &[u8; RECORD]) -> Record {
    let field = |index: usize| {
        let mut field = [0; 8];
        field.copy_from_slice(&bytes[8 * index..8 * index + 8]);
        f64::from_le_bytes(field)
    };
    Record { t: field(0), x: field(1), y: field(2), polarity: bytes[24] }
}

fn open(path: &Path, _: &RecordingOptions) -> OpenResult {
    let io = |error| RecordingError::io(path, error);
    let file = File::open(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    let information = RecordingInformation {
        format: FORMAT.name,
        notes: vec!["the file has no header: assumed EventCalib records (seconds, x, y, polarity)".to_owned()],
        ..RecordingInformation::default()
    };
    let file = BufReader::with_capacity(1 << 18, file);
    Ok(Opened::new(information, Decoder { path: path.to_owned(), file, records: 0, length }))
}

fn recognise(head: &Head) -> bool {
    let (records, _) = head.bytes.as_chunks::<RECORD>();
    let whole_pixel = |value: f64| (0.0..=f64::from(MAX_SENSOR_SIZE)).contains(&value) && value.fract() == 0.0;
    let mut latest = f64::NEG_INFINITY;
    !records.is_empty()
        && records.iter().take(SAMPLE).map(record).all(|record| {
            let in_order = record.t >= latest - 0.1;
            latest = record.t;
            in_order
                && record.t.abs() < MAX_TIME
                // Other binary files, read as f64, often contain zeros and tiny numbers.
                && (record.t == 0.0 || record.t.abs() > 1e-9)
                && whole_pixel(record.x)
                && whole_pixel(record.y)
                && record.polarity <= 1
        })
        && records.iter().take(SAMPLE).any(|bytes| bytes.iter().any(|&byte| byte != 0))
}

struct Decoder {
    path: PathBuf,
    file: BufReader<File>,
    records: u64,
    /// Length of the file in bytes.
    length: u64,
}

impl Decoder {
    /// Reads the next record; `None` at the end of the file.
    fn next_record(&mut self, report: &mut ReadReport) -> Result<Option<[u8; RECORD]>, RecordingError> {
        let mut bytes = [0; RECORD];
        let mut length = 0;
        while let Some(rest) = bytes.get_mut(length..).filter(|rest| !rest.is_empty()) {
            match self.file.read(rest) {
                Ok(0) => {
                    if length > 0 {
                        let byte = self.records * RECORD as u64;
                        let lost = format!("{length} of {RECORD} bytes of an event are left");
                        report.truncated = Some(Truncation { byte, lost });
                    }
                    return Ok(None);
                }
                Ok(count) => length += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(RecordingError::io(&self.path, error)),
            }
        }
        self.records += 1;
        Ok(Some(bytes))
    }
}

/// Decodes the event in record number `index`, from 0.
fn event(record: &Record, index: u64) -> Result<Event, RecordingErrorKind> {
    let error = |what: String| RecordingErrorKind::Event { event: index + 1, what };
    // NaN fails the comparison too.
    let is_time = record.t.abs() < MAX_TIME;
    if !is_time {
        return Err(error(format!("its time, {} s, is not a time; the file is damaged there", record.t)));
    }
    let pixel = |name, value: f64| {
        // Values outside the range of u16 saturate.
        let whole = value as u16;
        if f64::from(whole) == value {
            Ok(whole)
        } else if value.is_finite() && value.fract() == 0.0 {
            // No sensor has this coordinate, so the reader drops the event as out of range.
            Ok(u16::MAX)
        } else {
            Err(error(format!(
                "its {name}, {value}, is not a whole pixel; raw events are needed, not undistorted ones"
            )))
        }
    };
    let polarity = match record.polarity {
        0 => Polarity::Off,
        1 => Polarity::On,
        other => return Err(error(format!("its polarity is {other}, not 0 or 1; the file is damaged there"))),
    };
    let microseconds = record.t * 1e6;
    // Rounds half away from zero, without the library call of f64::round.
    let t = (microseconds + 0.5f64.copysign(microseconds)) as i64;
    Ok(Event { t, x: pixel("x", record.x)?, y: pixel("y", record.y)?, polarity })
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        while batch.len() < BATCH {
            let (records, _) = self.file.buffer().as_chunks();
            let decoded = (self.records..).zip(records).map(|(index, bytes)| event(&record(bytes), index));
            let before = batch.len();
            let result = decoded.take(BATCH - before).try_for_each(|event| event.map(|event| batch.push(event)));
            let count = batch.len() - before;
            self.file.consume(count * RECORD);
            self.records += count as u64;
            // The buffer is empty or ends within a record, unless it holds an error or the batch is full.
            result.map_err(|kind| RecordingError::new(&self.path, kind))?;
            if batch.len() < BATCH {
                let index = self.records;
                let Some(bytes) = self.next_record(report)? else {
                    return Ok(false);
                };
                batch.push(event(&record(&bytes), index).map_err(|kind| RecordingError::new(&self.path, kind))?);
            }
        }
        Ok(true)
    }

    fn done(&self) -> Option<f64> {
        Some(share(self.records * RECORD as u64, self.length))
    }
}

/// Encoder of EventCalib records.
struct Encoder<W>(W);

impl<W: Write> Encode for Encoder<W> {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        for event in events {
            let mut bytes = [0; RECORD];
            bytes[..8].copy_from_slice(&(event.t as f64 / 1e6).to_le_bytes());
            bytes[8..16].copy_from_slice(&f64::from(event.x).to_le_bytes());
            bytes[16..24].copy_from_slice(&f64::from(event.y).to_le_bytes());
            bytes[24] = event.polarity.index() as u8;
            self.0.write_all(&bytes)?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        Ok(self.0.flush()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Recording;

    fn bytes(t: f64, x: f64, y: f64, polarity: u8) -> Vec<u8> {
        [t.to_le_bytes(), x.to_le_bytes(), y.to_le_bytes()].concat().into_iter().chain([polarity]).collect()
    }

    fn read(content: &[u8]) -> (Vec<Event>, Option<String>) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.bin");
        std::fs::write(&path, content).unwrap();
        let opened = Recording::new(&path, RecordingOptions::default()).and_then(|recording| recording.open());
        let mut reader = match opened {
            Ok(reader) => reader,
            Err(error) => return (Vec::new(), Some(error.to_string())),
        };
        let (mut all, mut batch) = (Vec::new(), Vec::new());
        loop {
            match reader.next_batch(&mut batch) {
                Ok(true) => all.extend_from_slice(&batch),
                Ok(false) => return (all, None),
                Err(error) => return (all, Some(error.to_string())),
            }
        }
    }

    #[test]
    fn a_record_has_the_published_layout() {
        // t = 1.5 s, x = 3, y = 260, ON, as bytes.
        let mut content = vec![0, 0, 0, 0, 0, 0, 0xf8, 0x3f, 0, 0, 0, 0, 0, 0, 0x08, 0x40];
        content.extend_from_slice(&[0, 0, 0, 0, 0, 0x40, 0x70, 0x40, 1]);
        assert_eq!(read(&content), (vec![Event { t: 1_500_000, x: 3, y: 260, polarity: Polarity::On }], None));
    }

    #[test]
    fn an_invalid_record_is_named_and_the_events_before_it_are_kept() {
        let good: Vec<u8> = (0..100).flat_map(|index| bytes(f64::from(index) * 1e-3, 1.0, 2.0, 0)).collect();
        for (bad, part) in [
            (bytes(f64::NAN, 1.0, 1.0, 0), "NaN"),
            (bytes(f64::INFINITY, 1.0, 1.0, 0), "inf"),
            (bytes(0.2, f64::NAN, 1.0, 0), "its x"),
            (bytes(0.2, 1.0, 1.25, 0), "1.25"),
            (bytes(0.2, 1.0, 1.0, 7), "polarity is 7"),
        ] {
            let (events, error) = read(&[good.as_slice(), &bad, &good].concat());
            let error = error.unwrap();
            assert_eq!(events.len(), 100);
            assert!(error.contains("event 101") && error.contains(part), "{error}");
        }
    }

    #[test]
    fn other_binary_files_are_not_recognised() {
        let pseudorandom =
            |seed: u32| (0..5000u32).map(move |index| ((index ^ seed).wrapping_mul(2_654_435_761) >> 24) as u8);
        for content in [
            vec![0; 2500],
            vec![0xff; 2500],
            pseudorandom(1).collect(),
            bytes(f64::NAN, 1.0, 1.0, 0),
            bytes(1.0, 1.5, 1.0, 0),
            bytes(1.0, -1.0, 1.0, 0),
            bytes(1.0, 1.0, 1.0, 3),
            [bytes(9.0, 1.0, 1.0, 1), bytes(1.0, 1.0, 1.0, 1)].concat(),
            bytes(1.0, 1.0, 1.0, 1)[..24].to_vec(),
        ] {
            assert!(read(&content).1.unwrap().contains("unknown format"));
        }
    }
}
