//! Writer of bags of ROS 1 and MCAP files of ROS 2.
//!
//! | file | events | frames, IMU samples |
//! |---|---|---|
//! | bag | `dvs_msgs/EventArray` | `sensor_msgs/Image`, `sensor_msgs/Imu` |
//! | MCAP | `event_camera_msgs/EventPacket`, encoding `libcaer_cmp` | as for a bag |

mod bag;
mod definitions;
mod mcap;
mod message;
mod sink;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

use self::sink::Sink;
use super::fields::Wire;
use crate::encode::{Encode, OutputFormat, WriteError};
use crate::extras::Extra;

/// Bag of ROS 1.
pub const BAG_OUTPUT: OutputFormat = OutputFormat {
    title: Some("ROS 1"),
    contains_extras: true,
    ..OutputFormat::of_events("bag", &["bag"], |file, description| {
        let sink = bag::Bag::new(file()?, &definitions::ROS1)?;
        Ok(Box::new(Encoder::new(sink, Wire::Ros1, message::event_array, description.sensor)))
    })
};

/// MCAP of ROS 2.
pub const MCAP_OUTPUT: OutputFormat = OutputFormat {
    title: Some("ROS 2"),
    contains_extras: true,
    ..OutputFormat::of_events("mcap", &["mcap"], |file, description| {
        let sensor = description.sensor;
        if sensor.width > SIDE || sensor.height > SIDE {
            return Err(WriteError::Size { format: "libcaer_cmp", most: SIDE, sensor });
        }
        let sink = mcap::Mcap::new(file()?, &definitions::ROS2)?;
        Ok(Box::new(Encoder::new(sink, Wire::Cdr, message::event_packet, sensor)))
    })
};

/// Columns and rows of `libcaer_cmp` have 11 bits.
const SIDE: u16 = 1 << 11;
/// Limits of a message of events: duration in µs, and number of events.
const MESSAGE_TIME: i64 = 10_000;
const MESSAGE_EVENTS: usize = 1 << 16;
/// Indices in the list of topics.
const EVENTS: usize = 0;
const FRAMES: usize = 1;
const SAMPLES: usize = 2;

/// Serializes events into a message, given the serialization, the number of the message, and the sensor.
type EventMessage = fn(Wire, u32, Sensor, &[Event]) -> Result<Vec<u8>, WriteError>;

struct Encoder<S> {
    sink: S,
    wire: Wire,
    event_message: EventMessage,
    sensor: Sensor,
    /// Events of the next message.
    events: Vec<Event>,
    /// Number of messages of each topic.
    counts: [u32; 3],
    exposures: u64,
}

impl<S: Sink> Encoder<S> {
    fn new(sink: S, wire: Wire, event_message: EventMessage, sensor: Sensor) -> Self {
        Self { sink, wire, event_message, sensor, events: Vec::new(), counts: [0; 3], exposures: 0 }
    }

    fn next_number(&mut self, topic: usize) -> u32 {
        self.counts.get_mut(topic).map_or(0, |count| {
            *count = count.wrapping_add(1);
            count.wrapping_sub(1)
        })
    }

    fn write_events(&mut self) -> Result<(), WriteError> {
        let Some(last) = self.events.last() else { return Ok(()) };
        let t = last.t;
        let number = self.next_number(EVENTS);
        let message = (self.event_message)(self.wire, number, self.sensor, &self.events)?;
        self.events.clear();
        self.sink.message(EVENTS, t, &message)
    }
}

impl<S: Sink> Encode for Encoder<S> {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        for event in events {
            let over = |first: &Event| event.t.saturating_sub(first.t) >= MESSAGE_TIME;
            if self.events.first().is_some_and(over) || self.events.len() == MESSAGE_EVENTS {
                self.write_events()?;
            }
            self.events.push(*event);
        }
        Ok(())
    }

    fn extra(&mut self, extra: Extra) -> Result<bool, WriteError> {
        match &extra {
            Extra::Frame(frame) => {
                self.exposures += u64::from(frame.exposure.is_some());
                let number = self.next_number(FRAMES);
                self.sink.message(FRAMES, frame.middle(), &message::image(self.wire, number, frame)?)?;
            }
            Extra::Inertial(sample) => {
                let number = self.next_number(SAMPLES);
                self.sink.message(SAMPLES, sample.t, &message::imu(self.wire, number, sample)?)?;
            }
        }
        Ok(true)
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        self.write_events()?;
        self.sink.finish()
    }

    fn lost(&self) -> Vec<String> {
        let lost = [
            (
                u64::from(self.counts[FRAMES]).min(self.exposures),
                "start and end of the exposures: an image of ROS has a single timestamp",
            ),
            (self.counts[SAMPLES].into(), "temperatures of IMU samples"),
        ];
        lost.into_iter().filter(|(count, _)| *count > 0).map(|(_, what)| what.to_owned()).collect()
    }
}
