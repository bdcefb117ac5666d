//! AEDAT 2.0, the format of jAER.
//!
//! The file consists of lines that begin with `#` ([`header`]), then records of u32 address and u32 time in µs,
//! big-endian. In addresses, x counts from the right and y from below:
//!
//! | camera | column | row | polarity | not an event if set |
//! |---|---|---|---|---|
//! | DAVIS | bits 12–21 | 22–30 | 11: 1 is ON | 31 (frames, IMU samples: see [`extras`]), 10 (signals) |
//! | DVS128 | bits 1–7 | 8–14 | 0: 0 is ON | 15 (signals) |
//!
//! If several DAVIS were recorded together, the lowest 4 bits of an event are the number of its camera (jAER,
//! `MultiCameraApsDvsEvent`). Frames and IMU samples of such files are not read.
//!
//! The camera is determined by the line `# AEChip:`, or without one by the addresses of the first records.

mod extras;
mod header;

use std::collections::BTreeMap;
use std::path::Path;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::bytes::ByteReader;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, OpenResult, StreamSummary, Uses};
use crate::options::{FormatOption, RecordingOptions};
use crate::read_report::ReadReport;
use crate::reader::{Decode, Opened, RecordingInformation};
use header::{Header, Ranges};

const MAGIC: &[u8] = b"#!AER-DAT2.0";

/// AEDAT 2.0.
pub const FORMAT: FileFormat = FileFormat {
    frames: Some(extras::items),
    extras: Some(extras::open),
    streams: summarise,
    uses: Uses { stream: true, growth: true, ..Uses::NONE },
    ..FileFormat::of_events("AEDAT 2.0", |head| head.bytes.starts_with(MAGIC), open)
};

/// Size of a record in bytes.
const RECORD: usize = 8;
/// Number of bytes that are decoded at a time; a multiple of [`RECORD`].
const BLOCK: u64 = 1 << 17;
/// Number of records from which the camera is determined if no chip is named.
const SAMPLE: u64 = 2000;
/// Parts of chip names, with the sensor of the chip.
const CHIPS: &[(&str, Sensor)] = &[
    ("DAVIS346", Sensor::new(346, 260)),
    // Spelling of some exporters.
    ("DAVI346", Sensor::new(346, 260)),
    ("DAVIS240", Sensor::new(240, 180)),
    ("SBRET10", Sensor::new(240, 180)),
    ("DAVIS640", Sensor::new(640, 480)),
    ("DAVIS128", Sensor::new(128, 128)),
];
const DVS128: Sensor = Sensor::new(128, 128);
/// Part of the chip name of several cameras that were recorded together.
const SEVERAL: &str = "MULTI";
/// Bits of an event that contain the number of its camera, if there are several.
const CAMERA: u32 = 0xf;

/// Layout of the addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    Davis(Sensor),
    /// Several cameras with a sensor of this size each; the camera with this number is read.
    SeveralDavis(Sensor, u32),
    Dvs128,
}

impl Layout {
    fn sensor(self) -> Sensor {
        match self {
            Self::Davis(sensor) | Self::SeveralDavis(sensor, _) => sensor,
            Self::Dvs128 => DVS128,
        }
    }
}

/// Splits a record into address and time.
fn words([a, b, c, d, e, f, g, h]: [u8; RECORD]) -> (u32, u32) {
    (u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([e, f, g, h]))
}

/// Determines the layout from the header and the first `records`. Also returns a note about an assumption, if one was
/// made.
fn layout(
    header: &Header,
    records: &[[u8; RECORD]],
    options: &RecordingOptions,
) -> Result<(Layout, Option<String>), RecordingErrorKind> {
    let sensor = match &header.chip {
        Some(chip) if chip.contains("DVS128") => return Ok((Layout::Dvs128, None)),
        Some(chip) => {
            let known = CHIPS.iter().find(|(name, _)| chip.contains(name)).map(|&(_, sensor)| sensor);
            if known.is_none() && !chip.contains("DAVIS") {
                return Err(RecordingErrorKind::Chip(chip.clone()));
            }
            if chip.contains(SEVERAL) {
                let sensor = known.or(options.sensor).ok_or(RecordingErrorKind::ChipUnknown)?;
                return several(sensor, records, options);
            }
            known
        }
        None => None,
    };
    if options.stream.is_some() {
        return Err(RecordingErrorKind::NoEffect { option: FormatOption::Stream, format: "AEDAT 2.0 of one camera" });
    }
    if let Some(sensor) = sensor {
        return Ok((Layout::Davis(sensor), None));
    }
    if !records.is_empty() && header.chip.is_none() && records.iter().all(|record| words(*record).0 >> 16 == 0) {
        return Ok((
            Layout::Dvs128,
            Some("the file names no chip: assumed a DVS128 because of its addresses".to_owned()),
        ));
    }
    let sensor = options.sensor.ok_or(RecordingErrorKind::ChipUnknown)?;
    Ok((Layout::Davis(sensor), Some("the chip is unknown: assumed a DAVIS of the requested size".to_owned())))
}

/// Returns the layout for several cameras: reads the requested one, or the camera of the first event.
fn several(
    sensor: Sensor,
    records: &[[u8; RECORD]],
    options: &RecordingOptions,
) -> Result<(Layout, Option<String>), RecordingErrorKind> {
    let first = || records.iter().map(|record| words(*record).0).find(|word| is_event(*word)).unwrap_or(0) & CAMERA;
    let camera = match &options.stream {
        Some(wanted) => wanted.parse().ok().filter(|camera| *camera <= CAMERA).ok_or_else(|| {
            let available = format!("numbers of cameras, 0 to {CAMERA}");
            RecordingErrorKind::NoSuchStream { wanted: wanted.clone(), available }
        })?,
        None => first(),
    };
    let note = format!("several cameras were recorded together: events of camera {camera} are read");
    Ok((Layout::SeveralDavis(sensor, camera), Some(note)))
}

struct Decoder {
    file: ByteReader,
    layout: Layout,
    block: Vec<u8>,
    clock: Clock,
    /// Counts of words of frames, words of IMU samples, signals, and events of other cameras.
    others: [u64; 4],
}

/// Extends 32-bit times beyond their overflow. Contains the latest time as in the file and its extension.
#[derive(Clone, Copy, Default)]
struct Clock(Option<(u32, i64)>);

impl Clock {
    fn time(&mut self, time: u32) -> i64 {
        let (before, latest) = self.0.unwrap_or((time, i64::from(time.cast_signed())));
        let t = latest.saturating_add(time.wrapping_sub(before).cast_signed().into());
        self.0 = Some((time, t));
        t
    }
}

/// `true` if a word of a DAVIS is the level of a pixel.
fn is_level(word: u32) -> bool {
    word >> 31 == 1 && !is_sample(word)
}

/// `true` if a word of a DAVIS is part of an IMU sample.
fn is_sample(word: u32) -> bool {
    word & 0x8000_0c00 == 0x8000_0c00
}

/// `true` if a word of a DAVIS is an event.
fn is_event(word: u32) -> bool {
    word & 0x8000_0400 == 0
}

/// An open file, positioned at its first record.
struct Start {
    file: ByteReader,
    layout: Layout,
    note: Option<String>,
    created: Option<String>,
    ranges: Ranges,
    /// Clock that starts at the first event, if there is one among the first records.
    clock: Clock,
}

fn start(path: &Path, options: &RecordingOptions) -> Result<Start, RecordingError> {
    let mut file = ByteReader::following(path, options.growth.as_ref())?;
    let header = header::read(&mut file)?;
    let first = file.position();
    let mut sample = Vec::new();
    file.read(&mut sample, SAMPLE * RECORD as u64)?;
    file.seek(first)?;
    let (records, _) = sample.as_chunks();
    let (layout, note) = layout(&header, records, options).map_err(|kind| RecordingError::new(path, kind))?;
    let mut clock = Clock::default();
    if let Some((_, time)) = records.iter().map(|record| words(*record)).find(|(word, _)| is_event(*word)) {
        clock.time(time);
    }
    Ok(Start { file, layout, note, created: header.created, ranges: header.ranges, clock })
}

fn open(path: &Path, options: &RecordingOptions) -> OpenResult {
    let Start { file, layout, note, created, .. } = start(path, options)?;
    let information = RecordingInformation {
        format: FORMAT.name,
        sensor: Some(layout.sensor()),
        camera_name: None,
        began: created,
        notes: note.into_iter().collect(),
    };
    let decoder = Decoder { file, layout, block: Vec::new(), clock: Clock::default(), others: [0; 4] };
    Ok(Opened::new(information, decoder))
}

/// Counts the events of each camera, if there are several.
fn summarise(path: &Path, options: &RecordingOptions) -> Result<Vec<StreamSummary>, RecordingError> {
    let Start { mut file, layout: Layout::SeveralDavis(..), mut clock, .. } = start(path, options)? else {
        return Ok(Vec::new());
    };
    let (mut cameras, mut block, mut more) = (BTreeMap::new(), Vec::new(), true);
    while more {
        more = file.read_records::<RECORD>(&mut block, BLOCK, &mut ReadReport::default())?;
        for (word, time) in block.as_chunks().0.iter().map(|record| words(*record)).filter(|(word, _)| is_event(*word))
        {
            let camera = word & CAMERA;
            let name = || format!("{camera} camera {camera} (events)");
            let empty = || StreamSummary::new(name());
            let summary: &mut StreamSummary = cameras.entry(camera).or_insert_with(empty);
            let t = clock.time(time);
            summary.elements += 1;
            summary.extend(Some((t, t)));
        }
    }
    Ok(cameras.into_values().collect())
}

/// Converts an address that counts from the opposite side. Returns a coordinate outside any sensor if the address is
/// too large.
fn mirrored(size: u16, address: u32) -> u16 {
    u16::try_from(address).ok().and_then(|address| size.checked_sub(1)?.checked_sub(address)).unwrap_or(u16::MAX)
}

impl Decoder {
    /// Decodes the event of a record; counts other records and returns `None`.
    fn event(&mut self, record: [u8; RECORD]) -> Option<Event> {
        let (address, time) = words(record);
        let Sensor { width, height } = self.layout.sensor();
        let of_davis = || (address >> 12 & 0x3ff, address >> 22 & 0x1ff, address & 0x800 != 0);
        let (taken, (x, y, on)) = match self.layout {
            Layout::Davis(_) => (is_event(address), of_davis()),
            Layout::SeveralDavis(_, camera) => (is_event(address) && address & CAMERA == camera, of_davis()),
            Layout::Dvs128 => {
                (address & 0xffff_8000 == 0, (address >> 1 & 0x7f, address >> 8 & 0x7f, address & 1 == 0))
            }
        };
        if !taken {
            let is_davis = self.layout != Layout::Dvs128;
            let [levels, samples, signals, others] = &mut self.others;
            *match address {
                word if is_davis && is_event(word) => others,
                word if is_davis && is_sample(word) => samples,
                word if is_davis && is_level(word) => levels,
                _ => signals,
            } += 1;
            return None;
        }
        let t = self.clock.time(time);
        let polarity = if on { Polarity::On } else { Polarity::Off };
        Some(Event { t, x: mirrored(width, x), y: mirrored(height, y), polarity })
    }
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let mut block = std::mem::take(&mut self.block);
        let more = self.file.read_records::<RECORD>(&mut block, BLOCK, report)?;
        batch.extend(block.as_chunks().0.iter().filter_map(|record| self.event(*record)));
        let names = [extras::LEVELS, extras::SAMPLES, "signals", "events of other cameras"];
        for (name, count) in names.into_iter().zip(self.others) {
            if count > 0 {
                report.other_packets.insert(name.to_owned(), count);
            }
        }
        self.block = block;
        Ok(more)
    }

    fn done(&self) -> Option<f64> {
        Some(self.file.done())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn file(lines: &str, records: &[[u32; 2]]) -> Vec<u8> {
        let records = records.iter().flatten().flat_map(|value| value.to_be_bytes());
        format!("#!AER-DAT2.0\r\n{lines}").bytes().chain(records).collect()
    }

    const DAVIS: &str = "# created\r\n# AEChip: eu.seebetter.ini.chips.davis.Davis346red\r\n";

    fn davis(x: u32, y: u32, on: u32) -> u32 {
        ((259 - y) * 1024 + 345 - x) * 4096 + on * 2048
    }

    #[test]
    fn addresses_of_a_davis_are_decoded() {
        let records = [
            [davis(0, 0, 1), 0x7fff_fffe],
            // A frame, a signal, an IMU sample.
            [0x8000_0000 | davis(5, 5, 0), 0x7fff_fffe],
            [davis(5, 5, 0) | 0x400, 0x7fff_fffe],
            [0x8000_0c00, 0x7fff_fffe],
            // The time continues beyond the largest i32.
            [davis(345, 259, 0), 0x8000_0001],
            // Row 306 from below.
            [306 << 22, 0x8000_0002],
        ];
        let outcome = testing::read(&file(DAVIS, &records));
        let t = 0x7fff_fffe;
        let expected = [
            Event { t, x: 0, y: 0, polarity: Polarity::On },
            Event { t: t + 3, x: 345, y: 259, polarity: Polarity::Off },
        ];
        assert_eq!((outcome.events.as_slice(), outcome.error), (expected.as_slice(), None));
        assert_eq!((outcome.report.out_of_range, outcome.report.other_packets.values().sum::<u64>()), (1, 3));
        assert_eq!(outcome.information.unwrap().sensor, Some(Sensor::new(346, 260)));
    }

    #[test]
    fn addresses_of_a_dvs128_are_decoded() {
        // Column 3 from the right, row 7 from below, once ON and once OFF; then a signal.
        let records = [[7 << 8 | 3 << 1, 5], [7 << 8 | 3 << 1 | 1, 6], [1 << 15, 7]];
        for lines in ["# AEChip: ch.unizh.ini.jaer.chip.retina.DVS128\r\n", "# no chip\r\n"] {
            let outcome = testing::read(&file(lines, &records[..2]));
            let event = |t, polarity| Event { t, x: 124, y: 120, polarity };
            assert_eq!(outcome.events, [event(5, Polarity::On), event(6, Polarity::Off)]);
        }
        let outcome = testing::read(&file("# AEChip: DVS128\r\n", &records));
        assert_eq!((outcome.events.len(), outcome.report.other_packets.len()), (2, 1));
    }

    #[test]
    fn data_that_begin_with_a_hash_are_not_part_of_the_header() {
        // Row 140 from below: the first byte of the address is a `#`, and a line end follows in the time.
        let records = [[davis(9, 119, 1), 0x0a0a_0a0a]];
        let content = file(DAVIS, &records);
        assert_eq!(content[content.len() - 8], b'#');
        assert_eq!(testing::read(&content).events, [Event { t: 0x0a0a_0a0a, x: 9, y: 119, polarity: Polarity::On }]);
    }

    #[test]
    fn a_chip_with_an_unknown_address_format_is_rejected() {
        let content = file("# AEChip: ch.unizh.ini.jaer.chip.retina.DVXplorer\r\n", &[[davis(1, 2, 0), 3]]);
        let sensor = Some(Sensor::new(640, 480));
        let error = testing::read_with(&content, RecordingOptions { sensor, ..RecordingOptions::default() }).error;
        assert!(error.as_ref().is_some_and(|error| error.contains("RETINA.DVXPLORER")), "{error:?}");
    }

    /// DHP19 has four cameras per file.
    #[test]
    fn one_of_several_cameras_is_read() {
        let chip = "# AEChip: ch.unizh.ini.jaer.chip.multicamera.MultiDAVIS346BCameraChip\r\n";
        let records: Vec<[u32; 2]> = (0..12).map(|index| [davis(index, 7, 1) | (3 - index % 4), index]).collect();
        let content = file(chip, &records);
        let columns = |outcome: &testing::Outcome| outcome.events.iter().map(|event| event.x).collect::<Vec<_>>();
        let first = testing::read(&content);
        assert_eq!((columns(&first), first.report.other_packets.len()), (vec![0, 4, 8], 1));
        let with = |stream: &str| RecordingOptions { stream: Some(stream.to_owned()), ..RecordingOptions::default() };
        assert_eq!(columns(&testing::read_with(&content, with("1"))), [2, 6, 10]);
        assert!(testing::read_with(&content, with("left")).error.unwrap().contains("0 to 15"));
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("several.aedat");
        std::fs::write(&path, &content).unwrap();
        let streams = summarise(&path, &RecordingOptions::default()).unwrap();
        let expected = [(0, (3, 11)), (1, (2, 10)), (2, (1, 9)), (3, (0, 8))];
        let counts = |(camera, times)| (format!("{camera} camera {camera} (events)"), 3, Some(times));
        assert_eq!(
            streams.into_iter().map(|one| (one.name, one.elements, one.times_us)).collect::<Vec<_>>(),
            expected.map(counts)
        );
        // A file of a single camera has no camera numbers.
        assert!(
            testing::read_with(&file(DAVIS, &records), with("1"))
                .error
                .unwrap()
                .contains("the choice of a stream has no effect")
        );
    }

    #[test]
    fn an_unknown_chip_needs_the_size_of_the_sensor() {
        let content = file("# AEChip: Davis999\r\n", &[[davis(1, 2, 0), 3]]);
        assert!(testing::read(&content).error.unwrap().contains("how many pixels"));
        let sensor = Some(Sensor::new(346, 260));
        let outcome = testing::read_with(&content, RecordingOptions { sensor, ..RecordingOptions::default() });
        assert_eq!(outcome.events, [Event { t: 3, x: 1, y: 2, polarity: Polarity::Off }]);
    }

    #[test]
    fn damage_loses_as_little_as_possible() {
        let records: Vec<[u32; 2]> = (0..20).map(|index| [davis(index, 2 * index, index & 1), index * 1000]).collect();
        testing::check_damage(&file(DAVIS, &records));
    }
}
