//! The supported messages.

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::fields::{Fields, MessageError, Wire};
use super::packet::{self, PacketDecoder};
use crate::extras::InertialSample;

/// Standard gravity in m/s².
pub const GRAVITY: f64 = 9.806_65;

/// Size in bytes of the pieces in which encoded events are decoded. It is a multiple of the size of all words, and at most
/// 393,216 events are in it.
const PIECE: usize = 1 << 16;

/// Content of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// An array of events.
    EventArray,
    /// Encoded events.
    EventPacket,
    /// An image.
    Image,
    /// An image as the bytes of a JPEG or PNG file.
    CompressedImage,
    /// An IMU sample.
    Imu,
    /// Anything else.
    Other,
}

impl Kind {
    /// Returns the kind of a type such as `dvs_msgs/EventArray` or `dvs_msgs/msg/EventArray`.
    pub fn of_type(name: &str) -> Self {
        let (package, message) = (name.split('/').next(), name.rsplit('/').next());
        match (package, message) {
            // All of these have the layout of the first.
            (Some("dvs_msgs" | "prophesee_event_msgs" | "dv_ros_msgs" | "samsung_event_msgs"), Some("EventArray")) => {
                Self::EventArray
            }
            (Some("event_camera_msgs" | "event_array_msgs"), Some("EventPacket" | "EventArray")) => Self::EventPacket,
            (Some("sensor_msgs"), Some("Image")) => Self::Image,
            (Some("sensor_msgs"), Some("CompressedImage")) => Self::CompressedImage,
            (Some("sensor_msgs"), Some("Imu")) => Self::Imu,
            _ => Self::Other,
        }
    }

    /// `true` for messages with events.
    pub fn contains_events(self) -> bool {
        matches!(self, Self::EventArray | Self::EventPacket)
    }

    /// `true` for messages with an image.
    pub fn contains_images(self) -> bool {
        matches!(self, Self::Image | Self::CompressedImage)
    }
}

fn side(size: u32) -> u16 {
    // A value larger than any sensor is rejected later.
    u16::try_from(size).unwrap_or(u16::MAX)
}

/// Properties of a message with events.
pub struct Description {
    /// Size of the sensor, if the message contains it.
    pub sensor: Option<Sensor>,
    /// Encoding of the events, if the message names one.
    pub encoding: Option<String>,
    /// `true` if the message contains at least one event.
    pub has_events: bool,
}

impl Description {
    /// Returns the encoding if it is not supported.
    pub fn unread_encoding(&self) -> Option<&str> {
        self.encoding.as_deref().filter(|encoding| !packet::ENCODINGS.contains(encoding))
    }
}

/// Returns the name of the coordinate frame in the header of a message; empty without one.
pub fn frame_name(wire: Wire, message: &[u8]) -> String {
    let header = Fields::new(wire, message).and_then(|mut fields| fields.header_with_frame());
    header.map(|(_, frame)| String::from_utf8_lossy(frame).into_owned()).unwrap_or_default()
}

/// Reads the properties of a message with events.
pub fn description(kind: Kind, wire: Wire, message: &[u8]) -> Result<Description, MessageError> {
    let mut fields = Fields::new(wire, message)?;
    fields.header()?;
    let (height, width) = (fields.u32("its size")?, fields.u32("its size")?);
    // Some drivers omit the size from all messages, others from those without events.
    let sensor = (width > 0 && height > 0).then(|| Sensor::new(side(width), side(height)));
    if kind != Kind::EventPacket {
        return Ok(Description { sensor, encoding: None, has_events: fields.u32("the number of events")? > 0 });
    }
    fields.u64("its number")?;
    fields.u64("its time")?;
    let encoding = Some(String::from_utf8_lossy(fields.text("its encoding")?).into_owned());
    fields.u8("its byte order")?;
    Ok(Description { sensor, encoding, has_events: fields.u32("the events")? > 0 })
}

/// Appends events of a message of this `kind`, from byte `from` of its encoded events on, which is 0 at first. Returns the
/// byte to continue with; `None` at the end. Few bytes can contain so many events that they are decoded in pieces.
/// Events before an error are kept.
pub fn events(
    kind: Kind,
    wire: Wire,
    message: &[u8],
    from: usize,
    decoder: &mut PacketDecoder,
    events: &mut Vec<Event>,
) -> Result<Option<usize>, MessageError> {
    let mut fields = Fields::new(wire, message)?;
    fields.header()?;
    fields.u32("its size")?;
    fields.u32("its size")?;
    match kind {
        Kind::EventArray => {
            let count = fields.u32("the number of events")?;
            for _ in 0..count {
                let (x, y) = (fields.u16("an event")?, fields.u16("an event")?);
                let t = fields.time("an event")?;
                let polarity = if fields.u8("an event")? == 0 { Polarity::Off } else { Polarity::On };
                events.push(Event { t, x, y, polarity });
            }
            Ok(None)
        }
        Kind::EventPacket => {
            fields.u64("its number")?;
            let time_base = fields.u64("its time")?;
            let encoding = fields.text("its encoding")?;
            if fields.u8("its byte order")? != 0 {
                return Err(MessageError::BigEndian);
            }
            let rest = fields.bytes("the events")?.get(from..).unwrap_or_default();
            let (piece, more) = rest.split_at_checked(PIECE).unwrap_or((rest, &[]));
            if from == 0 {
                decoder.begin_packet();
            }
            decoder.decode(encoding, time_base, piece, events)?;
            Ok((!more.is_empty()).then_some(from + PIECE))
        }
        Kind::Image | Kind::CompressedImage | Kind::Imu | Kind::Other => Ok(None),
    }
}

/// Decodes an `Imu` message.
pub fn inertial_sample(wire: Wire, message: &[u8]) -> Result<InertialSample, MessageError> {
    let mut fields = Fields::new(wire, message)?;
    let t = fields.header()?;
    let mut numbers = |count: usize| (0..count).map(|_| fields.f64("its numbers")).collect::<Result<Vec<_>, _>>();
    // Skips the orientation and its covariance, which an IMU does not measure.
    numbers(4 + 9)?;
    let angular_velocity = numbers(3)?;
    numbers(9)?;
    let acceleration = numbers(3)?;
    let three = |values: &[f64], scale: f64| {
        let mut result = [0.0_f32; 3];
        result.iter_mut().zip(values).for_each(|(to, from)| *to = (from * scale) as f32);
        result
    };
    Ok(InertialSample {
        t,
        temperature: 0.0,
        acceleration: three(&acceleration, 1.0 / GRAVITY),
        angular_velocity: three(&angular_velocity, 180.0 / std::f64::consts::PI),
    })
}
