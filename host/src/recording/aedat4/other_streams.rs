//! What an AEDAT4 file holds beside events: frames, inertial samples, triggers.
//!
//! | identifier | root table | elements |
//! |---|---|---|
//! | `FRME` | one frame: times of frame and exposure, format, size, position, pixels | |
//! | `IMUS` | vector of tables: time, temperature, accelerations, angular velocities | samples |
//! | `TRIG` | vector of tables, field 0 = time | triggers |

use std::path::Path;

use super::flatbuffer::{self, Malformed, Table};
use super::header::Stream;
use super::packets::{PacketHead, PacketReader};
use super::{EVENTS, describe, event, events};
use crate::recording::extras::{Frame, InertialSample};
use crate::recording::pictures::TimedImage;
use crate::recording::{RecordingError, RecordingErrorKind, StreamSummary};

const FRAMES: &str = "FRME";
pub(super) const INERTIAL: &str = "IMUS";

/// Reads the pictures of the first frame stream of a file.
pub struct FrameReader {
    packets: PacketReader,
    stream: Option<i32>,
}

impl FrameReader {
    /// Opens the file at `path`. A file without frame stream has no frames.
    ///
    /// # Errors
    /// When the file cannot be read or its header is damaged.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let packets = PacketReader::open(path)?;
        let mut streams = packets.header().streams.iter();
        let stream = streams.find(|stream| stream.type_identifier == FRAMES).map(|stream| stream.id);
        Ok(Self { packets, stream })
    }

    /// The stream that is read, as [`describe`] names it.
    pub(super) fn stream(&self) -> Option<String> {
        let mut streams = self.packets.header().streams.iter();
        streams.find(|stream| Some(stream.id) == self.stream).map(describe)
    }

    /// The next picture; `None` at the end, also at that of a file that was cut off.
    ///
    /// # Errors
    /// When the file cannot be read or a packet is damaged; the pictures after that one can still be read.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, RecordingError> {
        while let Some(head) = self.packets.next_packet()? {
            if Some(head.stream) == self.stream && !head.cut_off {
                let content = self.packets.content(&head)?;
                let parsed = flatbuffer::root(content, b"FRME").and_then(|table| frame(&table));
                return parsed.map(Some).map_err(|Malformed(what)| self.packets.damaged(&head, what));
            }
        }
        Ok(None)
    }
}

/// Hands the frames of the file at `path` to `visit`. The inner error ended them early.
pub(super) fn visit_frames(
    path: &Path,
    visit: &mut dyn FnMut(TimedImage),
) -> Result<Result<(), RecordingError>, RecordingError> {
    let mut reader = FrameReader::open(path)?;
    Ok(loop {
        match reader.next_frame() {
            Ok(Some(frame)) => visit(frame.into()),
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    })
}

/// The times of exposure are fields 3 and 4; −1 stands for unknown.
fn frame(table: &Table) -> Result<Frame, Malformed> {
    let side = |index| {
        let value = table.i16(index, 0)?;
        u16::try_from(value).map_err(|_| Malformed("a frame has a negative size or position"))
    };
    let (width, height) = (side(6)?, side(7)?);
    // OpenCV's type numbers: 8 bits, channels - 1 in bits 3 and 4.
    let channels = match table.i8(5, 0)? {
        0 => 1,
        8 => 2,
        16 => 3,
        24 => 4,
        _ => return Err(Malformed("a frame has a pixel format that is not 8 bits")),
    };
    let pixels = table.vector(10)?.elements::<1>()?.as_flattened();
    if pixels.len() != usize::from(width) * usize::from(height) * channels {
        return Err(Malformed("a frame does not have as many pixels as its size says"));
    }
    let span = |start, end| -> Result<Option<(i64, i64)>, Malformed> {
        let span = (table.i64(start, -1)?, table.i64(end, -1)?);
        Ok(Some(span).filter(|(start, end)| *start >= 0 && end >= start))
    };
    Ok(Frame {
        t: table.i64(0, 0)?,
        exposure: span(3, 4)?,
        readout: span(1, 2)?,
        size: (width, height),
        position: (side(8)?, side(9)?),
        channels,
        pixels: pixels.to_vec(),
    })
}

/// Reads the first stream of inertial samples of the file at `path`; empty without such a stream. A
/// file that was cut off gives what is whole.
///
/// # Errors
/// When the file cannot be read or a packet is damaged.
pub fn inertial_samples(path: &Path) -> Result<Vec<InertialSample>, RecordingError> {
    let mut packets = PacketReader::open(path)?;
    let mut streams = packets.header().streams.iter();
    let stream = streams.find(|stream| stream.type_identifier == INERTIAL).map(|stream| stream.id);
    let mut samples = Vec::new();
    while let Some(head) = packets.next_packet()? {
        if Some(head.stream) == stream && !head.cut_off {
            let content = packets.content(&head)?;
            let parsed = inertial_packet(content, &mut samples);
            parsed.map_err(|Malformed(what)| packets.damaged(&head, what))?;
        }
    }
    Ok(samples)
}

fn inertial_packet(content: &[u8], samples: &mut Vec<InertialSample>) -> Result<(), Malformed> {
    let vector = flatbuffer::root(content, b"IMUS")?.vector(0)?;
    for index in 0..vector.length {
        let table = vector.table(index)?;
        let axes = |first: usize| Ok([table.f32(first, 0.0)?, table.f32(first + 1, 0.0)?, table.f32(first + 2, 0.0)?]);
        samples.push(InertialSample {
            t: table.i64(0, 0)?,
            temperature: table.f32(1, 0.0)?,
            acceleration: axes(2)?,
            angular_velocity: axes(5)?,
        });
    }
    Ok(())
}

/// Counts what the streams of the file at `path` hold. Packets that are damaged or cut off count as
/// packets only.
///
/// # Errors
/// When the file cannot be read or its header is damaged.
pub fn summarise(path: &Path) -> Result<Vec<StreamSummary>, RecordingError> {
    let mut packets = PacketReader::open(path)?;
    let streams = packets.header().streams.clone();
    let mut summaries: Vec<StreamSummary> = streams
        .iter()
        .map(|stream| StreamSummary { name: describe(stream), packets: 0, elements: 0, times_us: None })
        .collect();
    loop {
        let head = match packets.next_packet() {
            Ok(Some(head)) => head,
            // Damage is for the reader of events to report.
            Ok(None) | Err(RecordingError { kind: RecordingErrorKind::Damaged { .. }, .. }) => return Ok(summaries),
            Err(error) => return Err(error),
        };
        let number = streams.iter().position(|stream| stream.id == head.stream);
        let Some((stream, summary)) = number.and_then(|index| Some((streams.get(index)?, summaries.get_mut(index)?)))
        else {
            continue;
        };
        summary.packets += 1;
        match elements(&mut packets, &head, stream) {
            Ok((count, times)) => {
                summary.elements += count;
                summary.times_us = match (summary.times_us, times) {
                    (Some((first, _)), Some((_, last))) => Some((first, last)),
                    (earlier, later) => earlier.or(later),
                };
            }
            Err(RecordingError { kind: RecordingErrorKind::Damaged { .. }, .. }) => {}
            Err(error) => return Err(error),
        }
    }
}

/// Number of elements of a packet, and the times of its first and last one.
fn elements(
    packets: &mut PacketReader,
    head: &PacketHead,
    stream: &Stream,
) -> Result<(u64, Option<(i64, i64)>), RecordingError> {
    let content = packets.content(head)?;
    let parsed = match stream.type_identifier.as_str() {
        EVENTS => events(content, head.cut_off).map(|events| {
            let times = events.first().zip(events.last()).map(|(first, last)| (event(first).t, event(last).t));
            (events.len() as u64, times)
        }),
        FRAMES => flatbuffer::root(content, b"FRME").and_then(|table| table.i64(0, 0)).map(|t| (1, Some((t, t)))),
        INERTIAL => tables(content, b"IMUS"),
        "TRIG" => tables(content, b"TRIG"),
        _ => Ok((0, None)),
    };
    parsed.map_err(|Malformed(what)| packets.damaged(head, what))
}

fn tables(content: &[u8], identifier: &[u8; 4]) -> Result<(u64, Option<(i64, i64)>), Malformed> {
    let vector = flatbuffer::root(content, identifier)?.vector(0)?;
    let Some(last) = vector.length.checked_sub(1) else {
        return Ok((0, None));
    };
    let time = |index| vector.table(index)?.i64(0, 0);
    Ok((vector.length as u64, Some((time(0)?, time(last)?))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A FlatBuffer with one table of i64 fields 0 to 4, a format byte, four i16 and a vector of bytes.
    fn frame_bytes(format: u8, [width, height, x, y]: [i16; 4], pixels: &[u8]) -> Vec<u8> {
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

    #[test]
    fn a_frame_that_contradicts_itself_is_refused() {
        for (format, size, pixels) in
            [(0, [3, 2, 0, 0], 5), (0, [-3, 2, 0, 0], 6), (5, [3, 2, 0, 0], 6), (16, [3, 2, 0, 0], 6)]
        {
            assert!(parse(&frame_bytes(format, size, &vec![0; pixels])).is_err());
        }
        let bytes = frame_bytes(0, [3, 2, 0, 0], &[0; 6]);
        for length in 0..bytes.len() {
            assert!(parse(&bytes[..length]).is_err());
        }
    }
}
