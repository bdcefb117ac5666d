//! Writer of AEDAT4: a stream of events, optionally one of frames and one of IMU samples, and the closing table of
//! packets that dv-processing expects.

mod packet;

use evcal_core::sensor::Sensor;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};

use evcal_core::event::Event;
pub(super) use packet::{event_packet, header};
use packet::{frame_packet, imu_packet, packet_table};

use super::header::{Compression, MAGIC, UNKNOWN_CAMERA};
use crate::encode::{CreateFile, Description, Encode, OutputFormat, WriteError};
use crate::extras::{Extra, Frame, InertialSample, OtherStreams};

/// AEDAT4 with LZ4, the default of dv-processing. Some readers support no other compression.
pub const OUTPUT: OutputFormat = output("aedat4", |file, description| create(file, description, Compression::Lz4));
/// AEDAT4 with Zstandard.
pub const OUTPUT_ZSTANDARD: OutputFormat =
    output("aedat4-zstandard", |file, description| create(file, description, Compression::Zstd));
/// AEDAT4 without compression.
pub const OUTPUT_UNCOMPRESSED: OutputFormat =
    output("aedat4-uncompressed", |file, description| create(file, description, Compression::None));

const fn output(name: &'static str, create: CreateFile) -> OutputFormat {
    OutputFormat { contains_extras: true, ..OutputFormat::of_events(name, &["aedat4"], create) }
}

fn create(
    file: &mut dyn FnMut() -> io::Result<File>,
    description: &Description,
    compression: Compression,
) -> Result<Box<dyn Encode>, WriteError> {
    let &Description { sensor, camera_name, others, .. } = description;
    let file = BufWriter::with_capacity(1 << 18, file()?);
    Ok(Box::new(Encoder::with_streams(file, compression, sensor, camera_name, others)?))
}

/// Longest time span of a packet in microseconds, as in dv-processing.
const PACKET_DURATION: i64 = 10_000;
/// Largest number of events per packet.
const PACKET_EVENTS: usize = 32_768;
/// Zstandard's default level.
const ZSTD_LEVEL: i32 = 3;
/// Offset in the file of the field with the position of the closing table.
const TABLE_POSITION_FIELD: u64 = MAGIC.len() as u64 + 32;

/// One row of the closing table.
struct TableRow {
    stream: i32,
    /// Offset of the packet's content, after its head.
    byte: u64,
    size: i32,
    elements: i64,
    first: i64,
    last: i64,
}

/// Numbers of the streams.
const EVENTS: i32 = 0;
const FRAMES: i32 = 1;
const IMU: i32 = 2;

/// Encoder of AEDAT4.
pub struct Encoder<W> {
    output: W,
    compression: Compression,
    position: u64,
    packet: Vec<Event>,
    /// IMU samples that have not been written yet.
    samples: Vec<InertialSample>,
    table: Vec<TableRow>,
}

impl<W: Write + Seek> Encoder<W> {
    /// Writes the header of a file with events only.
    pub fn new(output: W, compression: Compression, sensor: Sensor, camera_name: &str) -> Result<Self, WriteError> {
        Self::with_streams(output, compression, sensor, camera_name, OtherStreams::default())
    }

    /// Writes the header of a file with events and the streams in `others`.
    pub fn with_streams(
        mut output: W,
        compression: Compression,
        sensor: Sensor,
        camera_name: &str,
        others: OtherStreams,
    ) -> Result<Self, WriteError> {
        let header = header(compression, &description(compression, sensor, camera_name, others))?;
        output.write_all(MAGIC)?;
        output.write_all(&header)?;
        let position = (MAGIC.len() + header.len()) as u64;
        Ok(Self { output, compression, position, packet: Vec::new(), samples: Vec::new(), table: Vec::new() })
    }

    /// Writes a frame as a packet.
    pub fn frame(&mut self, frame: &Frame) -> Result<(), WriteError> {
        self.write_packet(FRAMES, &frame_packet(frame)?, 1, frame.t, frame.t)
    }

    /// Writes IMU samples, which must follow those written before.
    pub fn imu(&mut self, samples: &[InertialSample]) -> Result<(), WriteError> {
        let packet = |sample: &InertialSample| sample.t.div_euclid(PACKET_DURATION);
        for samples in samples.chunk_by(|a, b| packet(a) == packet(b)) {
            if let (Some(first), Some(last)) = (samples.first(), samples.last()) {
                self.write_packet(IMU, &imu_packet(samples)?, samples.len(), first.t, last.t)?;
            }
        }
        Ok(())
    }

    fn write_events(&mut self) -> Result<(), WriteError> {
        let (Some(first), Some(last)) = (self.packet.first(), self.packet.last()) else {
            return Ok(());
        };
        let (first, last) = (first.t, last.t);
        let packet = event_packet(&self.packet)?;
        self.write_packet(EVENTS, &packet, self.packet.len(), first, last)?;
        self.packet.clear();
        Ok(())
    }

    fn write_packet(
        &mut self,
        stream: i32,
        content: &[u8],
        elements: usize,
        first: i64,
        last: i64,
    ) -> Result<(), WriteError> {
        let packed = pack(self.compression, content)?;
        let size = i32::try_from(packed.len()).map_err(|_| WriteError::TooLarge)?;
        self.output.write_all(&stream.to_le_bytes())?;
        self.output.write_all(&size.to_le_bytes())?;
        self.output.write_all(&packed)?;
        self.table.push(TableRow { stream, byte: self.position + 8, size, elements: elements as i64, first, last });
        self.position += 8 + packed.len() as u64;
        Ok(())
    }
}

impl<W: Write + Seek> Encode for Encoder<W> {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        for &event in events {
            let full = self.packet.len() >= PACKET_EVENTS
                || self.packet.first().is_some_and(|first| event.t.saturating_sub(first.t) >= PACKET_DURATION);
            if full {
                self.write_events()?;
            }
            self.packet.push(event);
        }
        Ok(())
    }

    fn extra(&mut self, extra: Extra) -> Result<bool, WriteError> {
        match extra {
            Extra::Frame(frame) => self.frame(&frame)?,
            Extra::Inertial(sample) => self.samples.push(sample),
        }
        Ok(true)
    }

    fn advance(&mut self, _: i64) -> Result<(), WriteError> {
        let samples = std::mem::take(&mut self.samples);
        self.imu(&samples)
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        let samples = std::mem::take(&mut self.samples);
        self.imu(&samples)?;
        self.write_events()?;
        let table = pack(self.compression, &packet_table(&self.table)?)?;
        self.output.write_all(&table)?;
        self.output.seek(SeekFrom::Start(TABLE_POSITION_FIELD))?;
        self.output.write_all(&self.position.to_le_bytes())?;
        Ok(self.output.flush()?)
    }
}

pub(super) fn pack(compression: Compression, bytes: &[u8]) -> Result<Vec<u8>, WriteError> {
    Ok(match compression {
        Compression::None => bytes.to_vec(),
        Compression::Lz4 => {
            let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
            encoder.write_all(bytes)?;
            encoder.finish().map_err(std::io::Error::from)?
        }
        Compression::Zstd => zstd::bulk::compress(bytes, ZSTD_LEVEL)?,
    })
}

/// Returns the XML that describes the streams.
fn description(
    compression: Compression,
    Sensor { width, height }: Sensor,
    camera_name: &str,
    others: OtherStreams,
) -> String {
    let compression = match compression {
        Compression::None => "NONE",
        Compression::Lz4 => "LZ4",
        Compression::Zstd => "ZSTD",
    };
    // faery refuses files without the name of a camera.
    let camera_name = if camera_name.is_empty() { UNKNOWN_CAMERA } else { camera_name };
    let camera_name: String = camera_name
        .chars()
        .map(|character| match character {
            '<' => "&lt;".to_owned(),
            '>' => "&gt;".to_owned(),
            '&' => "&amp;".to_owned(),
            other if other.is_control() => " ".to_owned(),
            other => other.to_string(),
        })
        .collect();
    let stream = |number: i32, name: &str, kind: &str, content: &str, size: &str| {
        format!(
            r#"        <node name="{number}" path="/outInfo/{number}/">
            <attr key="compression" type="string">{compression}</attr>
            <attr key="originalModuleName" type="string">evcal</attr>
            <attr key="originalOutputName" type="string">{name}</attr>
            <attr key="typeDescription" type="string">{content}</attr>
            <attr key="typeIdentifier" type="string">{kind}</attr>
            <node name="info" path="/outInfo/{number}/info/">
{size}                <attr key="source" type="string">{camera_name}</attr>
            </node>
        </node>
"#
        )
    };
    let size = format!(
        r#"                <attr key="sizeX" type="int">{width}</attr>
                <attr key="sizeY" type="int">{height}</attr>
"#
    );
    let mut streams = stream(EVENTS, "events", "EVTS", "Array of events (polarity ON/OFF).", &size);
    if others.frames {
        streams += &stream(FRAMES, "frames", "FRME", "Standard frame (8-bit image).", &size);
    }
    if others.imu {
        streams += &stream(IMU, "imu", "IMUS", "Inertial Measurement Unit data samples.", "");
    }
    format!(
        r#"<dv version="2.0">
    <node name="outInfo" path="/outInfo/">
{streams}    </node>
</dv>
"#
    )
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use evcal_core::event::Polarity;

    use super::*;
    use crate::aedat4::flatbuffer;

    #[test]
    fn the_closing_table_points_at_the_content_of_each_packet() {
        let mut file = Cursor::new(Vec::new());
        let mut encoder = Encoder::new(&mut file, Compression::None, Sensor::new(346, 260), "camera").unwrap();
        let events: Vec<Event> = (0..100).map(|t| Event { t: t * 1000, x: 1, y: 2, polarity: Polarity::On }).collect();
        encoder.write(&events).unwrap();
        encoder.finish().unwrap();
        let bytes = file.into_inner();

        let header = flatbuffer::root(&bytes[18..], b"IOHE").unwrap();
        let table_position = header.i64(1, -1).unwrap() as usize;
        let table = flatbuffer::root(&bytes[table_position + 4..], b"FTAB").unwrap().vector(0).unwrap();
        assert_eq!(table.length, 10);
        let mut end = 18 + u32::from_le_bytes(bytes[14..18].try_into().unwrap()) as usize;
        for index in 0..table.length {
            let row = table.table(index).unwrap();
            let byte = row.i64(0, 0).unwrap() as usize;
            assert_eq!(byte, end + 8);
            let size = i32::from_le_bytes(bytes[end + 4..end + 8].try_into().unwrap());
            assert_eq!(row.i64(2, 0).unwrap(), 10);
            assert_eq!(
                (row.i64(3, 0).unwrap(), row.i64(4, 0).unwrap()),
                (index as i64 * 10_000, index as i64 * 10_000 + 9000)
            );
            assert_eq!(&bytes[byte + 8..byte + 12], b"EVTS");
            end = byte + size as usize;
        }
        assert_eq!(end, table_position);
    }
}
