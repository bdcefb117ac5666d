//! Writing AEDAT4: one stream of events, closed by the table of packets that dv-processing expects.
//!
//! The FlatBuffers are laid out by hand; every offset is from the start of the size prefix, to which
//! their alignment refers too.

use std::io::{Seek, SeekFrom, Write};

use evcal_core::event::{Event, Polarity};

use super::header::{Compression, MAGIC};
use crate::source::write::{Encode, WriteError};

/// A packet spans at most this many microseconds, as with dv-processing...
const PACKET_DURATION: i64 = 10_000;
/// ... and this many events.
const PACKET_EVENTS: usize = 32_768;
/// Zstandard's own default.
const ZSTD_LEVEL: i32 = 3;
/// Offset in the file of the field that says where the closing table is.
const TABLE_POSITION_FIELD: u64 = MAGIC.len() as u64 + 32;

/// One row of the closing table.
struct TableRow {
    /// Offset of the content of the packet, behind its head.
    byte: u64,
    size: i32,
    events: i64,
    first: i64,
    last: i64,
}

/// Writes AEDAT4.
pub struct Encoder<W> {
    output: W,
    compression: Compression,
    position: u64,
    packet: Vec<Event>,
    table: Vec<TableRow>,
}

impl<W: Write + Seek> Encoder<W> {
    /// Writes the header.
    pub fn new(
        mut output: W,
        compression: Compression,
        sensor: (u16, u16),
        camera_name: &str,
    ) -> Result<Self, WriteError> {
        let header = header(compression, &stream_description(compression, sensor, camera_name))?;
        output.write_all(MAGIC)?;
        output.write_all(&header)?;
        let position = (MAGIC.len() + header.len()) as u64;
        Ok(Self { output, compression, position, packet: Vec::new(), table: Vec::new() })
    }

    fn write_packet(&mut self) -> Result<(), WriteError> {
        let (Some(first), Some(last)) = (self.packet.first(), self.packet.last()) else {
            return Ok(());
        };
        let (first, last) = (first.t, last.t);
        let packed = pack(self.compression, &event_packet(&self.packet)?)?;
        let size = i32::try_from(packed.len()).map_err(|_| WriteError::TooLarge)?;
        self.output.write_all(&0i32.to_le_bytes())?;
        self.output.write_all(&size.to_le_bytes())?;
        self.output.write_all(&packed)?;
        self.table.push(TableRow { byte: self.position + 8, size, events: self.packet.len() as i64, first, last });
        self.position += 8 + packed.len() as u64;
        self.packet.clear();
        Ok(())
    }
}

impl<W: Write + Seek> Encode for Encoder<W> {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        for &event in events {
            let full = self.packet.len() >= PACKET_EVENTS
                || self.packet.first().is_some_and(|first| event.t.saturating_sub(first.t) >= PACKET_DURATION);
            if full {
                self.write_packet()?;
            }
            self.packet.push(event);
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        self.write_packet()?;
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

/// The XML that describes the only stream.
fn stream_description(compression: Compression, (width, height): (u16, u16), camera_name: &str) -> String {
    let compression = match compression {
        Compression::None => "NONE",
        Compression::Lz4 => "LZ4",
        Compression::Zstd => "ZSTD",
    };
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
    format!(
        r#"<dv version="2.0">
    <node name="outInfo" path="/outInfo/">
        <node name="0" path="/outInfo/0/">
            <attr key="compression" type="string">{compression}</attr>
            <attr key="originalModuleName" type="string">evcal</attr>
            <attr key="originalOutputName" type="string">events</attr>
            <attr key="typeDescription" type="string">Array of events (polarity ON/OFF).</attr>
            <attr key="typeIdentifier" type="string">EVTS</attr>
            <node name="info" path="/outInfo/0/info/">
                <attr key="sizeX" type="int">{width}</attr>
                <attr key="sizeY" type="int">{height}</attr>
                <attr key="source" type="string">{camera_name}</attr>
            </node>
        </node>
    </node>
</dv>
"#
    )
}

/// A FlatBuffer that grows from its size prefix on.
struct Buffer(Vec<u8>);

impl Buffer {
    /// Room for the size prefix and the position of the root table, then the identifier.
    fn new(identifier: &[u8; 4]) -> Self {
        let mut bytes = vec![0; 8];
        bytes.extend_from_slice(identifier);
        Self(bytes)
    }

    fn u16s(&mut self, values: &[u16]) {
        self.0.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }

    fn i32(&mut self, value: i32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn i64(&mut self, value: i64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    /// A length, or an offset to something further on.
    fn size(&mut self, value: usize) -> Result<(), WriteError> {
        let value = u32::try_from(value).map_err(|_| WriteError::TooLarge)?;
        self.0.extend_from_slice(&value.to_le_bytes());
        Ok(())
    }

    /// Fills in the size prefix and the position of the root table.
    fn finish(mut self, root: u32) -> Result<Vec<u8>, WriteError> {
        let size = u32::try_from(self.0.len() - 4).map_err(|_| WriteError::TooLarge)?;
        self.0.splice(..8, size.to_le_bytes().into_iter().chain((root - 4).to_le_bytes()));
        Ok(self.0)
    }
}

/// `IOHE { compression @28, dataTablePosition @32 (not known yet), infoNode @40 → @44 }`
pub(super) fn header(compression: Compression, description: &str) -> Result<Vec<u8>, WriteError> {
    let mut buffer = Buffer::new(b"IOHE");
    // @12: vtable of 10 bytes, table of 20 bytes, its three fields; filled up to @24.
    buffer.u16s(&[10, 20, 4, 8, 16, 0]);
    buffer.i32(24 - 12);
    buffer.i32(match compression {
        Compression::None => 0,
        Compression::Lz4 => 1,
        Compression::Zstd => 3,
    });
    buffer.i64(-1);
    buffer.size(44 - 40)?;
    buffer.size(description.len())?;
    buffer.0.extend_from_slice(description.as_bytes());
    // Strings end with a zero; whole words keep the packets after it aligned.
    let padding = 8 - buffer.0.len() % 8;
    buffer.0.extend(std::iter::repeat_n(0, padding));
    buffer.finish(24)
}

/// `EVTS { elements @24 → @28 }`, elements from @32.
pub(super) fn event_packet(events: &[Event]) -> Result<Vec<u8>, WriteError> {
    let mut buffer = Buffer::new(b"EVTS");
    buffer.0.reserve(20 + 16 * events.len());
    // @12: vtable of 6 bytes, table of 8 bytes, its only field; filled up to @20.
    buffer.u16s(&[6, 8, 4, 0]);
    buffer.i32(20 - 12);
    buffer.size(28 - 24)?;
    buffer.size(events.len())?;
    for event in events {
        buffer.i64(event.t);
        buffer.u16s(&[event.x, event.y]);
        buffer.0.extend_from_slice(&[u8::from(event.polarity == Polarity::On), 0, 0, 0]);
    }
    buffer.finish(20)
}

/// `FTAB { table @24 → @28 }`: n offsets from @32, then one vtable, then n tables of 44 bytes
/// `{ byteOffset @12, { stream, size } @4, numElements @20, timestampStart @28, timestampEnd @36 }`.
fn packet_table(rows: &[TableRow]) -> Result<Vec<u8>, WriteError> {
    let mut buffer = Buffer::new(b"FTAB");
    buffer.u16s(&[6, 8, 4, 0]);
    buffer.i32(20 - 12);
    buffer.size(28 - 24)?;
    buffer.size(rows.len())?;
    // Tables begin 4 bytes after a multiple of 8, so that their i64 fields lie on one.
    let vtable = 32 + 4 * rows.len();
    let first_table = (vtable + 14).next_multiple_of(8) + 4;
    let table = |index: usize| first_table + 48 * index;
    for index in 0..rows.len() {
        buffer.size(table(index) - (32 + 4 * index))?;
    }
    buffer.u16s(&[14, 44, 12, 4, 20, 28, 36]);
    for (index, row) in rows.iter().enumerate() {
        buffer.0.resize(table(index), 0);
        buffer.i32(i32::try_from(table(index) - vtable).map_err(|_| WriteError::TooLarge)?);
        buffer.i32(0);
        buffer.i32(row.size);
        buffer.i64(i64::try_from(row.byte).map_err(|_| WriteError::TooLarge)?);
        buffer.i64(row.events);
        buffer.i64(row.first);
        buffer.i64(row.last);
    }
    buffer.finish(20)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::source::aedat4::flatbuffer;

    #[test]
    fn the_closing_table_points_at_the_content_of_each_packet() {
        let mut file = Cursor::new(Vec::new());
        let mut encoder = Encoder::new(&mut file, Compression::None, (346, 260), "camera").unwrap();
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
