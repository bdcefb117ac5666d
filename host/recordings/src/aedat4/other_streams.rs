//! Streams of an AEDAT4 file other than events: frames, IMU samples, triggers.
//!
//! | identifier | root table | elements |
//! |---|---|---|
//! | `FRME` | one frame: times of frame and exposure, format, size, position, pixels | |
//! | `IMUS` | vector of tables: time, temperature, accelerations, angular velocities | samples |
//! | `TRIG` | vector of tables, field 0 = time | triggers |

use std::collections::BTreeMap;
use std::path::Path;
use std::vec::IntoIter;

use super::flatbuffer::{self, Malformed, Table};
use super::header::Stream;
use super::packets::{PacketHead, PacketReader};
use super::{EVENTS, choose_stream, describe, event, events, sensor_size};
use crate::error::{RecordingError, RecordingErrorKind};
use crate::extras::{Frame, InertialSample, Skipped, UnreadFrame, UnreadFrames};
use crate::format::StreamSummary;
use crate::options::RecordingOptions;
use crate::pictures::{TimedImage, highest_bits};

const FRAMES: &str = "FRME";
const INERTIAL: &str = "IMUS";

/// Packets of one stream: the first one of its kind from the camera whose events are read.
struct StreamPackets {
    packets: PacketReader,
    stream: Option<Stream>,
    skipped: Skipped,
}

impl StreamPackets {
    fn open(path: &Path, options: &RecordingOptions, type_identifier: &str) -> Result<Self, RecordingError> {
        let packets = PacketReader::open(path)?;
        let header = packets.header();
        let events = choose_stream(header, options.stream.as_deref(), &mut Vec::new()).ok();
        let camera = events.and_then(|events| events.source.as_ref());
        let is_of_camera = |stream: &&Stream| match (&stream.source, camera) {
            (Some(source), Some(camera)) => source == camera,
            _ => true,
        };
        let mut streams = header.streams.iter().filter(is_of_camera);
        let stream = streams.find(|stream| stream.type_identifier == type_identifier).cloned();
        Ok(Self { packets, stream, skipped: Skipped::new(options.damage) })
    }

    /// Parses the next complete packet; `None` at the end. Damaged packets are skipped if the options request it and
    /// the position of the next packet is known.
    fn next<T>(&mut self, parse: impl Fn(&[u8]) -> Result<T, Malformed>) -> Result<Option<T>, RecordingError> {
        let Some(stream) = &self.stream else { return Ok(None) };
        while let Some(head) = self.packets.next_packet()? {
            if head.stream != stream.id || head.cut_off {
                continue;
            }
            let error = match self.packets.content(&head).map(&parse) {
                Ok(Ok(parsed)) => return Ok(Some(parsed)),
                Ok(Err(Malformed(what))) => self.packets.damaged(&head, what),
                Err(error) => error,
            };
            self.skipped.add(error)?;
        }
        Ok(None)
    }
}

/// Reader of the frames of a camera's first frame stream.
pub struct FrameReader {
    packets: StreamPackets,
    /// Height of the sensor in pixels, if the file or the options contain it.
    rows: Option<u16>,
    unread: UnreadFrames,
}

impl FrameReader {
    /// Opens the file at `path`. A camera without frame stream has no frames.
    ///
    /// # Errors
    /// When the file cannot be read or its header is damaged.
    pub fn open(path: &Path, options: &RecordingOptions) -> Result<Self, RecordingError> {
        let packets = StreamPackets::open(path, options, FRAMES)?;
        let own = packets.stream.as_ref().and_then(|stream| sensor_size(stream).ok().flatten());
        let rows = own.or(options.sensor).map(|sensor| sensor.height);
        Ok(Self { packets, rows, unread: UnreadFrames::default() })
    }

    /// Description of the stream that is read, by [`describe`].
    pub(super) fn stream(&self) -> Option<String> {
        self.packets.stream.as_ref().map(describe)
    }

    /// `true` if [`Self::next_frame`] passed over a frame with an unsupported encoding.
    pub(super) fn has_unread(&self) -> bool {
        !self.unread.is_empty()
    }

    /// Adds to `lost`, once, the numbers of damaged packets and unsupported frames that were passed over.
    pub(super) fn report_skipped(&mut self, lost: &mut Vec<String>) {
        self.packets.skipped.report(lost);
        self.unread.report(lost);
    }

    /// Reads the next frame with a supported encoding; `None` at the end of the file, also if it was cut off.
    ///
    /// # Errors
    /// If the file cannot be read or a packet is damaged. The frames after it can still be read.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, RecordingError> {
        while let Some(frame) = self.next_or_unread()? {
            match frame {
                Ok(frame) => return Ok(Some(frame)),
                Err(unread) => self.unread.add(unread),
            }
        }
        Ok(None)
    }

    /// Reads the next frame, also if its encoding is not supported.
    fn next_or_unread(&mut self) -> Result<Option<Result<Frame, UnreadFrame>>, RecordingError> {
        let read = self.packets.next(|content| flatbuffer::root(content, b"FRME").and_then(|table| frame(&table)))?;
        let from_below = self.packets.stream.as_ref().is_some_and(|stream| stream.rows_from_below);
        Ok(read.map(|frame| frame.map(|frame| if from_below { flipped(frame, self.rows) } else { frame })))
    }
}

/// Flips a frame whose rows count from below. `rows` is the height of the sensor; without it the frame is assumed to
/// begin at the lowest row.
fn flipped(frame: Frame, rows: Option<u16>) -> Frame {
    let (column, row) = frame.position;
    let above = row.saturating_add(frame.size.1);
    let row = rows.unwrap_or(above).saturating_sub(above);
    let length = usize::from(frame.size.0) * frame.channels;
    let pixels = frame.pixels.chunks_exact(length.max(1)).rev().flatten().copied().collect();
    Frame { position: (column, row), pixels, ..frame }
}

/// Reader of the samples of a camera's first inertial stream, packet by packet.
pub struct InertialReader {
    packets: StreamPackets,
    /// The remaining samples of the current packet.
    samples: IntoIter<InertialSample>,
}

impl InertialReader {
    /// Opens the file at `path`. A file without inertial stream has no samples.
    ///
    /// # Errors
    /// When the file cannot be read or its header is damaged.
    pub fn open(path: &Path, options: &RecordingOptions) -> Result<Self, RecordingError> {
        Ok(Self { packets: StreamPackets::open(path, options, INERTIAL)?, samples: Vec::new().into_iter() })
    }

    /// Description of the stream that is read, by [`describe`].
    pub(super) fn stream(&self) -> Option<String> {
        self.packets.stream.as_ref().map(describe)
    }

    /// Adds to `lost`, once, the number of damaged packets that were passed over.
    pub(super) fn report_skipped(&mut self, lost: &mut Vec<String>) {
        self.packets.skipped.report(lost);
    }

    /// Reads the next sample; `None` at the end of the file, also if it was cut off.
    ///
    /// # Errors
    /// If the file cannot be read or a packet is damaged. The samples after it can still be read.
    pub fn next_sample(&mut self) -> Result<Option<InertialSample>, RecordingError> {
        loop {
            if let Some(sample) = self.samples.next() {
                return Ok(Some(sample));
            }
            match self.packets.next(inertial_packet)? {
                Some(samples) => self.samples = samples.into_iter(),
                None => return Ok(None),
            }
        }
    }
}

/// Passes the frames of the file at `path` to `visit`. The inner result is an error if the frames ended early.
pub(super) fn visit_frames(
    path: &Path,
    options: &RecordingOptions,
    visit: &mut dyn FnMut(TimedImage),
) -> Result<Result<(), RecordingError>, RecordingError> {
    let mut reader = FrameReader::open(path, options)?;
    let mut unread = UnreadFrames::default();
    Ok(loop {
        match reader.next_or_unread() {
            Ok(Some(Ok(frame))) => visit(frame.into()),
            Ok(Some(Err(frame))) => {
                visit((&frame).into());
                unread.add(frame);
            }
            Ok(None) => break unread.error(path).map_or(Ok(()), Err),
            Err(error) => break Err(error),
        }
    })
}

/// Storage of a frame's pixels.
struct PixelFormat {
    channels: usize,
    /// Bytes per value: 1 or 2, unsigned.
    bytes: usize,
}

impl PixelFormat {
    /// Decodes OpenCV's type number: bits 0 to 2 are the depth, the bits above are the number of channels minus 1.
    ///
    /// # Errors
    /// OpenCV's name of an unsupported format.
    fn of_type(number: i8) -> Result<Self, String> {
        const DEPTHS: [&str; 8] = ["8U", "8S", "16U", "16S", "32S", "32F", "64F", "16F"];
        let number = usize::from(number.cast_unsigned());
        let (depth, channels) = (DEPTHS.get(number % 8).copied().unwrap_or_default(), number / 8 + 1);
        let bytes = match depth {
            "8U" => 1,
            "16U" => 2,
            _ => 0,
        };
        let is_read = bytes > 0 && channels <= 4;
        if is_read { Ok(Self { channels, bytes }) } else { Err(format!("{depth}C{channels}")) }
    }
}

/// Parses a frame. Fields 3 and 4 are the exposure times; −1 means unknown. dv-processing writes only the duration, as
/// field 11; the frame's time is then the start of the exposure.
fn frame(table: &Table) -> Result<Result<Frame, UnreadFrame>, Malformed> {
    let side = |index| {
        let value = table.i16(index, 0)?;
        u16::try_from(value).map_err(|_| Malformed("a frame has a negative size or position"))
    };
    let (width, height) = (side(6)?, side(7)?);
    let t = table.i64(0, 0)?;
    let PixelFormat { channels, bytes } = match PixelFormat::of_type(table.i8(5, 0)?) {
        Ok(format) => format,
        Err(encoding) => return Ok(Err(UnreadFrame { t, encoding })),
    };
    let samples = table.vector(10)?.elements::<1>()?.as_flattened();
    if samples.len() != usize::from(width) * usize::from(height) * channels * bytes {
        return Err(Malformed("a frame has a number of pixels that does not match its size"));
    }
    let pixels = match bytes {
        1 => samples.to_vec(),
        _ => {
            let samples: Vec<u16> = samples.as_chunks().0.iter().map(|pair| u16::from_le_bytes(*pair)).collect();
            highest_bits(&samples)
        }
    };
    let span = |start, end| -> Result<Option<(i64, i64)>, Malformed> {
        let span = (table.i64(start, -1)?, table.i64(end, -1)?);
        Ok(Some(span).filter(|(start, end)| *start >= 0 && end >= start))
    };
    let duration = table.i64(11, -1)?;
    let of_duration = || Some((t, t.checked_add(duration)?)).filter(|_| duration > 0);
    Ok(Ok(Frame {
        t,
        exposure: span(3, 4)?.or_else(of_duration),
        readout: span(1, 2)?,
        size: (width, height),
        position: (side(8)?, side(9)?),
        channels,
        pixels,
    }))
}

fn inertial_packet(content: &[u8]) -> Result<Vec<InertialSample>, Malformed> {
    let vector = flatbuffer::root(content, b"IMUS")?.vector(0)?.of_tables()?;
    let sample = |index| {
        let table = vector.table(index)?;
        let axes = |first: usize| Ok([table.f32(first, 0.0)?, table.f32(first + 1, 0.0)?, table.f32(first + 2, 0.0)?]);
        Ok(InertialSample {
            t: table.i64(0, 0)?,
            temperature: table.f32(1, 0.0)?,
            acceleration: axes(2)?,
            angular_velocity: axes(5)?,
        })
    };
    (0..vector.length).map(sample).collect()
}

/// Counts the content of the streams in the file at `path`. Packets that are damaged or cut off are counted, but not
/// their elements.
///
/// # Errors
/// When the file cannot be read or its header is damaged.
pub fn summarise(path: &Path) -> Result<Vec<StreamSummary>, RecordingError> {
    let mut packets = PacketReader::open(path)?;
    let streams = packets.header().streams.clone();
    // If two streams have the same number, the first one is used.
    let indices: BTreeMap<i32, usize> =
        streams.iter().enumerate().rev().map(|(index, stream)| (stream.id, index)).collect();
    let mut summaries: Vec<StreamSummary> = streams.iter().map(|stream| StreamSummary::new(describe(stream))).collect();
    loop {
        let head = match packets.next_packet() {
            Ok(Some(head)) => head,
            // The reader of the events reports damage.
            Ok(None) | Err(RecordingError { kind: RecordingErrorKind::Damaged { .. }, .. }) => return Ok(summaries),
            Err(error) => return Err(error),
        };
        let index = indices.get(&head.stream);
        let Some((stream, summary)) = index.and_then(|&index| Some((streams.get(index)?, summaries.get_mut(index)?)))
        else {
            continue;
        };
        summary.packets += 1;
        match elements(&mut packets, &head, stream) {
            Ok(Elements { count, times_us, unread }) => {
                summary.elements += count;
                summary.extend(times_us);
                summary.unread = summary.unread.take().or(unread);
            }
            Err(RecordingError { kind: RecordingErrorKind::Damaged { .. }, .. }) => {}
            Err(error) => return Err(error),
        }
    }
}

/// Content of a packet, as numbers.
#[derive(Debug, Default, PartialEq, Eq)]
struct Elements {
    count: u64,
    /// Times of the first and the last element in µs.
    times_us: Option<(i64, i64)>,
    /// Encoding of the frames, if it is not supported.
    unread: Option<String>,
}

fn elements(packets: &mut PacketReader, head: &PacketHead, stream: &Stream) -> Result<Elements, RecordingError> {
    let content = packets.content(head)?;
    let parsed = match stream.type_identifier.as_str() {
        EVENTS => events(content, head.cut_off).map(|events| {
            let times_us = events.first().zip(events.last()).map(|(first, last)| (event(first).t, event(last).t));
            Elements { count: events.len() as u64, times_us, unread: None }
        }),
        FRAMES => flatbuffer::root(content, b"FRME").and_then(|table| {
            let (t, unread) = (table.i64(0, 0)?, PixelFormat::of_type(table.i8(5, 0)?).err());
            Ok(Elements { count: 1, times_us: Some((t, t)), unread })
        }),
        INERTIAL => tables(content, b"IMUS"),
        "TRIG" => tables(content, b"TRIG"),
        _ => Ok(Elements::default()),
    };
    parsed.map_err(|Malformed(what)| packets.damaged(head, what))
}

fn tables(content: &[u8], identifier: &[u8; 4]) -> Result<Elements, Malformed> {
    let vector = flatbuffer::root(content, identifier)?.vector(0)?.of_tables()?;
    let Some(last) = vector.length.checked_sub(1) else {
        return Ok(Elements::default());
    };
    let time = |index| vector.table(index)?.i64(0, 0);
    Ok(Elements { count: vector.length as u64, times_us: Some((time(0)?, time(last)?)), unread: None })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Builds a FlatBuffer with one table of i64 fields 0 to 4, a format byte, four i16 and a vector of bytes.
    pub fn frame_bytes(format: u8, [width, height, x, y]: [i16; 4], pixels: &[u8]) -> Vec<u8> {
        let mut bytes = 40u32.to_le_bytes().to_vec();
        bytes.extend_from_slice(b"FRME");
        // vtable of 11 fields at 8, 26 bytes long: t, frame start and end (absent), exposure, format...
        for entry in [26u16, 48, 4, 0, 0, 12, 20, 28, 30, 32, 34, 36, 40] {
            bytes.extend_from_slice(&entry.to_le_bytes());
        }
        bytes.resize(40, 0);
        bytes.extend_from_slice(&32i32.to_le_bytes());
        for t in [1000i64, 900, 1100] {
            bytes.extend_from_slice(&t.to_le_bytes());
        }
        bytes.extend_from_slice(&[format, 0]);
        for value in [width, height, x, y] {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        bytes.resize(40 + 40, 0);
        bytes.extend_from_slice(&4u32.to_le_bytes());
        bytes.extend_from_slice(&(pixels.len() as u32).to_le_bytes());
        bytes.extend_from_slice(pixels);
        bytes
    }

    fn parse(bytes: &[u8]) -> Result<Frame, Malformed> {
        parse_any(bytes).map(Result::unwrap)
    }

    fn parse_any(bytes: &[u8]) -> Result<Result<Frame, UnreadFrame>, Malformed> {
        flatbuffer::root(bytes, b"FRME").and_then(|table| frame(&table))
    }

    #[test]
    fn a_frame_is_read() {
        let expected = Frame {
            t: 1000,
            exposure: Some((900, 1100)),
            readout: None,
            size: (3, 2),
            position: (5, 6),
            channels: 1,
            pixels: vec![1, 2, 3, 4, 5, 6],
        };
        assert_eq!(parse(&frame_bytes(0, [3, 2, 5, 6], &[1, 2, 3, 4, 5, 6])).unwrap(), expected);
        assert_eq!(parse(&frame_bytes(16, [1, 1, 0, 0], &[1, 2, 3])).unwrap().channels, 3);
    }

    /// Frames of jAER have 16 bits, of which 10 are used.
    #[test]
    fn frames_of_sixteen_bits_are_read_and_others_are_named() {
        let ten: Vec<u8> = [1000_u16, 500, 4, 0].into_iter().flat_map(u16::to_le_bytes).collect();
        assert_eq!(parse(&frame_bytes(2, [2, 2, 0, 0], &ten)).unwrap().pixels, [250, 125, 1, 0]);
        let coloured: Vec<u8> = [0x0100_u16, 0x0200, 0xff00].into_iter().flat_map(u16::to_le_bytes).collect();
        let frame = parse(&frame_bytes(18, [1, 1, 0, 0], &coloured)).unwrap();
        assert_eq!((frame.channels, frame.pixels), (3, vec![1, 2, 255]));
        for (format, name) in [(1, "8SC1"), (3, "16SC1"), (5, "32FC1"), (21, "32FC3"), (7, "16FC1"), (32, "8UC5")] {
            let unread = parse_any(&frame_bytes(format, [1, 1, 0, 0], &[0; 4])).unwrap().unwrap_err();
            assert_eq!((unread.t, unread.encoding.as_str()), (1000, name));
        }
    }

    #[test]
    fn a_frame_that_contradicts_itself_is_rejected() {
        for (format, size, pixels) in
            [(0, [3, 2, 0, 0], 5), (0, [-3, 2, 0, 0], 6), (2, [3, 2, 0, 0], 6), (16, [3, 2, 0, 0], 6)]
        {
            assert!(parse(&frame_bytes(format, size, &vec![0; pixels])).is_err());
        }
        let bytes = frame_bytes(0, [3, 2, 0, 0], &[0; 6]);
        for length in 0..bytes.len() {
            assert!(parse(&bytes[..length]).is_err());
        }
    }

    /// Otherwise a packet of some kilobytes could give 16 million samples, one for each zero in such a vector.
    #[test]
    fn more_tables_than_a_packet_can_hold_are_rejected() {
        let packet = |identifier: &[u8; 4], count: usize| {
            // The vtable is at 8, the root table at 16, the vector at 24.
            let mut bytes = [&16u32.to_le_bytes()[..], identifier].concat();
            bytes.extend([6u16, 8, 4, 0].into_iter().flat_map(u16::to_le_bytes));
            bytes.extend([8, 4, count as u32].into_iter().flat_map(u32::to_le_bytes));
            bytes.resize(28 + 4 * count, 0);
            bytes
        };
        assert!(inertial_packet(&packet(b"IMUS", 1000)).is_err());
        assert!(tables(&packet(b"IMUS", 1000), b"IMUS").is_err() && tables(&packet(b"TRIG", 1000), b"TRIG").is_err());
        let two = Elements { count: 2, times_us: Some((0, 0)), unread: None };
        assert_eq!(tables(&packet(b"TRIG", 2), b"TRIG"), Ok(two));
    }
}
