//! AEDAT 2.0, the format of jAER, of a DAVIS or a DVS128.
//!
//! Lines that begin with `#`, the first one `#!AER-DAT2.0`; then records of u32 address and u32 time in µs, big-endian.
//! Addresses count x from the right and y from below:
//!
//! | camera | column | row | polarity | no event |
//! |---|---|---|---|---|
//! | DAVIS | bits 12–21 | 22–30 | 11: 1 is ON | 31 (frames, inertial samples: see [`extras`]), 10 (signals) |
//! | DVS128 | bits 1–7 | 8–14 | 0: 0 is ON | 15 (signals) |
//!
//! The camera follows from the line `# AEChip:`; without one, from the addresses of the first records.

mod extras;

use std::path::Path;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::bytes::ByteReader;
use super::{
    Decode, FileFormat, Head, Opened, ReadReport, RecordingError, RecordingErrorKind, RecordingInformation,
    RecordingOptions,
};

const MAGIC: &[u8] = b"#!AER-DAT2.0";

/// AEDAT 2.0.
pub const FORMAT: FileFormat = FileFormat {
    frames: Some(extras::visit_frames),
    extras: Some(extras::open),
    ..FileFormat::of_events("AEDAT 2.0", |head| head.bytes.starts_with(MAGIC), open)
};

/// Bytes of an event.
const RECORD: usize = 8;
/// Bytes that are decoded at a time: whole records.
const BLOCK: u64 = 1 << 17;
/// No line of the header is longer.
const LONGEST_LINE: usize = 4096;
/// How many records are looked at where no chip is named.
const SAMPLE: usize = 2000;
/// What in the line of the chip tells its sensor.
const CHIPS: &[(&str, Sensor)] = &[
    ("DAVIS346", Sensor::new(346, 260)),
    ("DAVIS240", Sensor::new(240, 180)),
    ("SBRET10", Sensor::new(240, 180)),
    ("DAVIS640", Sensor::new(640, 480)),
];
const DVS128: Sensor = Sensor::new(128, 128);

/// How addresses are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    Davis(Sensor),
    Dvs128,
}

impl Layout {
    fn sensor(self) -> Sensor {
        match self {
            Self::Davis(sensor) => sensor,
            Self::Dvs128 => DVS128,
        }
    }
}

/// The lines at the top, and how many bytes they have. Data may begin with a `#` as well, but not with a line of text.
fn header(bytes: &[u8]) -> (Vec<&str>, usize) {
    let (mut lines, mut length) = (Vec::new(), 0);
    while let Some(rest) = bytes.get(length..).filter(|rest| rest.starts_with(b"#"))
        && let Some(end) = rest.iter().take(LONGEST_LINE).position(|&byte| byte == b'\n')
        && let Some(Ok(line)) = rest.get(..end).map(std::str::from_utf8)
        && !line.trim_end().contains(|character: char| character.is_control() && character != '\t')
    {
        lines.push(line.trim_end());
        length += end + 1;
    }
    (lines, length)
}

/// When the recording was made, as jAER writes it: `# created Thu Dec 03 14:55:00 CET 2015`.
fn created(lines: &[&str]) -> Option<String> {
    lines.iter().find_map(|line| line.strip_prefix('#')?.trim().strip_prefix("created ")).map(str::to_owned)
}

/// The layout, and what was taken for granted.
fn layout(lines: &[&str], records: &[u8], options: &RecordingOptions) -> Option<(Layout, Option<String>)> {
    let chip = lines.iter().find_map(|line| line.split_once("AEChip:")).map(|(_, chip)| chip.to_uppercase());
    if let Some(chip) = chip {
        if chip.contains("DVS128") {
            return Some((Layout::Dvs128, None));
        }
        if let Some((_, sensor)) = CHIPS.iter().find(|(name, _)| chip.contains(name)) {
            return Some((Layout::Davis(*sensor), None));
        }
    }
    let (records, _) = records.as_chunks::<8>();
    let short = |&[a, b, ..]: &[u8; 8]| a == 0 && b == 0;
    if !records.is_empty() && records.iter().take(SAMPLE).all(short) {
        return Some((Layout::Dvs128, Some("no chip is named: taken for a DVS128 by its addresses".to_owned())));
    }
    let sensor = options.sensor?;
    Some((Layout::Davis(sensor), Some("the chip is not known: taken for a DAVIS with the size asked for".to_owned())))
}

struct Decoder {
    file: ByteReader,
    information: RecordingInformation,
    layout: Layout,
    block: Vec<u8>,
    clock: Clock,
    /// Words of frames, of inertial samples, and signals.
    others: [u64; 3],
}

/// Makes times of 32 bits go on over their ends: the latest one as it stands in the file, and as it goes on.
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

/// Whether a word of a DAVIS is the level of a pixel, or part of an inertial sample.
fn is_level(word: u32) -> bool {
    word >> 31 == 1 && !is_sample(word)
}

/// Whether a word of a DAVIS is part of an inertial sample.
fn is_sample(word: u32) -> bool {
    word & 0x8000_0c00 == 0x8000_0c00
}

/// Whether a word of a DAVIS is an event.
fn is_event(word: u32) -> bool {
    word & 0x8000_0400 == 0
}

/// A file at its first record.
struct Start {
    file: ByteReader,
    layout: Layout,
    note: Option<String>,
    created: Option<String>,
    /// At the first event, if there is one among the first records.
    clock: Clock,
}

fn start(path: &Path, options: &RecordingOptions) -> Result<Start, RecordingError> {
    let head = Head::read(path)?;
    let (lines, length) = header(&head.bytes);
    let records = head.bytes.get(length..).unwrap_or_default();
    let Some((layout, note)) = layout(&lines, records, options) else {
        return Err(RecordingError::new(path, RecordingErrorKind::ChipUnknown));
    };
    let mut file = ByteReader::open(path)?;
    file.seek(length as u64)?;
    let mut clock = Clock::default();
    let words = records.as_chunks::<RECORD>().0.iter();
    let words = words.map(|&[a, b, c, d, time @ ..]| (u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes(time)));
    if let Some((_, time)) = words.into_iter().find(|(word, _)| is_event(*word)) {
        clock.time(time);
    }
    Ok(Start { file, layout, note, created: created(&lines), clock })
}

fn open(path: &Path, options: &RecordingOptions) -> Opened {
    let Start { file, layout, note, created, .. } = start(path, options)?;
    let information = RecordingInformation {
        format: FORMAT.name,
        sensor: Some(layout.sensor()),
        camera_name: None,
        began: created,
        notes: note.into_iter().collect(),
    };
    Ok(Box::new(Decoder { file, information, layout, block: Vec::new(), clock: Clock::default(), others: [0; 3] }))
}

/// The place of an address that counts from the other side; one that no sensor has if it is beyond.
fn mirrored(size: u16, address: u32) -> u16 {
    u16::try_from(address).ok().and_then(|address| size.checked_sub(1)?.checked_sub(address)).unwrap_or(u16::MAX)
}

impl Decoder {
    /// The event of a record; `None` if it is something else.
    fn event(&mut self, [a, b, c, d, e, f, g, h]: [u8; 8]) -> Option<Event> {
        let (address, time) = (u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([e, f, g, h]));
        let Sensor { width, height } = self.layout.sensor();
        let (taken, x, y, on) = match self.layout {
            Layout::Davis(_) => (is_event(address), address >> 12 & 0x3ff, address >> 22 & 0x1ff, address & 0x800 != 0),
            Layout::Dvs128 => (address & 0xffff_8000 == 0, address >> 1 & 0x7f, address >> 8 & 0x7f, address & 1 == 0),
        };
        if !taken {
            let is_davis = self.layout != Layout::Dvs128;
            let [levels, samples, signals] = &mut self.others;
            *match address {
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
    fn information(&self) -> &RecordingInformation {
        &self.information
    }

    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let mut block = std::mem::take(&mut self.block);
        let more = self.file.read_records::<RECORD>(&mut block, BLOCK, report)?;
        batch.extend(block.as_chunks().0.iter().filter_map(|record| self.event(*record)));
        for (name, count) in [extras::LEVELS, extras::SAMPLES, "signals"].into_iter().zip(self.others) {
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
    use crate::recording::testing;

    fn file(lines: &str, records: &[[u32; 2]]) -> Vec<u8> {
        let records = records.iter().flatten().flat_map(|value| value.to_be_bytes());
        format!("#!AER-DAT2.0\r\n{lines}").bytes().chain(records).collect()
    }

    const DAVIS: &str = "# created\r\n# AEChip: eu.seebetter.ini.chips.davis.Davis346red\r\n";

    fn davis(x: u32, y: u32, on: u32) -> u32 {
        ((259 - y) * 1024 + 345 - x) * 4096 + on * 2048
    }

    #[test]
    fn addresses_of_a_davis_made_by_hand() {
        let records = [
            [davis(0, 0, 1), 0x7fff_fffe],
            // A picture, a signal, an inertial sample.
            [0x8000_0000 | davis(5, 5, 0), 0x7fff_fffe],
            [davis(5, 5, 0) | 0x400, 0x7fff_fffe],
            [0x8000_0c00, 0x7fff_fffe],
            // Time goes on past the largest i32.
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
    fn addresses_of_a_dvs128_made_by_hand() {
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
    fn data_that_begin_with_a_hash_are_no_header() {
        // Row 140 from below: the first byte of the address is a `#`, and a line end follows in the time.
        let records = [[davis(9, 119, 1), 0x0a0a_0a0a]];
        let content = file(DAVIS, &records);
        assert_eq!(content[content.len() - 8], b'#');
        assert_eq!(testing::read(&content).events, [Event { t: 0x0a0a_0a0a, x: 9, y: 119, polarity: Polarity::On }]);
    }

    #[test]
    fn an_unknown_chip_needs_the_size_of_the_sensor() {
        let content = file("# AEChip: Cochlea\r\n", &[[davis(1, 2, 0), 3]]);
        assert!(testing::read(&content).error.unwrap().contains("--sensor"));
        let sensor = Some(Sensor::new(346, 260));
        let outcome = testing::read_with(&content, RecordingOptions { sensor, ..RecordingOptions::default() });
        assert_eq!(outcome.events, [Event { t: 3, x: 1, y: 2, polarity: Polarity::Off }]);
    }

    #[test]
    fn damage_loses_no_more_than_it_must() {
        let records: Vec<[u32; 2]> = (0..20).map(|index| [davis(index, 2 * index, index & 1), index * 1000]).collect();
        testing::check_damage(&file(DAVIS, &records));
    }
}
