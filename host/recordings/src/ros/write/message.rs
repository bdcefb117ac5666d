//! Serialization of messages.

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::super::fields::Wire;
use super::super::message::GRAVITY;
use crate::encode::WriteError;
use crate::extras::{Frame, InertialSample};

/// Name of the coordinate frame of all messages.
const FRAME_ID: &str = "camera";
/// First value of an unknown covariance or orientation.
const UNKNOWN: f64 = -1.0;

/// A message under construction.
struct Message {
    wire: Wire,
    bytes: Vec<u8>,
}

impl Message {
    /// Begins with a header with this time in µs. `number` counts the messages of its topic.
    fn new(wire: Wire, number: u32, t: i64) -> Result<Self, WriteError> {
        let mut message = Self { wire, bytes: Vec::new() };
        if wire == Wire::Ros1 {
            message.number(number.to_le_bytes());
        }
        message.time(t)?;
        message.text(FRAME_ID)?;
        Ok(message)
    }

    fn number<const N: usize>(&mut self, bytes: [u8; N]) -> &mut Self {
        if self.wire == Wire::Cdr {
            self.bytes.resize(self.bytes.len().next_multiple_of(N), 0);
        }
        self.bytes.extend_from_slice(&bytes);
        self
    }

    /// Appends a time as seconds and nanoseconds. ROS has no negative times, and ROS 2 none from 2038 on.
    fn time(&mut self, t: i64) -> Result<(), WriteError> {
        let seconds = u32::try_from(t.div_euclid(1_000_000)).ok();
        let largest = if self.wire == Wire::Ros1 { u32::MAX } else { u32::MAX / 2 };
        let seconds = seconds.filter(|seconds| *seconds <= largest).ok_or(WriteError::Time(t))?;
        let nanoseconds = (t.rem_euclid(1_000_000) * 1000) as u32;
        self.number(seconds.to_le_bytes()).number(nanoseconds.to_le_bytes());
        Ok(())
    }

    fn bytes(&mut self, bytes: &[u8]) -> Result<&mut Self, WriteError> {
        let length = u32::try_from(bytes.len()).map_err(|_| WriteError::TooLarge)?;
        self.number(length.to_le_bytes());
        self.bytes.extend_from_slice(bytes);
        Ok(self)
    }

    fn text(&mut self, text: &str) -> Result<&mut Self, WriteError> {
        match self.wire {
            Wire::Ros1 => self.bytes(text.as_bytes()),
            Wire::Cdr => self.bytes(&[text.as_bytes(), &[0]].concat()),
        }
    }

    fn size(&mut self, width: u16, height: u16) -> &mut Self {
        self.number(u32::from(height).to_le_bytes()).number(u32::from(width).to_le_bytes())
    }

    fn finish(self) -> Vec<u8> {
        match self.wire {
            Wire::Ros1 => self.bytes,
            Wire::Cdr => [&[0, 1, 0, 0], self.bytes.as_slice()].concat(),
        }
    }
}

/// Returns the time of the last event, in µs.
fn end(events: &[Event]) -> i64 {
    events.last().map_or(0, |event| event.t)
}

/// Serializes a `dvs_msgs/EventArray`.
pub fn event_array(wire: Wire, number: u32, sensor: Sensor, events: &[Event]) -> Result<Vec<u8>, WriteError> {
    let mut message = Message::new(wire, number, end(events))?;
    let count = u32::try_from(events.len()).map_err(|_| WriteError::TooLarge)?;
    message.size(sensor.width, sensor.height).number(count.to_le_bytes());
    for event in events {
        message.number(event.x.to_le_bytes()).number(event.y.to_le_bytes());
        message.time(event.t)?;
        message.number([event.polarity.index() as u8]);
    }
    Ok(message.finish())
}

/// Serializes an `event_camera_msgs/EventPacket` with the encoding `libcaer_cmp`, in which columns and rows have 11
/// bits. The events must span less than 2²⁴ µs.
pub fn event_packet(wire: Wire, number: u32, sensor: Sensor, events: &[Event]) -> Result<Vec<u8>, WriteError> {
    let base = events.first().map_or(0, |event| event.t);
    let base_ns = u64::try_from(base).ok().and_then(|base| base.checked_mul(1000)).ok_or(WriteError::Time(base))?;
    let mut message = Message::new(wire, number, end(events))?;
    message.size(sensor.width, sensor.height).number(u64::from(number).to_le_bytes()).number(base_ns.to_le_bytes());
    message.text("libcaer_cmp")?.number([0]).bytes(&compressed(base, events))?;
    Ok(message.finish())
}

/// Encodes events in words of 16 bits, with their type in bits 15–12: 0 time high, 1 time low, 2 column, 3 row and
/// polarity of an event.
fn compressed(base: i64, events: &[Event]) -> Vec<u8> {
    let (mut high, mut low, mut column) = (0_u16, 0_u16, None);
    let mut bytes = Vec::with_capacity(6 * events.len());
    let mut word = |kind: u16, value: u16| bytes.extend_from_slice(&(kind << 12 | value).to_le_bytes());
    for event in events {
        let t = event.t.abs_diff(base);
        let (new_high, new_low) = ((t >> 12) as u16 & 0xfff, t as u16 & 0xfff);
        if new_high != high {
            high = new_high;
            word(0, high);
        }
        if new_low != low {
            low = new_low;
            word(1, low);
        }
        if column != Some(event.x) {
            column = Some(event.x);
            word(2, event.x & 0x7ff);
        }
        word(3, u16::from(event.polarity == Polarity::On) << 11 | event.y & 0x7ff);
    }
    bytes
}

/// Serializes a `sensor_msgs/Image`, grey or in colour.
pub fn image(wire: Wire, number: u32, frame: &Frame) -> Result<Vec<u8>, WriteError> {
    let mut message = Message::new(wire, number, frame.middle())?;
    let (width, height) = frame.size;
    let (encoding, channels) = if matches!(frame.channels, 1 | 2) { ("mono8", 1) } else { ("bgr8", 3) };
    let opaque: Vec<u8>;
    let pixels = match frame.channels {
        2 => {
            opaque = frame.pixels.as_chunks::<2>().0.iter().map(|[grey, _]| *grey).collect();
            &opaque
        }
        4 => {
            opaque = frame.pixels.as_chunks::<4>().0.iter().flat_map(|[b, g, r, _]| [*b, *g, *r]).collect();
            &opaque
        }
        _ => &frame.pixels,
    };
    message.size(width, height).text(encoding)?.number([0]).number((u32::from(width) * channels).to_le_bytes());
    message.bytes(pixels)?;
    Ok(message.finish())
}

/// Serializes a `sensor_msgs/Imu` without an orientation.
pub fn imu(wire: Wire, number: u32, sample: &InertialSample) -> Result<Vec<u8>, WriteError> {
    let mut message = Message::new(wire, number, sample.t)?;
    let mut numbers = |values: &[f64]| {
        for value in values {
            message.number(value.to_le_bytes());
        }
    };
    let scaled = |values: [f32; 3], scale: f64| values.map(|value| f64::from(value) * scale);
    numbers(&[0.0, 0.0, 0.0, 1.0, UNKNOWN]);
    numbers(&[0.0; 8]);
    numbers(&scaled(sample.angular_velocity, std::f64::consts::PI / 180.0));
    numbers(&[0.0; 9]);
    numbers(&scaled(sample.acceleration, GRAVITY));
    numbers(&[0.0; 9]);
    Ok(message.finish())
}
