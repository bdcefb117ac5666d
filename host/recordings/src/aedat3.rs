//! AEDAT 3.0 and 3.1, the formats of cAER.
//!
//! The file consists of lines that begin with `#` (the first one is `#!AER-DAT3.1`; in 3.1 the last one is
//! `#!END-HEADER`), then packets, little-endian. A packet has a head of i16 kind, i16 source, i32 size of an event, i32
//! offset of its time, i32 overflows of the time, i32 capacity, i32 number of events and i32 number of valid ones; the
//! events follow. Packets of kind 1 contain polarity events: u32 with bit 0 valid, 1 polarity, 2–16 y, 17–31 x; i32
//! time in µs, to which overflows · 2³¹ is added.
//!
//! In 3.1 y counts from above, in 3.0 from below. A file may contain packets of several cameras, called sources.
//! [`extras`] reads frames and IMU samples.

use std::collections::BTreeMap;
use std::path::Path;

use evcal_core::event::{Event, Polarity};

mod extras;
mod packets;

use super::bytes::ByteReader;
use crate::error::{RecordingError, RecordingErrorKind, Usable, up_to_damage};
use crate::format::{FileFormat, Head, OpenResult, StreamSummary, Uses};
use crate::options::RecordingOptions;
use crate::read_report::{ReadReport, Truncation};
use crate::reader::{Decode, Opened, RecordingInformation};
use crate::unsupported_format::UnsupportedFormat;
use packets::{EVENT, Header, MAGIC, POLARITY, PacketHead, header, is_known, next_head, sensor, time};

/// AEDAT 3.0 and 3.1.
pub const FORMAT: FileFormat = FileFormat {
    streams: |path, _| summarise(path),
    frames: Some(extras::items),
    extras: Some(extras::open),
    uses: Uses { stream: true, growth: true, ..Uses::NONE },
    ..FileFormat::of_events("AEDAT 3", |head| head.bytes.starts_with(MAGIC), open)
};

/// Number of bytes of events that are read at a time, because a packet may be as large as its file.
const PART: u64 = 1 << 18;

/// Reader of the packets of one camera. As an iterator, it returns frames and IMU samples.
struct Decoder {
    file: ByteReader,
    header: Header,
    /// Number of the camera that is read.
    source: Option<i16>,
    /// Height of the sensor, if y counts from below.
    from_below: Option<u16>,
    /// Head of the rest of a packet that has been read in part.
    begun: Option<PacketHead>,
    part: Vec<u8>,
    truncated: Option<Truncation>,
}

fn open(path: &Path, options: &RecordingOptions) -> OpenResult {
    let no_end = || RecordingError::damaged(path, 0, "the header has no end", Usable::Before);
    let decoder = start(path, options)?.ok_or_else(no_end)?;
    let header = &decoder.header;
    if header.encoding.as_deref().is_some_and(|encoding| encoding != "RAW") {
        let kind = RecordingErrorKind::Unsupported(UnsupportedFormat::Aedat3Compressed);
        return Err(RecordingError::new(path, kind));
    }
    if header.from_below && decoder.from_below.is_none() {
        return Err(RecordingError::new(path, RecordingErrorKind::ChipUnknown));
    }
    let source = chosen(path, header, options)?;
    let notes = match source {
        Some((number, name)) if header.sources.len() > 1 => {
            vec![format!("the events of {number} {name} are read; the file contains {}", header.list())]
        }
        _ => Vec::new(),
    };
    let (camera_name, began) = (source.map(|(_, name)| name.clone()), header.began.clone());
    let sensor = camera_name.as_deref().and_then(sensor);
    let information = RecordingInformation { format: FORMAT.name, sensor, camera_name, began, notes };
    Ok(Opened::new(information, decoder))
}

/// Opens the file at its first packet; `None` if the header has no end.
fn start(path: &Path, options: &RecordingOptions) -> Result<Option<Decoder>, RecordingError> {
    let mut file = ByteReader::following(path, options.growth.as_ref())?;
    let Some(header) = header(&Head::read(path)?.bytes) else { return Ok(None) };
    file.seek(header.length)?;
    let source = chosen(path, &header, options)?;
    let sensor = options.sensor.or_else(|| sensor(&source?.1)).filter(|_| header.from_below);
    let (source, from_below) = (source.map(|(number, _)| *number), sensor.map(|sensor| sensor.height));
    Ok(Some(Decoder { file, header, source, from_below, begun: None, part: Vec::new(), truncated: None }))
}

/// Returns the requested camera, or the first one.
fn chosen<'a>(
    path: &Path,
    header: &'a Header,
    options: &RecordingOptions,
) -> Result<Option<&'a (i16, String)>, RecordingError> {
    match (header.source(options.stream.as_deref()), &options.stream) {
        (None, Some(wanted)) => {
            let kind = RecordingErrorKind::NoSuchStream { wanted: wanted.clone(), available: header.list() };
            Err(RecordingError::new(path, kind))
        }
        (source, _) => Ok(source),
    }
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let head = match self.begun.take() {
            Some(head) => head,
            None => {
                let head = next_head(&mut self.file, &mut self.truncated)?;
                report.truncated.clone_from(&self.truncated);
                let Some(head) = head else { return Ok(false) };
                if head.kind != POLARITY || !self.header.is_of(self.source, head.source) {
                    self.file.seek(self.file.position() + head.length)?;
                    *report.other_packets.entry(other_name(&self.header, head.kind, head.source)).or_default() += 1;
                    return Ok(head.length == head.wanted);
                }
                head
            }
        };
        self.file.read(&mut self.part, head.length.min(PART))?;
        let events = self.part.as_chunks::<EVENT>().0.iter().filter_map(|&[a, b, c, d, t @ ..]| {
            let data = u32::from_le_bytes([a, b, c, d]);
            let y = (data >> 2) as u16 & 0x7fff;
            let y = self.from_below.map_or(Some(y), |height| height.checked_sub(1)?.checked_sub(y));
            let polarity = if data & 2 == 0 { Polarity::Off } else { Polarity::On };
            let event = Event { t: time(&head, t), x: (data >> 17) as u16, y: y.unwrap_or(u16::MAX), polarity };
            (data & 1 == 1).then_some(event)
        });
        batch.extend(events);
        let rest = head.without(PART);
        self.begun = Some(rest).filter(|rest| rest.length > 0);
        Ok(self.begun.is_some() || head.length == head.wanted)
    }

    fn done(&self) -> Option<f64> {
        Some(self.file.done())
    }
}

/// Name under which packets that are passed over are counted. A damaged file may contain any kind, so all kinds that
/// cAER does not use share one name.
fn other_name(header: &Header, kind: i16, source: i16) -> String {
    let name = header.name_of(kind, source);
    if is_known(kind) { format!("{name} ({kind})") } else { format!("{name} (of unknown kinds)") }
}

/// Counts the content of the packets, by kind and source.
fn summarise(path: &Path) -> Result<Vec<StreamSummary>, RecordingError> {
    let mut file = ByteReader::open(path)?;
    let Some(header) = header(&Head::read(path)?.bytes) else { return Ok(Vec::new()) };
    file.seek(header.length)?;
    let mut kinds: BTreeMap<(Option<i16>, Option<i16>), StreamSummary> = BTreeMap::new();
    while let Some(head) = up_to_damage(next_head(&mut file, &mut None))? {
        let source = Some(head.source).filter(|source| header.sources.len() > 1 && header.names(*source));
        let kind = Some(head.kind).filter(|kind| is_known(*kind));
        let name = || header.name_of(head.kind, head.source);
        let empty = || StreamSummary::new(name());
        let summary = kinds.entry((source, kind)).or_insert_with(empty);
        summary.packets += 1;
        summary.elements += head.count;
        let start = file.position();
        if head.kind == POLARITY
            && let Some(last) = (head.length / EVENT as u64).checked_sub(1)
        {
            let first = file.array::<EVENT>()?;
            file.seek(start + last * EVENT as u64)?;
            let time = |[.., a, b, c, d]: [u8; EVENT]| time(&head, [a, b, c, d]);
            summary.extend(first.map(time).zip(file.array::<EVENT>()?.map(time)));
        }
        file.seek(start + head.length)?;
    }
    Ok(kinds.into_values().collect())
}

#[cfg(test)]
mod tests {
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::testing;

    fn packet(kind: i16, turns: i32, records: &[[u32; 2]]) -> Vec<u8> {
        packet_of(1, kind, turns, records)
    }

    fn packet_of(source: i16, kind: i16, turns: i32, records: &[[u32; 2]]) -> Vec<u8> {
        let count = records.len() as i32;
        let mut bytes = [kind.to_le_bytes(), source.to_le_bytes()].concat();
        [8, 4, turns, count, count, count].iter().for_each(|number: &i32| bytes.extend(number.to_le_bytes()));
        bytes.extend(records.iter().flatten().flat_map(|word| word.to_le_bytes()));
        bytes
    }

    fn record(x: u32, y: u32, on: u32, t: u32) -> [u32; 2] {
        [((x * 32_768 + y) * 2 + on) * 2 + 1, t]
    }

    fn file(version: &str, packets: &[Vec<u8>]) -> Vec<u8> {
        let end = if version == "3.0" { "" } else { "#!END-HEADER\r\n" };
        let lines = format!("#!AER-DAT{version}\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n{end}");
        [lines.into_bytes(), packets.concat()].concat()
    }

    #[test]
    fn packets_are_decoded() {
        let mut invalid = record(1, 1, 1, 4);
        invalid[0] &= !1;
        let packets = [
            packet(1, 0, &[record(3, 4, 1, 7), invalid, record(345, 259, 0, 0x7fff_ffff)]),
            packet(2, 0, &[[1, 2], [3, 4]]),
            packet(1, 1, &[record(5, 6, 1, 1)]),
        ];
        for (version, flip) in [("3.1", 0), ("3.0", 259)] {
            let outcome = testing::read(&file(version, &packets));
            let event = |t, x, y: u16, polarity| Event { t, x, y: y.abs_diff(flip), polarity };
            let expected = [
                event(7, 3, 4, Polarity::On),
                event(0x7fff_ffff, 345, 259, Polarity::Off),
                event(0x8000_0001, 5, 6, Polarity::On),
            ];
            assert_eq!((outcome.events.as_slice(), outcome.error), (expected.as_slice(), None));
            assert_eq!(outcome.information.unwrap().sensor, Some(Sensor::new(346, 260)));
            assert_eq!(outcome.report.other_packets.get("frames (2)"), Some(&1));
        }
    }

    #[test]
    fn one_of_several_cameras_is_read() {
        let lines = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#-Source 7: DAVIS240C\r\n#Source 1: DAVIS346\r\n#Source 2: DVS128\r\n#!END-HEADER\r\n";
        let packets = [
            packet_of(2, 1, 0, &[record(3, 4, 1, 7)]),
            packet_of(1, 1, 0, &[record(300, 4, 1, 8), record(300, 5, 1, 9)]),
            packet_of(2, 2, 0, &[[1, 2]]),
            packet_of(2, 1, 0, &[record(4, 4, 1, 10)]),
        ];
        let content = [&lines[..], &packets.concat()].concat();
        let options =
            |stream: &str| RecordingOptions { stream: Some(stream.to_owned()), ..RecordingOptions::default() };
        for (options, sensor, columns) in [
            (RecordingOptions::default(), Sensor::new(346, 260), vec![300, 300]),
            (options("1"), Sensor::new(346, 260), vec![300, 300]),
            (options("2"), Sensor::new(128, 128), vec![3, 4]),
            (options("DVS128"), Sensor::new(128, 128), vec![3, 4]),
        ] {
            let outcome = testing::read_with(&content, options);
            assert_eq!(
                (outcome.events.iter().map(|event| event.x).collect::<Vec<_>>(), outcome.error),
                (columns, None)
            );
            let information = outcome.information.unwrap();
            assert_eq!(information.sensor, Some(sensor));
            assert!(information.notes[0].contains("1 DAVIS346, 2 DVS128"), "{:?}", information.notes);
            assert_eq!(outcome.report.other_packets.get("frames of 2 DVS128 (2)"), Some(&1));
        }
        let error = testing::read_with(&content, options("3")).error.unwrap();
        assert!(error.contains("1 DAVIS346, 2 DVS128"), "{error}");
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        let streams: Vec<(String, u64)> =
            summarise(&path).unwrap().into_iter().map(|stream| (stream.name, stream.elements)).collect();
        let expected = [("events of 1 DAVIS346", 2), ("events of 2 DVS128", 2), ("frames of 2 DVS128", 1)];
        assert_eq!(streams, expected.map(|(name, count)| (name.to_owned(), count)));
    }

    #[test]
    fn impossible_values_are_rejected_with_their_byte() {
        let good = packet(1, 0, &[record(3, 4, 1, 7)]);
        let mut wide = good.clone();
        wide[4] = 9;
        let mut negative = good.clone();
        negative[23] = 0x80;
        for bad in [wide, negative] {
            let outcome = testing::read(&file("3.1", &[good.clone(), bad]));
            let byte = file("3.1", std::slice::from_ref(&good)).len();
            assert_eq!(outcome.events.len(), 1);
            assert!(outcome.error.unwrap().contains(&format!("byte {byte}")));
        }
        let compressed = b"#!AER-DAT3.1\r\n#Format: PNGFrames\r\n#!END-HEADER\r\n";
        assert!(testing::read(compressed).error.unwrap().contains("compressed"));
        let nameless = b"#!AER-DAT3.0\r\n#Source 1: eDVS\r\n\0";
        assert!(testing::read(nameless).error.unwrap().contains("how many pixels"));
    }

    /// A packet may be as large as its file, so it must not be read at once.
    #[test]
    fn a_large_packet_is_read_in_parts() {
        let count = 3 * PART as u32 / EVENT as u32 - 1;
        let records: Vec<[u32; 2]> = (0..count).map(|index| record(index % 346, index % 260, 1, index)).collect();
        let content = file("3.1", &[packet(1, 0, &records), packet(1, 0, &[record(1, 2, 1, count)])]);
        let outcome = testing::read(&content);
        assert_eq!(outcome.error, None);
        let expected = (0..count).map(|index| (index.into(), (index % 346) as u16)).chain([(i64::from(count), 1)]);
        assert!(outcome.events.iter().map(|event| (event.t, event.x)).eq(expected));
        // Cut within the last event but one.
        let outcome = testing::read(&content[..content.len() - 8 - 28 - 8 - 3]);
        assert_eq!((outcome.events.len(), outcome.error), (count as usize - 2, None));
        assert!(outcome.report.truncated.is_some());

        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        let mut decoder = open(&path, &RecordingOptions::default()).unwrap().decoder;
        let mut batch = Vec::new();
        assert!(decoder.decode(&mut batch, &mut ReadReport::default()).unwrap());
        assert_eq!(batch.len(), PART as usize / EVENT);
        let [summary] = &summarise(&path).unwrap()[..] else { panic!("one stream") };
        assert_eq!((summary.packets, summary.times_us), (2, Some((0, count.into()))));
    }

    /// Damage can make up to 65536 kinds.
    #[test]
    fn unknown_kinds_are_counted_as_one() {
        let packets: Vec<Vec<u8>> = (i16::MIN..=i16::MAX).step_by(7).map(|kind| packet(kind, 0, &[])).collect();
        let known = (i16::MIN..=i16::MAX).step_by(7).filter(|kind| (0..32).contains(kind)).count();
        let content = file("3.1", &[packet(1, 0, &[record(3, 4, 1, 7)]), packets.concat()]);
        let counted = testing::read(&content).report.other_packets;
        assert_eq!(counted.values().sum::<u64>(), packets.len() as u64);
        assert_eq!(counted.len(), known + 1);
        assert_eq!(counted.get("other packets (of unknown kinds)"), Some(&((packets.len() - known) as u64)));
    }

    #[test]
    fn damage_loses_as_little_as_possible() {
        let packets: Vec<Vec<u8>> = (0..4)
            .map(|number| {
                let records = (0..3).map(|index| record(index, number, 1, number * 5000 + index * 1000));
                packet(1, 0, &records.collect::<Vec<_>>())
            })
            .collect();
        testing::check_damage(&file("3.1", &packets));
    }
}
