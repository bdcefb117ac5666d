//! The size of a sensor.

use core::fmt;

/// A sensor's number of columns and rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Sensor {
    /// Columns in pixels.
    pub width: u16,
    /// Rows in pixels.
    pub height: u16,
}

impl Sensor {
    /// Largest number of columns or rows of a sensor.
    pub const MOST_PIXELS_A_SIDE: u16 = 32_767;

    /// Creates a sensor of `width` columns and `height` rows.
    pub const fn new(width: u16, height: u16) -> Self {
        Self { width, height }
    }

    /// Returns the number of pixels.
    pub const fn pixel_count(self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Returns `true` if the sensor has a pixel in column `x` and row `y`.
    pub const fn contains(self, x: u16, y: u16) -> bool {
        x < self.width && y < self.height
    }
}

/// Formats the sensor as `WIDTH x HEIGHT` for messages.
impl fmt::Display for Sensor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} x {}", self.width, self.height)
    }
}

/// Converts from (columns, rows).
impl From<(u16, u16)> for Sensor {
    fn from((width, height): (u16, u16)) -> Self {
        Self { width, height }
    }
}
