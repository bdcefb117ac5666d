//! Settings of a device.

use evcal_core::budget::EventBudget;
use evcal_core::detector::DetectorSettings;
use evcal_core::filter::FilterSettings;
use evcal_core::sensor::Sensor;
use evcal_core::window::WindowSettings;

/// Settings of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Name and version of the firmware, for the user; only the first 32 bytes are sent.
    pub device: &'static str,
    /// Size of the sensor in pixels.
    pub sensor: Sensor,
    /// Filter applied to events first.
    pub filter: FilterSettings,
    /// Event rate that can be processed; events beyond it are shed.
    pub budget: EventBudget,
    /// Choice of the time windows to search.
    pub window: WindowSettings,
    /// Detection of circles.
    pub detector: DetectorSettings,
    /// A window with at least this many circles counts as one with the board, and is sent.
    pub fewest_circles: u16,
}

impl Settings {
    /// Settings for a board of `circles` dots.
    ///
    /// A window is searched once it has 40 events per dot, and sent if it has at least five sixths as many circles as
    /// the board. This means fewer searches than on a desktop, where time is cheap.
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
