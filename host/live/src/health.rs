//! How the camera does: what its events tell beside the board. One stage a figure, each of a few last seconds.

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
use evcal_calibrate::circles::reference_frame::ReferenceFrame;
use evcal_calibrate::diagnosis::flicker::Flicker;

/// The figures; `None` until there is enough to tell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Health {
    /// How many events there are.
    pub rates: Option<Rates>,
    /// Events a second of a pixel before which nothing moves.
    pub noise: Option<f64>,
    /// Pixels that fire on their own.
    pub hot_pixels: Option<u32>,
    /// Whether the light flickers; the outer `None` until it is known.
    pub flicker: Option<Option<Flicker>>,
    /// How sharp the circles are.
    pub focus: Option<Focus>,
}

/// Looks at all events as they come.
#[derive(Clone, Debug)]
pub struct HealthMonitor {
    rates: RateMeter,
    noise: NoiseMeter,
    hot_pixels: HotPixels,
    flicker: RecentFlicker,
    focus: FocusMeter,
}

impl HealthMonitor {
    /// Nothing seen yet by this sensor.
    pub fn new(sensor: Sensor) -> Self {
        Self {
            rates: RateMeter::new(sensor),
            noise: NoiseMeter::new(sensor),
            hot_pixels: HotPixels::new(sensor),
            flicker: RecentFlicker::default(),
            focus: FocusMeter::default(),
        }
    }

    /// Takes the next events, in order of time (µs since the first).
    pub fn push(&mut self, events: &[Event]) {
        self.rates.push(events);
        self.noise.push(events);
        self.hot_pixels.push(events);
        self.flicker.push(events);
    }

    /// Takes a window with the board.
    pub fn see(&mut self, frame: &ReferenceFrame) {
        self.focus.see(frame);
    }

    /// The figures now.
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
