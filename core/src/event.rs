//! Events: a pixel reports that its brightness changed by more than its threshold.

/// The direction of a brightness change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Polarity {
    /// The pixel became darker.
    Off,
    /// The pixel became brighter.
    On,
}

impl Polarity {
    /// Returns the other polarity.
    pub const fn opposite(self) -> Self {
        match self {
            Self::Off => Self::On,
            Self::On => Self::Off,
        }
    }

    /// Returns 0 for [`Polarity::Off`] and 1 for [`Polarity::On`], an index into tables by polarity.
    #[inline]
    pub const fn index(self) -> usize {
        match self {
            Self::Off => 0,
            Self::On => 1,
        }
    }
}

/// One event of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// Time in microseconds, monotonic within a source.
    pub t: i64,
    /// Column in pixels, 0 at the left.
    pub x: u16,
    /// Row in pixels, 0 at the top.
    pub y: u16,
    /// Direction of the change.
    pub polarity: Polarity,
}
