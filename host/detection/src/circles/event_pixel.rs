//! Pixel and polarity of an event in a window, without its time.

use evcal_core::event::{Event, Polarity};

/// Pixel and polarity of an event in four bytes: x and y in 15 bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EventPixel(u32);

impl EventPixel {
    /// The largest sensor coordinate that fits.
    pub const MAX_COORDINATE: u16 = 0x7fff;

    /// Returns the pixel and polarity of `event`; coordinates above [`Self::MAX_COORDINATE`], which no source passes on, are cut
    /// off.
    pub fn new(event: &Event) -> Self {
        let x = u32::from(event.x & Self::MAX_COORDINATE);
        let y = u32::from(event.y & Self::MAX_COORDINATE);
        Self(y << 16 | x << 1 | event.polarity.index() as u32)
    }

    /// Returns the column in pixels.
    pub fn x(self) -> u16 {
        (self.0 >> 1) as u16 & Self::MAX_COORDINATE
    }

    /// Returns the row in pixels.
    pub fn y(self) -> u16 {
        (self.0 >> 16) as u16
    }

    /// Returns the direction of the change.
    pub fn polarity(self) -> Polarity {
        if self.0 & 1 == 1 { Polarity::On } else { Polarity::Off }
    }
}
