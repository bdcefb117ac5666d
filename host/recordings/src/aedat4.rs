//! AEDAT4, the format of DV and dv-processing.
//!
//! The file consists of a header ([`header`]) and packets of several streams ([`packets`]). A packet of an event stream
//! is the FlatBuffer `EVTS { elements: [Event] }`; an event has 16 bytes: i64 time in µs since 1970, i16 x, i16 y, u8
//! ON, 3 unused bytes, all little-endian.

pub mod header;
mod other_streams;
pub mod packets;
pub mod write;

mod flatbuffer;

use evcal_core::sensor::Sensor;
use std::collections::BTreeMap;
use std::path::Path;

use evcal_core::event::{Event, Polarity};
use flatbuffer::Malformed;
use header::{Header, MAGIC, Stream};
use packets::{PacketHead, PacketReader};
pub use write::{OUTPUT, OUTPUT_UNCOMPRESSED, OUTPUT_ZSTANDARD};

use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, OpenResult, Uses};
use crate::options::{Damage, RecordingOptions};
use crate::read_report::ReadReport;
use crate::reader::{Decode, MAX_SENSOR_SIZE, Opened, RecordingInformation};
use other_streams::{FRAMES, StreamItems};

/// AEDAT4.
pub const FORMAT: FileFormat = FileFormat {
    name: "AEDAT4",
    recognise: |head| head.bytes.starts_with(MAGIC),
    events: EventDecoder::open,
    files: |path| vec![path.to_owned()],
    streams: |path, _| other_streams::summarise(path),
    frames: Some(|path, options| Ok(Box::new(StreamItems::open(path, options, FRAMES)?))),
    extras: Some(other_streams::open_extras),
    transfers: None,
    output: Some(&OUTPUT),
    uses: Uses { stream: true, growth: true, ..Uses::NONE },
};

/// Type identifier of a stream of events.
const EVENTS: &str = "EVTS";

/// Number of events from which a batch is returned.
const BATCH: usize = 16_384;

struct EventDecoder {
    packets: PacketReader,
    stream: i32,
    /// Descriptions of the streams, by number.
    names: BTreeMap<i32, String>,
    /// Height of the sensor in pixels, if rows count from below.
    from_below: Option<u16>,
    damage: Damage,
}

impl EventDecoder {
    fn open(path: &Path, options: &RecordingOptions) -> OpenResult {
        let packets = PacketReader::following(path, options.growth.clone())?;
        let header = packets.header();
        let mut notes = Vec::new();
        let error = |kind| RecordingError::new(path, kind);
        let stream = choose_stream(header, options.stream.as_deref(), &mut notes).map_err(error)?;
        if header.table_position.is_none() && options.growth.is_none() {
            notes.push("the recording was not closed (it has no table of packets); it is read packet by packet".into());
        }
        let sensor = match (sensor_size(stream), options.sensor) {
            (Err(_), Some(_)) => None,
            (own, _) => own.map_err(error)?,
        };
        let from_below = match stream.rows_from_below {
            true => {
                notes.push("jAER recorded this file and counts rows from below: y is flipped".into());
                Some(sensor.or(options.sensor).ok_or_else(|| error(RecordingErrorKind::ChipUnknown))?.height)
            }
            false => None,
        };
        // If two streams have the same number, the first one is used.
        let names = header.streams.iter().rev().map(|stream| (stream.id, describe(stream))).collect();
        let camera_name = stream.source.clone();
        let information = RecordingInformation { format: FORMAT.name, sensor, camera_name, began: None, notes };
        let decoder = Self { stream: stream.id, names, from_below, damage: options.damage, packets };
        Ok(Opened::new(information, decoder))
    }

    /// Decodes the packet `head` and appends its events.
    fn decode_packet(&mut self, head: &PacketHead, batch: &mut Vec<Event>) -> Result<(), RecordingError> {
        let from_below = self.from_below;
        let content = self.packets.content(head)?;
        match events(content, head.cut_off) {
            Ok(events) => {
                batch.extend(events.iter().map(|bytes| flipped(event(bytes), from_below)));
                Ok(())
            }
            // Even the beginning of the packet is missing, which the packet reader has recorded.
            Err(_) if head.cut_off => Ok(()),
            Err(Malformed(what)) => Err(self.packets.damaged(head, what)),
        }
    }
}

impl Decode for EventDecoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        while batch.len() < BATCH {
            // Events of a file that is still being written are returned packet by packet.
            if self.packets.is_growing() && !batch.is_empty() {
                break;
            }
            let Some(head) = self.packets.next_packet()? else {
                report.truncated = self.packets.truncated().cloned();
                return Ok(false);
            };
            if head.stream != self.stream {
                let known = self.names.get(&head.stream);
                let name = known.map_or("streams that the header does not name", String::as_str);
                *report.other_packets.entry(name.to_owned()).or_default() += 1;
                continue;
            }
            match self.decode_packet(&head, batch) {
                Ok(()) => {}
                Err(error) if error.is_skipped(self.damage) => report.damaged_packets += 1,
                Err(error) => return Err(error),
            }
        }
        Ok(true)
    }

    fn done(&self) -> Option<f64> {
        Some(self.packets.done())
    }
}

/// Returns the events in the content of a packet, undecoded.
fn events(content: &[u8], cut_off: bool) -> Result<&[[u8; 16]], Malformed> {
    let vector = flatbuffer::root(content, b"EVTS")?.vector(0)?;
    if cut_off { Ok(vector.first_elements()) } else { vector.elements() }
}

fn event(bytes: &[u8; 16]) -> Event {
    let &[t0, t1, t2, t3, t4, t5, t6, t7, x0, x1, y0, y1, on, ..] = bytes;
    Event {
        t: i64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
        // Negative coordinates become large ones, which the reader drops as out of range.
        x: u16::from_le_bytes([x0, x1]),
        y: u16::from_le_bytes([y0, y1]),
        polarity: if on == 0 { Polarity::Off } else { Polarity::On },
    }
}

/// Flips the row of an event inside the sensor if rows count from below; `from_below` is then the height of the sensor.
fn flipped(event: Event, from_below: Option<u16>) -> Event {
    match from_below {
        // An event outside the sensor stays outside.
        Some(rows) if event.y < rows => Event { y: rows - 1 - event.y, ..event },
        _ => event,
    }
}

fn describe(stream: &Stream) -> String {
    format!("{} {} ({})", stream.id, stream.name, stream.type_identifier)
}

/// Describes the streams, with the names of their cameras if known.
fn describe_all<'a>(streams: impl Iterator<Item = &'a Stream>) -> String {
    let one = |stream: &Stream| match &stream.source {
        Some(camera) => format!("{} of {camera}", describe(stream)),
        None => describe(stream),
    };
    streams.map(one).collect::<Vec<_>>().join(", ")
}

/// Returns the event stream `wanted`, selected by its name, its number or the name of its camera; the first one if
/// `wanted` is `None`.
fn choose_stream<'a>(
    header: &'a Header,
    wanted: Option<&str>,
    notes: &mut Vec<String>,
) -> Result<&'a Stream, RecordingErrorKind> {
    let of_events = || header.streams.iter().filter(|stream| stream.type_identifier == EVENTS);
    let Some(first) = of_events().next() else {
        return Err(RecordingErrorKind::NoEventStream(describe_all(header.streams.iter())));
    };
    match wanted {
        Some(wanted) => {
            let is_wanted = |stream: &&Stream| {
                stream.name == wanted || stream.id.to_string() == wanted || stream.source.as_deref() == Some(wanted)
            };
            of_events().find(is_wanted).ok_or_else(|| RecordingErrorKind::NoSuchStream {
                wanted: wanted.to_owned(),
                available: describe_all(of_events()),
            })
        }
        None => {
            if of_events().count() > 1 {
                let all = describe_all(of_events());
                notes.push(format!("the first event stream is read; the file contains {all}"));
            }
            Ok(first)
        }
    }
}

fn sensor_size(stream: &Stream) -> Result<Option<Sensor>, RecordingErrorKind> {
    let Some((width, height)) = stream.size else {
        return Ok(None);
    };
    let side = |size: i64| u16::try_from(size).ok().filter(|side| (1..=MAX_SENSOR_SIZE).contains(side));
    match side(width).zip(side(height)) {
        Some(sensor) => Ok(Some(sensor.into())),
        None => Err(RecordingErrorKind::Sensor { width, height }),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::path::PathBuf;

    use tempfile::TempDir;

    use super::header::Compression;
    use super::write::{event_packet, header, pack};
    use super::*;
    use crate::Recording;
    use crate::extras::Item;

    /// Writes a file with the streams 0 "events", 1 "frames" and 2 "more" (events of another camera) and these packets,
    /// without a closing table.
    fn file(compression: Compression, size: i64, packets: &[(i32, Vec<u8>)]) -> (TempDir, PathBuf) {
        let stream = |id, name, kind| {
            let camera = if id == 2 { "right" } else { "left" };
            format!(
                r#"<node name="{id}"><attr key="originalOutputName">{name}</attr><attr key="typeIdentifier">{kind}</attr>
                <node name="info"><attr key="sizeX">{size}</attr><attr key="sizeY">260</attr>
                <attr key="source">{camera}</attr></node></node>"#
            )
        };
        let streams = stream(2, "more", "EVTS") + &stream(0, "events", "EVTS") + &stream(1, "frames", "FRME");
        let description = format!(r#"<dv version="2.0"><node name="outInfo">{streams}</node></dv>"#);
        let mut bytes = [MAGIC.as_slice(), &header(compression, &description).unwrap()].concat();
        for (stream, packet) in packets {
            bytes.extend_from_slice(&stream.to_le_bytes());
            bytes.extend_from_slice(&(packet.len() as i32).to_le_bytes());
            bytes.extend_from_slice(packet);
        }
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.aedat4");
        std::fs::write(&path, bytes).unwrap();
        (directory, path)
    }

    fn events(first: i64) -> Vec<Event> {
        (first..first + 20).map(|t| Event { t, x: 3, y: 4, polarity: Polarity::On }).collect()
    }

    fn packet(compression: Compression, first: i64) -> Vec<u8> {
        pack(compression, &event_packet(&events(first)).unwrap()).unwrap()
    }

    struct Outcome {
        events: Vec<Event>,
        notes: Vec<String>,
        report: ReadReport,
        error: Option<String>,
    }

    fn read(path: &Path, options: RecordingOptions) -> Outcome {
        let opened = Recording::new(path, options).and_then(|recording| recording.open());
        let mut reader = match opened {
            Ok(reader) => reader,
            Err(error) => {
                let (notes, report) = (Vec::new(), ReadReport::default());
                return Outcome { events: Vec::new(), notes, report, error: Some(error.to_string()) };
            }
        };
        let (mut events, mut batch) = (Vec::new(), Vec::new());
        let error = loop {
            match reader.next_batch(&mut batch) {
                Ok(true) => events.extend_from_slice(&batch),
                Ok(false) => break None,
                Err(error) => break Some(error.to_string()),
            }
        };
        Outcome { events, notes: reader.information().notes.clone(), report: reader.report().clone(), error }
    }

    #[test]
    fn a_recording_that_was_not_closed_is_read_packet_by_packet() {
        for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
            let packets = [(0, packet(compression, 0)), (1, vec![1, 2, 3]), (9, vec![]), (0, packet(compression, 50))];
            let (_directory, path) = file(compression, 346, &packets);
            let outcome = read(&path, RecordingOptions::default());
            assert_eq!(outcome.error, None);
            assert_eq!(outcome.events, [events(0), events(50)].concat());
            assert!(outcome.notes.iter().any(|note| note.contains("not closed")));
            assert_eq!(outcome.report.other_packets.values().sum::<u64>(), 2);
            assert_eq!(outcome.report.other_packets.get("1 frames (FRME)"), Some(&1));
        }
    }

    #[test]
    fn a_damaged_packet_is_named_or_skipped() {
        for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
            let mut bad = packet(compression, 50);
            bad[..8].fill(0x5a);
            let start = packet(compression, 0);
            let packets = [(0, start.clone()), (0, bad), (0, packet(compression, 90))];
            let (_directory, path) = file(compression, 346, &packets);
            let byte = std::fs::read(&path).unwrap().windows(8).position(|bytes| bytes == [0x5a; 8]).unwrap();

            let outcome = read(&path, RecordingOptions::default());
            assert_eq!(outcome.events, events(0));
            let error = outcome.error.unwrap();
            assert!(error.contains(&format!("byte {byte}")) && error.contains("recording.aedat4"), "{error}");

            let outcome = read(&path, RecordingOptions { damage: Damage::Skip, ..RecordingOptions::default() });
            assert_eq!((outcome.error, outcome.report.damaged_packets), (None, 1));
            assert_eq!(outcome.events, [events(0), events(90)].concat());
        }
    }

    #[test]
    fn a_packet_of_impossible_size_ends_the_recording_with_its_byte() {
        let compression = Compression::Zstd;
        let (_directory, path) = file(compression, 346, &[(0, packet(compression, 0))]);
        let mut bytes = std::fs::read(&path).unwrap();
        let byte = bytes.len();
        bytes.extend_from_slice(&[0, 0, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 2, 3]);
        std::fs::write(&path, bytes).unwrap();
        let outcome = read(&path, RecordingOptions::default());
        assert_eq!(outcome.events, events(0));
        assert!(outcome.error.unwrap().contains(&format!("byte {byte}")));
    }

    #[test]
    fn one_of_several_event_streams_can_be_chosen() {
        let compression = Compression::Lz4;
        let (_directory, path) = file(compression, 346, &[(0, packet(compression, 0)), (2, packet(compression, 50))]);
        let outcome = read(&path, RecordingOptions::default());
        assert_eq!(outcome.events, events(0));
        assert!(outcome.notes.iter().any(|note| note.contains("2 more (EVTS) of right")), "{:?}", outcome.notes);
        for wanted in ["2", "more", "right"] {
            let outcome = read(&path, RecordingOptions { stream: Some(wanted.into()), ..RecordingOptions::default() });
            assert_eq!(outcome.events, events(50));
        }
        let outcome = read(&path, RecordingOptions { stream: Some("frames".into()), ..RecordingOptions::default() });
        assert!(outcome.error.unwrap().contains("0 events (EVTS) of left, 2 more (EVTS) of right"));
    }

    /// jAER 3 writes its own coordinates, in which rows of events and frames count from below, and frames of 16 bits.
    /// Without flipping, the camera would have its principal point at the mirrored row.
    #[test]
    fn rows_counted_from_below_are_flipped() {
        let stream = |id, kind, size: &str| {
            format!(
                r#"<node name="{id}"><attr key="originalModuleName">jAER</attr><attr key="typeIdentifier">{kind}</attr>
                <node name="info">{size}<attr key="source">Davis346blue</attr></node></node>"#
            )
        };
        let size = r#"<attr key="sizeX">346</attr><attr key="sizeY">260</attr>"#;
        let file = |size: &str| {
            let streams = stream(0, "EVTS", size) + &stream(1, "FRME", size);
            let description = format!(r#"<dv version="2.0"><node name="outInfo">{streams}</node></dv>"#);
            let event = |y| Event { t: 5, x: 3, y, polarity: Polarity::On };
            let events = event_packet(&[event(0), event(259), event(260)]).unwrap();
            // 16 bits, 2 x 3 pixels at column 4, row 7 from below.
            let frame = other_streams::tests::frame_bytes(2, [2, 3, 4, 7], &[1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0]);
            let frame = [&(frame.len() as u32).to_le_bytes()[..], &frame].concat();
            let mut bytes = [MAGIC.as_slice(), &header(Compression::None, &description).unwrap()].concat();
            for (stream, packet) in [(0_i32, events), (1, frame)] {
                bytes.extend(stream.to_le_bytes());
                bytes.extend((packet.len() as i32).to_le_bytes());
                bytes.extend(packet);
            }
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording.aedat4");
            std::fs::write(&path, bytes).unwrap();
            (directory, path)
        };
        let of_346_x_260 = RecordingOptions { sensor: Some(Sensor::new(346, 260)), ..RecordingOptions::default() };
        for (size, options) in [(size, RecordingOptions::default()), ("", of_346_x_260)] {
            let (_directory, path) = file(size);
            let outcome = read(&path, options.clone());
            assert_eq!(outcome.error, None);
            assert_eq!(outcome.events.iter().map(|event| event.y).collect::<Vec<_>>(), [259, 0]);
            assert_eq!(outcome.report.out_of_range, 1);
            assert!(outcome.notes.iter().any(|note| note.contains("jAER")), "{:?}", outcome.notes);
            let first = StreamItems::open(&path, &options, FRAMES).unwrap().next().unwrap().unwrap();
            let Item::Frame(frame, None) = first else { panic!("a frame that can be used") };
            assert_eq!((frame.position, frame.pixels), ((4, 250), vec![5, 6, 3, 4, 1, 2]));
        }
        let (_directory, path) = file("");
        let error = read(&path, RecordingOptions::default()).error.unwrap();
        assert!(error.contains("does not say how many pixels"), "{error}");
    }

    #[test]
    fn frames_are_from_the_camera_whose_events_are_read() {
        let (_directory, path) = file(Compression::None, 346, &[]);
        let of = |stream: &str| {
            let options = RecordingOptions { stream: Some(stream.to_owned()), ..RecordingOptions::default() };
            StreamItems::open(&path, &options, FRAMES).unwrap().name()
        };
        assert_eq!((of("left").as_deref(), of("right")), (Some("1 frames (FRME)"), None));
    }

    #[test]
    fn a_sensor_that_is_too_large_is_rejected() {
        for size in [32_768, 0, -5, 70_000] {
            let (_directory, path) = file(Compression::None, size, &[]);
            let error = read(&path, RecordingOptions::default()).error.unwrap();
            assert!(error.contains(&size.to_string()) && error.contains("which is not possible"), "{error}");
            let options = RecordingOptions { sensor: Some(Sensor::new(346, 260)), ..RecordingOptions::default() };
            assert_eq!(read(&path, options).error, None);
        }
        let (_directory, path) = file(Compression::None, 32_767, &[]);
        assert_eq!(read(&path, RecordingOptions::default()).error, None);
    }

    #[test]
    fn packets_that_decompress_to_too_much_are_damage() {
        let bomb = zstd::bulk::compress(&vec![0; packets::MAX_UNPACKED + 1], 1).unwrap();
        let (_directory, path) = file(Compression::Zstd, 346, &[(0, bomb)]);
        assert!(read(&path, RecordingOptions::default()).error.unwrap().contains("more than 64 MiB"));
    }

    /// The length is checked before any bytes are read.
    #[test]
    fn a_packet_that_is_too_long_is_not_read() {
        let length = packets::MAX_UNPACKED as i32 * 2;
        for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
            let (_directory, path) = file(compression, 346, &[(0, packet(compression, 0))]);
            let byte = std::fs::metadata(&path).unwrap().len();
            let mut file = std::fs::OpenOptions::new().append(true).open(&path).unwrap();
            file.write_all(&[0_i32.to_le_bytes(), length.to_le_bytes()].concat()).unwrap();
            file.set_len(byte + 8 + length as u64).unwrap();
            let outcome = read(&path, RecordingOptions::default());
            assert_eq!(outcome.events, events(0));
            let error = outcome.error.unwrap();
            assert!(error.contains("more than 64 MiB") && error.contains(&format!("byte {}", byte + 8)), "{error}");
            let outcome = read(&path, RecordingOptions { damage: Damage::Skip, ..RecordingOptions::default() });
            assert_eq!((outcome.error, outcome.report.damaged_packets), (None, 1));
            let mut packets = PacketReader::open(&path).unwrap();
            packets.next_packet().unwrap();
            let head = packets.next_packet().unwrap().unwrap();
            assert!(packets.content(&head).is_err() && packets.memory() < 1 << 20, "{}", packets.memory());
        }
    }
}
