//! State of the camera as its events show it. Each module measures one figure, over a few recent seconds.

pub mod flicker;
pub mod focus;
pub mod hot_pixels;
pub mod noise;
pub mod rates;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

use self::flicker::RecentFlicker;
use self::focus::{Focus, FocusMeter};
use self::hot_pixels::HotPixels;
use self::noise::NoiseMeter;
use self::rates::{RateMeter, Rates};
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::diagnosis::flicker::Flicker;

/// The figures; `None` until there are enough events.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Health {
    /// Event rates.
    pub rates: Option<Rates>,
    /// Events per second of a pixel without motion in front of it.
    pub noise: Option<f64>,
    /// Number of hot pixels.
    pub hot_pixels: Option<usize>,
    /// Flicker of the light; `None` until it is known, `Some(None)` if the light does not flicker.
    pub flicker: Option<Option<Flicker>>,
    /// Sharpness of the circles.
    pub focus: Option<Focus>,
}

/// Computes the figures from all events as they arrive.
#[derive(Clone, Debug)]
pub struct HealthMonitor {
    rates: RateMeter,
    noise: NoiseMeter,
    hot_pixels: HotPixels,
    flicker: RecentFlicker,
    focus: FocusMeter,
}

impl HealthMonitor {
    /// Creates a monitor for this sensor.
    pub fn new(sensor: Sensor) -> Self {
        Self {
            rates: RateMeter::new(sensor),
            noise: NoiseMeter::new(sensor),
            hot_pixels: HotPixels::new(sensor),
            flicker: RecentFlicker::default(),
            focus: FocusMeter::default(),
        }
    }

    /// Adds the next events, in order of time (µs since the first).
    pub fn push(&mut self, events: &[Event]) {
        self.rates.push(events);
        self.noise.push(events);
        self.hot_pixels.push(events);
        self.flicker.push(events);
    }

    /// Adds a window with the board.
    pub fn see(&mut self, frame: &ReferenceFrame) {
        self.focus.see(frame);
    }

    /// Returns the current figures.
    pub fn health(&self) -> Health {
        Health {
            rates: self.rates.rates(),
            noise: self.noise.rate(),
            hot_pixels: self.hot_pixels.count(),
            flicker: self.flicker.flicker(),
            focus: self.focus.focus(),
        }
    }
}
