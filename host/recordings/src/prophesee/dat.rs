//! DAT: decoded events, 8 bytes each.
//!
//! The header is followed by a byte with the kind of the records (0 or 12: events) and a byte with their size, 8. A
//! record is u32 time in µs and u32 data, little-endian:
//!
//! | version | column | row | polarity |
//! |---|---|---|---|
//! | 1 | bits 0–8 | 9–16 | 17 |
//! | 2 | bits 0–13 | 14–27 | 28–31 |
//!
//! If the header states no version, kind 12 or an event with a bit set among 18–31 means version 2. Time wraps after
//! 71.6 min.

use std::path::Path;

use evcal_core::event::{Event, Polarity};

use super::header::Header;
use crate::bytes::ByteReader;
use crate::error::RecordingError;
use crate::format::{FileFormat, Head, OpenResult, Uses};
use crate::options::RecordingOptions;
use crate::read_report::ReadReport;
use crate::reader::{Decode, Opened, RecordingInformation};

/// Prophesee DAT.
pub const FORMAT: FileFormat = FileFormat {
    uses: Uses { growth: true, ..Uses::NONE },
    ..FileFormat::of_events("Prophesee DAT", |head| layout(head).is_some(), open)
};

/// Size of an event in bytes.
const RECORD: usize = 8;
/// Number of bytes that are decoded at a time; a multiple of [`RECORD`].
const BLOCK: u64 = 1 << 18;
/// Kinds of records that are events.
const EVENT_KINDS: [u8; 2] = [0, 12];

/// Kind of events in version 2.
const KIND_OF_VERSION_2: u8 = 12;
/// Number of bits that an event of version 1 uses.
const BITS_OF_VERSION_1: u32 = 18;
/// Half of the range of times (µs).
const HALF_TURN: i64 = 1 << 31;

/// Returns the header, if records of events follow it.
fn layout(head: &Head) -> Option<Header> {
    let header = Header::parse(&head.bytes)?;
    let &[kind, size] = head.bytes.get(header.length..)?.first_chunk()?;
    let of_camera = header.get("evt").or_else(|| header.get("format")).is_some();
    (EVENT_KINDS.contains(&kind) && size == 8 && !of_camera).then_some(header)
}

/// `true` if the events after a header of `length` bytes must be of version 2.
fn is_version_2(head: &Head, length: usize) -> bool {
    let Some(([kind, _], records)) = head.bytes.get(length..).and_then(<[u8]>::split_first_chunk) else { return false };
    let data = |&[.., a, b, c, d]: &[u8; RECORD]| u32::from_le_bytes([a, b, c, d]);
    *kind == KIND_OF_VERSION_2 || records.as_chunks().0.iter().any(|record| data(record) >> BITS_OF_VERSION_1 != 0)
}

struct Decoder {
    file: ByteReader,
    version_1: bool,
    block: Vec<u8>,
    /// Latest time as in the file, and the offset of the wraps so far (µs).
    latest: u32,
    turns: i64,
    /// Time in µs from which the times count.
    zero: i64,
}

fn open(path: &Path, options: &RecordingOptions) -> OpenResult {
    let mut file = ByteReader::following(path, options.growth.as_ref())?;
    let head = Head::read(path)?;
    let header = layout(&head).ok_or_else(|| file.damaged(0, "the header has changed"))?;
    file.seek(header.length as u64 + 2)?;
    let (zero, mut notes) = header.zero();
    let version = header.get("Version").or_else(|| header.get("version"));
    let version_1 =
        version.map_or_else(|| !is_version_2(&head, header.length), |version| version.split('.').next() == Some("1"));
    if version.is_none() {
        let version = if version_1 { 1 } else { 2 };
        notes.push(format!("the header states no version: assumed version {version} because of its events"));
    }
    let (sensor, camera_name) = (header.sensor(), header.camera_name());
    let information = RecordingInformation { format: FORMAT.name, sensor, camera_name, began: header.date(), notes };
    Ok(Opened::new(information, Decoder { file, version_1, block: Vec::new(), latest: 0, turns: 0, zero }))
}

impl Decoder {
    fn event(&mut self, record: [u8; RECORD]) -> Event {
        let [a, b, c, d, e, f, g, h] = record;
        let (t, data) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        let step = i64::from(t) - i64::from(self.latest);
        if step < -HALF_TURN {
            self.turns = self.turns.saturating_add(2 * HALF_TURN);
        } else if step > HALF_TURN && self.turns > 0 {
            // An event from before the wrap.
            self.turns -= 2 * HALF_TURN;
        }
        self.latest = t;
        let bits = |first: u32, count: u32| (data >> first & ((1 << count) - 1)) as u16;
        let (x, y, on) = match self.version_1 {
            true => (bits(0, 9), bits(9, 8), bits(17, 1)),
            false => (bits(0, 14), bits(14, 14), bits(28, 4)),
        };
        let polarity = if on == 0 { Polarity::Off } else { Polarity::On };
        Event { t: self.turns.saturating_add(t.into()).saturating_add(self.zero), x, y, polarity }
    }
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let mut block = std::mem::take(&mut self.block);
        let more = self.file.read_records::<RECORD>(&mut block, BLOCK, report)?;
        batch.extend(block.as_chunks().0.iter().map(|record| self.event(*record)));
        self.block = block;
        Ok(more)
    }

    fn done(&self) -> Option<f64> {
        Some(self.file.done())
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::testing;

    const HEADER: &[u8] = b"% Data file containing CD events.\n% Version 2\n% Height 240\n% Width 304\n";

    fn file(header: &[u8], records: &[[u32; 2]]) -> Vec<u8> {
        file_of_kind(12, header, records)
    }

    fn file_of_kind(kind: u8, header: &[u8], records: &[[u32; 2]]) -> Vec<u8> {
        let records = records.iter().flatten().flat_map(|value| value.to_le_bytes());
        header.iter().copied().chain([kind, 8]).chain(records).collect()
    }

    #[test]
    fn records_are_decoded() {
        // (303, 239) ON; (5, 1) OFF; in all 71.6 min later.
        let records = [[0xffff_fff0, 0x103b_c12f], [0xffff_ffff, 0x0000_4005], [4, 0x1000_0000]];
        let outcome = testing::read(&file(HEADER, &records));
        let event = |t, x, y, polarity| Event { t, x, y, polarity };
        let expected = [
            event(0xffff_fff0, 303, 239, Polarity::On),
            event(0xffff_ffff, 5, 1, Polarity::Off),
            event((1 << 32) + 4, 0, 0, Polarity::On),
        ];
        assert_eq!((outcome.events.as_slice(), outcome.error), (expected.as_slice(), None));
        let information = outcome.information.unwrap();
        assert_eq!((information.format, information.sensor), ("Prophesee DAT", Some(Sensor::new(304, 240))));
    }

    /// faery counts times from the first event and writes its time into the header.
    #[test]
    fn the_time_of_the_header_is_added() {
        let header = b"% Version 2\n% Height 240\n% Width 304\n% T0 1000000\n";
        let times: Vec<i64> =
            testing::read(&file(header, &[[0, 0], [50, 0]])).events.iter().map(|event| event.t).collect();
        assert_eq!(times, [1_000_000, 1_000_050]);
    }

    /// A late event must not shift all later times by 71.6 min.
    #[test]
    fn events_from_before_the_wrap_may_follow_it() {
        let records = [0xffff_fff0, 4, 0xffff_ffff, 5].map(|t| [t, 0]);
        let times: Vec<i64> = testing::read(&file(HEADER, &records)).events.iter().map(|event| event.t).collect();
        let wrap = 1 << 32;
        assert_eq!(times, [wrap - 16, wrap - 1, wrap + 4, wrap + 5]);
    }

    #[test]
    fn version_1_uses_fewer_bits() {
        // The 9 bits of 303, the 8 bits of 239, ON.
        let records = [[7, (1 << 17) + (239 << 9) + 303]];
        for (kind, header) in [(0, b"% Version 1\n".as_slice()), (12, b"% Version 1\n"), (0, b"% Date 2015\n")] {
            let outcome = testing::read(&file_of_kind(kind, header, &records));
            assert_eq!(outcome.events, [Event { t: 7, x: 303, y: 239, polarity: Polarity::On }]);
        }
    }

    /// Read as version 1, half of the events of such a file would be at wrong pixels.
    #[test]
    fn version_2_is_recognised_from_the_events() {
        // (303, 239) ON, then (5, 1) OFF, whose bits would all be valid in version 1.
        let records = [[7, 0x103b_c12f], [8, 0x0000_4005]];
        let event = |t, x, y, polarity| Event { t, x, y, polarity };
        let expected = [event(7, 303, 239, Polarity::On), event(8, 5, 1, Polarity::Off)];
        for (kind, from) in [(12, 0), (12, 1), (0, 0)] {
            let outcome = testing::read(&file_of_kind(kind, b"% Date 2019\n", &records[from..]));
            assert_eq!(outcome.events, expected[from..]);
            assert!(outcome.information.unwrap().notes.iter().any(|note| note.contains("version 2")));
        }
    }

    #[test]
    fn damage_loses_as_little_as_possible() {
        let records: Vec<[u32; 2]> = (0..20).map(|index| [index * 1000, index * 0x4001]).collect();
        testing::check_damage(&file(HEADER, &records));
    }
}
