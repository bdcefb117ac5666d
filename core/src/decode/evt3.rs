//! Prophesee EVT 3.0 (<https://docs.prophesee.ai/stable/data/encoding_formats/evt3.html>).
//!
//! Words of 16 bits, each of which changes the decoder's state; bits 15–12 are the type:
//!
//! | type | word | bits |
//! |---|---|---|
//! | 0x0 | row | 10–0 row (11: first or second camera) |
//! | 0x1 | row of data other than events | |
//! | 0x2 | event at this column | 11 polarity, 10–0 column |
//! | 0x3 | first column of a group | 11 polarity, 10–0 column |
//! | 0x4, 0x5 | events of the group | 11–0 or 7–0: bit n for column n; the group continues after these columns |
//! | 0x6 | time low | 11–0 microseconds |
//! | 0x8 | time high | 11–0 microseconds / 4096 |
//! | 0xA | trigger | 11–8 channel, 0 value |
//! | 0x7, 0xD, 0xE, 0xF | continued, IMU, other, continued | vendor specific |
//!
//! A time is time high × 4096 + time low in microseconds; it wraps after 2²⁴ µs (16.8 s). A new time high sets time
//! low to zero. A time low that falls by more than half of its range without a time high between has wrapped: some
//! writers give a single time high.

use super::evt::{EvtClock, EvtCounts, EvtRecords, Trigger};
use crate::event::{Event, Polarity};

const LOW_MASK: u16 = 0xfff;
/// Half of the range of time low.
const HALF_RANGE: u16 = 1 << 11;
const COORDINATE: u16 = 0x7ff;
const POLARITY: u16 = 0x800;

/// Decodes words to events and triggers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt3Decoder {
    /// A jump is more than 244 × 4096 µs ≈ 1 s.
    clock: EvtClock<12, 12, 244>,
    /// Time low; 0 before the first one.
    low: u16,
    /// `true` if no time high came after the latest time low.
    has_low: bool,
    /// `None` before the first row, and in rows of other data.
    row: Option<u16>,
    /// First column of the next word of a group.
    column: u16,
    /// `true` if the group consists of ON events.
    on: bool,
}

impl Evt3Decoder {
    /// Creates a decoder for the beginning of a stream, or any position in it.
    pub const fn new() -> Self {
        Self { clock: EvtClock::new(), low: 0, has_low: false, row: None, column: 0, on: false }
    }

    /// Decodes the next word; returns its events or its trigger.
    #[inline]
    pub fn push(&mut self, word: u16) -> EvtRecords {
        let count = match word >> 12 {
            0x0 => {
                self.row = Some(word & COORDINATE);
                return EvtRecords::none();
            }
            0x1 => {
                self.row = None;
                return EvtRecords::none();
            }
            0x2 => return self.events(word & COORDINATE, word & POLARITY != 0, 1),
            0x3 => {
                (self.column, self.on) = (word & COORDINATE, word & POLARITY != 0);
                return EvtRecords::none();
            }
            0x4 => return self.group(word & 0xfff, 12),
            0x5 => return self.group(word & 0xff, 8),
            0x6 => {
                let low = word & LOW_MASK;
                if self.has_low && self.low > low + HALF_RANGE {
                    self.clock.step();
                }
                (self.low, self.has_low) = (low, true);
                return EvtRecords::none();
            }
            0x8 => {
                if self.clock.set_high(u32::from(word)) {
                    self.low = 0;
                }
                self.has_low = false;
                return EvtRecords::none();
            }
            0xa => {
                let (channel, rising) = ((word >> 8) as u8 & 15, word & 1 == 1);
                let trigger = |t| EvtRecords::trigger(Trigger { t, channel, rising });
                return self.time().map_or(EvtRecords::none(), trigger);
            }
            0x7 | 0xd | 0xe | 0xf => &mut self.clock.counts.vendor,
            _ => &mut self.clock.counts.unknown,
        };
        *count = count.saturating_add(1);
        EvtRecords::none()
    }

    /// Returns the counts so far.
    pub const fn counts(&self) -> &EvtCounts {
        &self.clock.counts
    }

    fn group(&mut self, mask: u16, columns: u16) -> EvtRecords {
        let first = self.column;
        self.column = first.saturating_add(columns);
        self.events(first, self.on, mask)
    }

    fn events(&mut self, x: u16, on: bool, mask: u16) -> EvtRecords {
        let Some(y) = self.row else {
            self.clock.counts.without_row = self.clock.counts.without_row.saturating_add(1);
            return EvtRecords::none();
        };
        let polarity = if on { Polarity::On } else { Polarity::Off };
        self.time().map_or(EvtRecords::none(), |t| EvtRecords::events(Event { t, x, y, polarity }, u32::from(mask)))
    }

    fn time(&mut self) -> Option<i64> {
        self.clock.time(u32::from(self.low))
    }
}
