//! Decoded messages, which are also the input of the encoder.
//!
//! Times are µs since the camera's latest timestamp reset, 64 bits.

use super::{Anomaly, ImuSample};

/// The direction of a change of brightness.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Polarity {
    /// The pixel became darker.
    Off,
    /// The pixel became brighter.
    On,
}

/// An event: a pixel detected a change of brightness.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PolarityEvent {
    /// Time in µs.
    pub time: u64,
    /// Column, 0 at the left.
    pub x: u16,
    /// Row, 0 at the top.
    pub y: u16,
    /// Direction of the change.
    pub polarity: Polarity,
}

/// Kind of signal at a synchronisation connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// The external input rose.
    ExternalInputRising,
    /// The external input fell.
    ExternalInputFalling,
    /// The external input pulsed.
    ExternalInputPulse,
    /// The camera's own generator rose.
    GeneratorRising,
    /// The camera's own generator fell.
    GeneratorFalling,
}

/// A signal with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignalEvent {
    /// Time in µs.
    pub time: u64,
    /// Kind of signal.
    pub signal: Signal,
}

/// Exposure method of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shutter {
    /// All pixels at once.
    Global,
    /// Column by column.
    Rolling,
}

/// A rectangle of pixels in user coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub x: u16,
    /// First row.
    pub y: u16,
    /// Columns, at least 1.
    pub width: u16,
    /// Rows, at least 1.
    pub height: u16,
}

/// A picture: reset level − signal level of each pixel (correlated double sampling).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Exposure method.
    pub shutter: Shutter,
    /// Time of the frame's first word in µs.
    pub start: u64,
    /// Time of the frame's last word in µs.
    pub end: u64,
    /// Time of the beginning of the exposure in µs, unless that word was lost.
    pub exposure_start: Option<u64>,
    /// Time of the end of the exposure in µs, unless that word was lost.
    pub exposure_end: Option<u64>,
    /// The exposure time that was configured, in cycles of the ADC clock.
    pub exposure_cycles: u32,
    /// Region of the sensor.
    pub region: Region,
    /// Number of wire columns (rows of the picture if the axes are swapped) with missing samples. The missing pixels
    /// are 0.
    pub damaged_columns: u16,
    /// `region.width × region.height` pixels row by row, 0 dark to 1023 saturated.
    pub pixels: &'a [u16],
}

impl Frame<'_> {
    /// Returns the middle of the exposure in µs, the timestamp of the picture.
    pub fn exposure_middle(&self) -> Option<u64> {
        let (start, end) = (self.exposure_start?, self.exposure_end?);
        Some(start.min(end) + start.abs_diff(end) / 2)
    }
}

/// A decoded item of the stream.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Message<'a> {
    /// Pixel events, in order. Their number depends on how the stream was split.
    Events(&'a [PolarityEvent]),
    /// A signal at a connector.
    Signal(SignalEvent),
    /// The camera's clock restarted at zero; it had reached `previous` µs.
    TimestampReset {
        /// Last time before the reset in µs.
        previous: u64,
    },
    /// An IMU sample.
    Imu(ImuSample),
    /// A picture.
    Frame(Frame<'a>),
    /// A fault, which has been counted and handled.
    Anomaly(Anomaly),
}
