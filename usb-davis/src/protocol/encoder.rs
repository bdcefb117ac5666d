//! Encodes messages to the bytes that the camera would send.
//!
//! Follows the rules of the camera's multiplexer: wrap words until the time is within 2^15 µs, a timestamp only if its
//! low 15 bits have changed and are not zero, a row address with its timestamp before the columns of the same time and
//! row.

use core::fmt;
use core::iter;

use super::frame::{Geometry, SATURATED};
use super::imu::{ImuSample, wire_bytes};
use super::layout::Layout;
use super::message::{Frame, PolarityEvent, Shutter, Signal, SignalEvent};
use super::word::{Special, Word};

/// Largest multiplier of a wrap word.
const WRAP_MOST: u64 = 0x0FFF;

/// Reason why an item cannot be encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EncodeError {
    /// The item is older than the previous one; pass items in order of time, or reset the time.
    TimeBackwards {
        /// The item's time in µs.
        time: u64,
        /// The latest time in µs.
        latest: u64,
    },
    /// The pixel or region is not on the sensor.
    OutOfRange {
        /// Column.
        x: u16,
        /// Row.
        y: u16,
    },
    /// The number of pixels of a frame differs from that of its region.
    PixelCount {
        /// Pixels of the region.
        expected: usize,
        /// Number of pixels given.
        given: usize,
    },
}

impl fmt::Display for EncodeError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TimeBackwards { time, latest } => {
                write!(formatter, "an item at {time} µs follows an item at {latest} µs; order items by time")
            }
            Self::OutOfRange { x, y } => write!(formatter, "({x}, {y}) is not on the sensor"),
            Self::PixelCount { expected, given } => {
                write!(formatter, "frame region has {expected} pixels, {given} given")
            }
        }
    }
}

impl core::error::Error for EncodeError {}

/// One part of a frame; other items may be sent between the parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameStep {
    /// Frame start, exposure time and corners.
    Start,
    /// Reset levels of this wire column.
    ResetColumn(u16),
    /// The exposure begins.
    ExposureStart,
    /// The exposure ends.
    ExposureEnd,
    /// Signal levels of this wire column.
    SignalColumn(u16),
    /// The frame ends.
    End,
}

/// Returns the steps of `frame` in order, each with its time. Columns are spread evenly between the frame's four times.
/// With a rolling shutter, the signal of a column is read a quarter of the columns after its reset.
pub fn frame_steps(layout: &Layout, frame: &Frame<'_>) -> impl Iterator<Item = (u64, FrameStep)> + use<> {
    let columns = Geometry::new(&layout.aps, frame.region).columns;
    let Frame { shutter, start, end, .. } = *frame;
    let (exposure_start, exposure_end) = (frame.exposure_start, frame.exposure_end);
    let first = exposure_start.unwrap_or(start);
    let last = exposure_end.unwrap_or(first);
    let (lag, before, exposure_slot) = match shutter {
        Shutter::Global => (columns, (start, first), columns),
        Shutter::Rolling => ((columns / 4).max(1), (first, last), 0),
    };
    let between = |(from, to): (u64, u64), part: u16, parts: u16| {
        from + to.saturating_sub(from) * u64::from(part) / u64::from(parts.max(1))
    };
    let slots = (0..columns + lag).flat_map(move |slot| {
        let time = match slot < lag {
            true => between(before, slot, lag),
            false => between((last, end), slot - lag, columns),
        };
        let exposure_begins = if slot == exposure_slot { exposure_start } else { None };
        let exposure_ends = if slot == lag { exposure_end } else { None };
        [
            exposure_begins.map(|time| (time, FrameStep::ExposureStart)),
            exposure_ends.map(|time| (time, FrameStep::ExposureEnd)),
            (slot < columns).then_some((time, FrameStep::ResetColumn(slot))),
            (slot >= lag).then(|| (time, FrameStep::SignalColumn(slot - lag))),
        ]
        .into_iter()
        .flatten()
    });
    iter::once((start, FrameStep::Start)).chain(slots).chain(iter::once((end, FrameStep::End)))
}

/// Writes the words of a stream, two bytes each, to a collection of bytes.
///
/// Decoding the output returns the input, with two exceptions: a mirrored −32768 of an IMU sample becomes −32767, and
/// the damage of a frame is not reproduced.
#[derive(Clone, Debug)]
pub struct Encoder {
    layout: Layout,
    /// Latest time in µs.
    time: u64,
    /// Time at the latest wrap in µs.
    wrap: u64,
    /// Low 15 bits of the decoder's time.
    low: u16,
    /// Row of the latest address, valid at `time` only.
    row: Option<u16>,
}

fn put(word: Word, out: &mut impl Extend<u8>) {
    out.extend(word.emit().to_le_bytes());
}

impl Encoder {
    /// Creates an encoder at time 0.
    pub fn new(layout: Layout) -> Self {
        Self { layout, time: 0, wrap: 0, low: 0, row: None }
    }

    /// Returns the latest time in µs.
    pub fn time(&self) -> u64 {
        self.time
    }

    /// Advances the time: writes the wrap words up to `time`.
    pub fn advance(&mut self, time: u64, out: &mut impl Extend<u8>) -> Result<(), EncodeError> {
        if time < self.time {
            return Err(EncodeError::TimeBackwards { time, latest: self.time });
        }
        if time > self.time {
            self.row = None;
        }
        self.time = time;
        let mut wraps = (time - self.wrap) >> 15;
        while wraps > 0 {
            let times = wraps.min(WRAP_MOST);
            put(Word::Wrap(times as u16), out);
            self.wrap += times << 15;
            self.low = 0;
            wraps -= times;
        }
        Ok(())
    }

    fn stamp(&mut self, time: u64, out: &mut impl Extend<u8>) -> Result<(), EncodeError> {
        self.advance(time, out)?;
        let low = (time & 0x7FFF) as u16;
        if low != self.low {
            put(Word::Timestamp(low), out);
            self.low = low;
        }
        Ok(())
    }

    fn special(&mut self, time: u64, special: Special, out: &mut impl Extend<u8>) -> Result<(), EncodeError> {
        self.stamp(time, out)?;
        put(Word::Special(special), out);
        Ok(())
    }

    /// Restarts the time at zero.
    pub fn timestamp_reset(&mut self, out: &mut impl Extend<u8>) {
        put(Word::Special(Special::TimestampReset), out);
        *self = Self::new(self.layout);
    }

    /// Writes a pixel event.
    pub fn event(&mut self, event: &PolarityEvent, out: &mut impl Extend<u8>) -> Result<(), EncodeError> {
        let &PolarityEvent { time, x, y, polarity } = event;
        let array = &self.layout.dvs;
        // Swapping the axes is its own inverse.
        let (column, row) = array.swap(x, y);
        if column >= array.columns || row >= array.rows {
            return Err(EncodeError::OutOfRange { x, y });
        }
        self.stamp(time, out)?;
        if self.row != Some(row) {
            put(Word::Row(row), out);
            self.row = Some(row);
        }
        put(Word::Column(column, polarity), out);
        Ok(())
    }

    /// Writes a signal at a connector.
    pub fn signal(&mut self, event: &SignalEvent, out: &mut impl Extend<u8>) -> Result<(), EncodeError> {
        let special = match event.signal {
            Signal::ExternalInputRising => Special::ExternalInputRising,
            Signal::ExternalInputFalling => Special::ExternalInputFalling,
            Signal::ExternalInputPulse => Special::ExternalInputPulse,
            Signal::GeneratorRising => Special::GeneratorRising,
            Signal::GeneratorFalling => Special::GeneratorFalling,
        };
        self.special(event.time, special, out)
    }

    /// Writes an IMU sample.
    pub fn imu(&mut self, sample: &ImuSample, out: &mut impl Extend<u8>) -> Result<(), EncodeError> {
        self.special(sample.time, Special::ImuStart, out)?;
        let (contents, bytes) = wire_bytes(sample, &self.layout.imu);
        put(Word::ImuScale(contents), out);
        for byte in bytes {
            put(Word::ImuByte(byte), out);
        }
        self.special(sample.time, Special::ImuEnd, out)
    }

    /// Writes a whole frame with nothing between its steps.
    pub fn frame(&mut self, frame: &Frame<'_>, out: &mut impl Extend<u8>) -> Result<(), EncodeError> {
        for (time, step) in frame_steps(&self.layout, frame) {
            self.frame_step(time, frame, step, out)?;
        }
        Ok(())
    }

    /// Writes one step of a frame, see [`frame_steps`].
    pub fn frame_step(
        &mut self,
        time: u64,
        frame: &Frame<'_>,
        step: FrameStep,
        out: &mut impl Extend<u8>,
    ) -> Result<(), EncodeError> {
        match step {
            FrameStep::Start => self.frame_start(time, frame, out),
            FrameStep::ResetColumn(column) => {
                self.column(time, frame, column, Special::ResetColumnStart, |_| SATURATED, out)
            }
            FrameStep::SignalColumn(column) => {
                let signal = |pixel: u16| SATURATED.saturating_sub(pixel);
                self.column(time, frame, column, Special::SignalColumnStart, signal, out)
            }
            FrameStep::ExposureStart => self.special(time, Special::ExposureStart, out),
            FrameStep::ExposureEnd => self.special(time, Special::ExposureEnd, out),
            FrameStep::End => self.special(time, Special::FrameEnd, out),
        }
    }

    fn frame_start(&mut self, time: u64, frame: &Frame<'_>, out: &mut impl Extend<u8>) -> Result<(), EncodeError> {
        let region = frame.region;
        let (width, height) = self.layout.aps.size();
        let last_x = region.x.saturating_add(region.width.saturating_sub(1));
        let last_y = region.y.saturating_add(region.height.saturating_sub(1));
        if last_x >= width || last_y >= height || region.width == 0 || region.height == 0 {
            return Err(EncodeError::OutOfRange { x: last_x, y: last_y });
        }
        let expected = usize::from(region.width) * usize::from(region.height);
        if expected != frame.pixels.len() {
            return Err(EncodeError::PixelCount { expected, given: frame.pixels.len() });
        }
        let special = match frame.shutter {
            Shutter::Global => Special::FrameStartGlobalShutter,
            Shutter::Rolling => Special::FrameStartRollingShutter,
        };
        self.special(time, special, out)?;
        for chunk in 0..3 {
            put(Word::Exposure((frame.exposure_cycles >> (10 * chunk) & 0x3FF) as u16), out);
        }
        for corner in [region.x, region.y, last_x, last_y] {
            let [high, low] = corner.to_be_bytes();
            put(Word::RegionHigh(high), out);
            put(Word::RegionLow(low), out);
        }
        Ok(())
    }

    fn column(
        &mut self,
        time: u64,
        frame: &Frame<'_>,
        index: u16,
        start: Special,
        level: impl Fn(u16) -> u16,
        out: &mut impl Extend<u8>,
    ) -> Result<(), EncodeError> {
        self.special(time, start, out)?;
        let geometry = Geometry::new(&self.layout.aps, frame.region);
        let (mut position, step) = geometry.column(&self.layout.aps, index);
        for _ in 0..geometry.rows {
            let pixel = frame.pixels.get(position).copied().unwrap_or(0);
            put(Word::Sample(level(pixel)), out);
            position = position.wrapping_add_signed(step);
        }
        self.special(time, Special::ColumnEnd, out)
    }
}
