//! Messages of the link.
//!
//! Bodies are only ever extended at their end, so an older receiver ignores the additional fields. A change that an
//! older receiver would misread requires a new kind.

use serde::{Deserialize, Serialize};

/// Version of the messages, sent in every [`Hello`].
pub const PROTOCOL_VERSION: u16 = 1;

/// Name of a device, at most 32 bytes.
pub type DeviceName = heapless::String<32>;

/// One message from the detector to the host.
///
/// The circles of a window are followed by its [`WindowEnd`]. [`Hello`] and [`Statistics`] are sent between windows.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// Description of the device. Kind 0.
    Hello(Hello),
    /// A circle of a window. Kind 1.
    Circle(Circle),
    /// All circles of a window have been sent. Kind 2.
    WindowEnd(WindowEnd),
    /// Counts since the device started; also shows that it is alive. Kind 3.
    Statistics(Statistics),
}

/// Description of the device and its settings. It is sent first, and again at least every second because a receiver may
/// join at any time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// [`PROTOCOL_VERSION`] of the sender.
    pub protocol: u16,
    /// `true` for the first message after the device started, when clock and counts begin at zero.
    pub first: bool,
    /// Time of the device's clock in microseconds.
    pub time_us: u64,
    /// Name and version of the firmware, for the user.
    pub device: DeviceName,
    /// Width of the sensor in pixels.
    pub sensor_width: u16,
    /// Height of the sensor in pixels.
    pub sensor_height: u16,
    /// Window policy: step τ in microseconds.
    pub step_us: u32,
    /// Window policy: length of the first window tried, in steps.
    pub min_interval: u16,
    /// Window policy: length of the longest window tried, in steps.
    pub max_interval: u16,
    /// Window policy: steps after a window with circles.
    pub gap: u16,
    /// Window policy: a window with this many events does not grow any further.
    pub most_events: u32,
    /// Window policy: a window with fewer events is not searched.
    pub fewest_events: u32,
    /// A window with fewer circles is not sent.
    pub fewest_circles: u16,
    /// Clusters: neighbourhood radius ε in pixels.
    pub epsilon: f32,
    /// Clusters: number of pixels within ε that makes a core pixel.
    pub min_points: u16,
    /// Clusters: smallest number of pixels.
    pub min_pixels: u16,
    /// Circles: smallest radius in pixels.
    pub min_radius: f32,
    /// Circles: largest radius in pixels.
    pub max_radius: f32,
    /// Filter: an event is dropped if it comes less than this many microseconds after another of its pixel; 0 when off.
    pub refractory_us: u32,
    /// Filter: an event is dropped if it has no neighbour within this many microseconds; 0 when off.
    pub background_us: u32,
    /// Filter: largest number of events of one pixel in a period of the hot-pixel filter; 0 when off.
    pub hot_events: u16,
    /// Capacity: events per window.
    pub capacity_events: u32,
    /// Capacity: runs of pixels per window.
    pub capacity_runs: u32,
    /// Capacity: clusters of one polarity, and circles, per window.
    pub capacity_clusters: u32,
}

/// A circle that was found in a window. The host assigns it to a dot of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Circle {
    /// Number of the window, counted from 0 since the device started.
    pub window: u32,
    /// Time of the centre, in microseconds of the device's clock.
    pub time_us: u64,
    /// Column of the centre in pixels; 0 is the centre of the leftmost pixel.
    pub x: f32,
    /// Row of the centre in pixels; 0 is the centre of the topmost pixel.
    pub y: f32,
    /// Radius in pixels.
    pub radius: f32,
    /// Mean distance of the pixels from the circle, in pixels.
    pub error: f32,
    /// Number of pixels with ON events of the circle, at the trailing edge of a dark dot.
    pub on_pixels: u16,
    /// Number of pixels with OFF events of the circle, at the leading edge of a dark dot.
    pub off_pixels: u16,
}

/// Message after all circles of a window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WindowEnd {
    /// Number of the window, counted from 0 since the device started.
    pub window: u32,
    /// First microsecond of the window.
    pub start_us: u64,
    /// Length of the window in microseconds.
    pub length_us: u32,
    /// Events in the window.
    pub events: u32,
    /// Clusters of both polarities.
    pub clusters: u16,
    /// Circles sent.
    pub circles: u16,
    /// Pixels that did not fit the detector's capacity.
    pub pixels_over_capacity: u32,
    /// Clusters that did not fit the detector's capacity.
    pub clusters_over_capacity: u32,
    /// Circles, or pairs of clusters, that did not fit the detector's capacity.
    pub circles_over_capacity: u32,
    /// Events lost since the previous window was sent.
    pub losses: Losses,
}

/// Events that were not part of any window, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Losses {
    /// Events outside the sensor, and words of the sensor's stream that produced no event.
    pub undecodable: u32,
    /// Events of hot pixels.
    pub hot: u32,
    /// Events without a neighbour.
    pub background: u32,
    /// Events too soon after the previous event of their pixel.
    pub refractory: u32,
    /// Events shed because their rate exceeded the budget.
    pub shed: u32,
    /// Events dropped because the window's storage was full.
    pub overflow: u32,
    /// Events in the gap between two windows.
    pub in_gap: u32,
}

/// Counts since the device started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Statistics {
    /// Time of the device's clock in microseconds.
    pub time_us: u64,
    /// Events received from the sensor.
    pub events: u64,
    /// Windows searched.
    pub windows: u32,
    /// Windows not searched because they had too few events.
    pub windows_too_few_events: u32,
    /// Windows sent.
    pub windows_sent: u32,
    /// Frames of the link that the device could not send because its output was full.
    pub frames_unsent: u32,
    /// Events older than the previous one.
    pub out_of_order: u32,
    /// Words of the sensor's stream that report lost events, if the format has such words.
    pub sensor_overflows: u32,
    /// Events that were not part of any window.
    pub losses: Losses,
}

impl Message {
    /// Returns the number of the message kind in its frame.
    pub(crate) const fn kind(&self) -> u8 {
        match self {
            Self::Hello(_) => 0,
            Self::Circle(_) => 1,
            Self::WindowEnd(_) => 2,
            Self::Statistics(_) => 3,
        }
    }

    /// Writes the body to the front of `buffer`; returns the number of bytes, or `None` if there is no room.
    pub(crate) fn write_body(&self, buffer: &mut [u8]) -> Option<usize> {
        let written = match self {
            Self::Hello(hello) => postcard::to_slice(hello, buffer),
            Self::Circle(circle) => postcard::to_slice(circle, buffer),
            Self::WindowEnd(end) => postcard::to_slice(end, buffer),
            Self::Statistics(statistics) => postcard::to_slice(statistics, buffer),
        };
        written.ok().map(|body| body.len())
    }

    /// Reads a body. Returns `Err` if the body is invalid for its kind; `Ok(None)` if the kind is unknown.
    pub(crate) fn read_body(kind: u8, body: &[u8]) -> postcard::Result<Option<Self>> {
        Ok(Some(match kind {
            0 => Self::Hello(postcard::from_bytes(body)?),
            1 => Self::Circle(postcard::from_bytes(body)?),
            2 => Self::WindowEnd(postcard::from_bytes(body)?),
            3 => Self::Statistics(postcard::from_bytes(body)?),
            _ => return Ok(None),
        }))
    }
}
