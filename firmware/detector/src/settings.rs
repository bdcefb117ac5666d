//! What a device is set to.

use evcal_core::cluster::SensorSize;
use evcal_core::detector::DetectorSettings;
use evcal_core::window::WindowPolicy;

/// Settings of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Name and version of the firmware, for the user; what is beyond 32 bytes is not sent.
    pub device: &'static str,
    /// Size of the sensor in pixels.
    pub sensor: SensorSize,
    /// Which stretches of time are looked at.
    pub policy: WindowPolicy,
    /// Events to circles.
    pub detector: DetectorSettings<f32>,
    /// A window with at least this many circles counts as one with the board, and is sent.
    pub fewest_circles: u16,
}

impl Settings {
    /// Settings for a board of `circles` dots: a window is sent if it has at least five sixths as many circles.
    pub fn new(device: &'static str, sensor: SensorSize, circles: u16) -> Self {
        Self {
            device,
            sensor,
            policy: WindowPolicy::default(),
            detector: DetectorSettings::default(),
            fewest_circles: circles.saturating_sub(circles / 6),
        }
    }
}
