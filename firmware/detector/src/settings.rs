//! What a device is set to.

use evcal_core::budget::EventBudget;
use evcal_core::detector::DetectorSettings;
use evcal_core::filter::FilterSettings;
use evcal_core::sensor::Sensor;
use evcal_core::window::WindowSettings;

/// Settings of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Name and version of the firmware, for the user; what is beyond 32 bytes is not sent.
    pub device: &'static str,
    /// Size of the sensor in pixels.
    pub sensor: Sensor,
    /// Which events are dropped before anything else looks at them.
    pub filter: FilterSettings,
    /// How many events can be worked on; what comes beyond is shed.
    pub budget: EventBudget,
    /// Which stretches of time are looked at.
    pub window: WindowSettings,
    /// Events to circles.
    pub detector: DetectorSettings,
    /// A window with at least this many circles counts as one with the board, and is sent.
    pub fewest_circles: u16,
}

impl Settings {
    /// Settings for a board of `circles` dots.
    ///
    /// A window is tried once it has 40 events for each dot, and sent if it has five sixths as many circles as
    /// the board: fewer tries than on a desktop, where time is cheap.
    pub fn new(device: &'static str, sensor: Sensor, circles: u16) -> Self {
        Self {
            device,
            sensor,
            filter: FilterSettings::default(),
            budget: EventBudget::default(),
            window: WindowSettings { gap: 5, fewest_events: u32::from(circles) * 40, ..WindowSettings::default() },
            detector: DetectorSettings::default(),
            fewest_circles: circles.saturating_sub(circles / 6),
        }
    }
}
