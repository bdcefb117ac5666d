//! A checksum of events, for comparing the events that two programs received.

use std::fmt;

/// Checksum of events that depends on their order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Checksum {
    count: u64,
    sum: u64,
}

impl Checksum {
    /// Adds an event.
    pub fn add(&mut self, time: u64, x: u16, y: u16, on: bool) {
        let event = time << 20 ^ u64::from(x) << 10 ^ u64::from(y) << 1 ^ u64::from(on);
        self.count += 1;
        self.sum = self.sum.wrapping_mul(0x100_0000_01B3).wrapping_add(event);
    }

    /// Returns the number of events added.
    pub fn count(&self) -> u64 {
        self.count
    }
}

impl fmt::Display for Checksum {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} {:016x}", self.count, self.sum)
    }
}
