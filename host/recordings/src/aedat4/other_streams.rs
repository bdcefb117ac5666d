//! Streams of an AEDAT4 file other than events: frames, IMU samples, triggers.
//!
//! | identifier | root table | elements |
//! |---|---|---|
//! | `FRME` | one frame: times of frame and exposure, format, size, position, pixels | |
//! | `IMUS` | vector of tables: time, temperature, accelerations, angular velocities | samples |
//! | `TRIG` | vector of tables, field 0 = time | triggers |

#[cfg(test)]
pub(super) mod tests;

use std::collections::BTreeMap;
use std::path::Path;
use std::vec::IntoIter;

use super::flatbuffer::{self, Malformed, Table};
use super::header::Stream;
use super::packets::{PacketHead, PacketReader};
use super::{EVENTS, choose_stream, describe, event, events, sensor_size};
use crate::error::{RecordingError, up_to_damage};
use crate::extras::{Extras, Frame, InertialSample, Item, UnreadFrame};
use crate::format::StreamSummary;
use crate::options::{Damage, RecordingOptions};
use crate::pictures::highest_bits;

pub(super) const FRAMES: &str = "FRME";
pub(super) const INERTIAL: &str = "IMUS";

/// The frames or the IMU samples of a file: those of the first stream of this kind from the camera whose events are read.
pub struct StreamItems {
    packets: PacketReader,
    stream: Option<Stream>,
    /// Height of the sensor in pixels, if the file or the options contain it.
    rows: Option<u16>,
    damage: Damage,
    /// The remaining samples of the current packet.
    samples: IntoIter<InertialSample>,
}

impl StreamItems {
    /// Opens the file at `path`. A camera without such a stream has no elements.
    ///
    /// # Errors
    /// When the file cannot be read or its header is damaged.
    pub fn open(path: &Path, options: &RecordingOptions, type_identifier: &str) -> Result<Self, RecordingError> {
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
        let own = stream.as_ref().and_then(|stream| sensor_size(stream).ok().flatten());
        let rows = own.or(options.sensor).map(|sensor| sensor.height);
        Ok(Self { packets, stream, rows, damage: options.damage, samples: Vec::new().into_iter() })
    }

    /// Description of the stream that is read, by [`describe`].
    pub(super) fn name(&self) -> Option<String> {
        self.stream.as_ref().map(describe)
    }

    /// Reads the next element; `None` at the end of the file, also if it was cut off. Damaged packets are skipped if
    /// the options request it and the position of the next packet is known.
    fn read(&mut self) -> Result<Option<Item>, RecordingError> {
        let Some(stream) = &self.stream else { return Ok(None) };
        loop {
            if let Some(sample) = self.samples.next() {
                return Ok(Some(Item::Inertial(sample)));
            }
            let Some(head) = self.packets.next_packet()? else { return Ok(None) };
            if head.stream != stream.id || head.cut_off {
                continue;
            }
            let content = self.packets.content(&head);
            let error = match content.map(|content| packet(content, stream, self.rows)) {
                Ok(Ok(Packet::Picture(item))) => return Ok(Some(item)),
                Ok(Ok(Packet::Samples(samples))) => {
                    self.samples = samples.into_iter();
                    continue;
                }
                Ok(Err(Malformed(what))) => self.packets.damaged(&head, what),
                Err(error) => error,
            };
            return Item::skipped(error, self.damage).map(Some);
        }
    }
}

impl Iterator for StreamItems {
    type Item = Result<Item, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}

/// Opens the frames and IMU samples of the file at `path`. Damage of one stream does not end the other.
pub(super) fn open_extras(path: &Path, options: &RecordingOptions) -> Result<Extras, RecordingError> {
    let mut extras = Extras::default();
    for (what, type_identifier) in [("frames", FRAMES), ("IMU samples", INERTIAL)] {
        let items = StreamItems::open(path, options, type_identifier)?;
        extras.add(what, items.name(), Box::new(items));
    }
    Ok(extras)
}

/// Content of a packet.
enum Packet {
    Picture(Item),
    Samples(Vec<InertialSample>),
}

/// Parses a packet of a stream of frames or samples.
fn packet(content: &[u8], stream: &Stream, rows: Option<u16>) -> Result<Packet, Malformed> {
    if stream.type_identifier == INERTIAL {
        return inertial_packet(content).map(Packet::Samples);
    }
    Ok(Packet::Picture(match frame(&flatbuffer::root(content, b"FRME")?)? {
        Ok(frame) if stream.rows_from_below => Item::Frame(frame.flipped(rows), None),
        Ok(frame) => Item::Frame(frame, None),
        Err(unread) => Item::Unread(unread),
    }))
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
    while let Some(head) = up_to_damage(packets.next_packet())? {
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
            Err(error) if error.is_damage() => {}
            Err(error) => return Err(error),
        }
    }
    Ok(summaries)
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
