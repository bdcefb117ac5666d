//! The FlatBuffers of an AEDAT4 file, laid out by hand. All offsets and alignments count from the start of the size
//! prefix.

use evcal_core::event::{Event, Polarity};

use super::TableRow;
use crate::aedat4::header::Compression;
use crate::encode::WriteError;
use crate::extras::{Frame, InertialSample};

/// A FlatBuffer under construction, beginning with its size prefix.
struct Buffer(Vec<u8>);

impl Buffer {
    /// Begins with space for the size prefix and the position of the root table, then the identifier.
    fn new(identifier: &[u8; 4]) -> Self {
        let mut bytes = vec![0; 8];
        bytes.extend_from_slice(identifier);
        Self(bytes)
    }

    /// Begins with a root table that has a single field, a vector of `count` elements, which follow from @32 on: @12 a
    /// vtable of 6 bytes for a table of 8, padded up to @20; @24 the offset of the vector, @28 its length.
    fn of_vector(identifier: &[u8; 4], count: usize) -> Result<Self, WriteError> {
        let mut buffer = Self::new(identifier);
        buffer.u16s(&[6, 8, 4, 0]);
        buffer.i32(20 - 12);
        buffer.size(28 - 24)?;
        buffer.size(count)?;
        Ok(buffer)
    }

    fn u16s(&mut self, values: &[u16]) {
        self.0.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }

    fn i32(&mut self, value: i32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn f32(&mut self, value: f32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn i64(&mut self, value: i64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    /// Appends a length or a forward offset.
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

/// `IOHE { compression @28, dataTablePosition @32 (unknown at first), infoNode @40 → @44 }`
pub(in crate::aedat4) fn header(compression: Compression, description: &str) -> Result<Vec<u8>, WriteError> {
    let mut buffer = Buffer::new(b"IOHE");
    // @12: vtable of 10 bytes, table of 20 bytes, its three fields; padded up to @24.
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
    // Strings end with a zero. Padding to whole words keeps the packets after it aligned.
    let padding = 8 - buffer.0.len() % 8;
    buffer.0.extend(std::iter::repeat_n(0, padding));
    buffer.finish(24)
}

/// `EVTS { elements @24 → @28 }`, elements from @32.
pub(in crate::aedat4) fn event_packet(events: &[Event]) -> Result<Vec<u8>, WriteError> {
    let mut buffer = Buffer::of_vector(b"EVTS", events.len())?;
    buffer.0.reserve(16 * events.len());
    for event in events {
        buffer.i64(event.t);
        buffer.u16s(&[event.x, event.y]);
        buffer.0.extend_from_slice(&[u8::from(event.polarity == Polarity::On), 0, 0, 0]);
    }
    buffer.finish(20)
}

/// `FRME { t @48, frame @56 to @64, exposure @72 to @80, exposure time @88, width @96, height @98,
/// x @100, y @102, format @104, pixels @108 → @112 }`
pub(super) fn frame_packet(frame: &Frame) -> Result<Vec<u8>, WriteError> {
    let mut buffer = Buffer::new(b"FRME");
    // @12: vtable of 28 bytes, padded up to @44; table of 68 bytes.
    buffer.u16s(&[28, 68, 4, 12, 20, 28, 36, 60, 52, 54, 56, 58, 64, 44, 0, 0]);
    buffer.i32(44 - 12);
    buffer.i64(frame.t);
    let (exposure_start, exposure_end) = frame.exposure.unwrap_or((-1, -1));
    let (start, end) = frame.readout.unwrap_or((-1, -1));
    for time in [start, end, exposure_start, exposure_end, exposure_end - exposure_start] {
        buffer.i64(time);
    }
    buffer.u16s(&[frame.size.0, frame.size.1, frame.position.0, frame.position.1]);
    // OpenCV's type number for this number of 8-bit channels, then unused bytes.
    let channels = u8::try_from(frame.channels).ok().filter(|channels| (1..=4).contains(channels));
    buffer.0.extend_from_slice(&[(channels.ok_or(WriteError::TooLarge)? - 1) << 3, 0, 0, 0]);
    buffer.size(112 - 108)?;
    buffer.size(frame.pixels.len())?;
    buffer.0.extend_from_slice(&frame.pixels);
    buffer.finish(44)
}

/// `IMUS { elements @24 → @28 }`: n offsets from @32, then one vtable, then n tables of 40 bytes
/// `{ temperature @4, acceleration @8, angular velocity @20, t @32 }`.
pub(super) fn imu_packet(samples: &[InertialSample]) -> Result<Vec<u8>, WriteError> {
    let mut buffer = Buffer::of_vector(b"IMUS", samples.len())?;
    let vtable = 32 + 4 * samples.len();
    let first_table = (vtable + 20).next_multiple_of(8);
    let table = |index: usize| first_table + 40 * index;
    for index in 0..samples.len() {
        buffer.size(table(index) - (32 + 4 * index))?;
    }
    buffer.u16s(&[20, 40, 32, 4, 8, 12, 16, 20, 24, 28]);
    for (index, sample) in samples.iter().enumerate() {
        buffer.0.resize(table(index), 0);
        buffer.i32(i32::try_from(table(index) - vtable).map_err(|_| WriteError::TooLarge)?);
        let [ax, ay, az] = sample.acceleration;
        let [gx, gy, gz] = sample.angular_velocity;
        for value in [sample.temperature, ax, ay, az, gx, gy, gz] {
            buffer.f32(value);
        }
        buffer.i64(sample.t);
    }
    buffer.finish(20)
}

/// `FTAB { table @24 → @28 }`: n offsets from @32, then one vtable, then n tables of 44 bytes
/// `{ byteOffset @12, { stream, size } @4, numElements @20, timestampStart @28, timestampEnd @36 }`.
pub(super) fn packet_table(rows: &[TableRow]) -> Result<Vec<u8>, WriteError> {
    let mut buffer = Buffer::of_vector(b"FTAB", rows.len())?;
    // Tables begin 4 bytes after a multiple of 8, so that their i64 fields are aligned.
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
        buffer.i32(row.stream);
        buffer.i32(row.size);
        buffer.i64(i64::try_from(row.byte).map_err(|_| WriteError::TooLarge)?);
        buffer.i64(row.elements);
        buffer.i64(row.first);
        buffer.i64(row.last);
    }
    buffer.finish(20)
}
