//! evcal's packed records: one 32-bit word per event.
//!
//! | bits | event (bit 31 is 0) |
//! |---|---|
//! | 30–22 | microseconds since the last time word, 0 to 511 |
//! | 21 | polarity: 1 is ON |
//! | 20–10 | column, 0 to 2047 |
//! | 9–0 | row, 0 to 1023 |
//!
//! | bits | time word (bit 31 is 1) |
//! |---|---|
//! | 30–0 | low 31 bits of a time in microseconds |
//!
//! The stream begins with a time word; further time words follow whenever 511 µs do not suffice. A time word that is
//! less than 2³⁰ µs (18 minutes) after the previous one, modulo 2³¹, is later; any other indicates that the clock was
//! reset.

use super::DoesNotFit;
use crate::event::{Event, Polarity};

const TIME_WORD: u32 = 1 << 31;
const TIME_MASK: u32 = TIME_WORD - 1;
/// A larger difference between two time words is a step back.
const HALF_RANGE: u32 = 1 << 30;
const LONGEST_OFFSET: u32 = 511;
const MAX_X: u16 = 2047;
const MAX_Y: u16 = 1023;

/// Counts of the irregularities that a decoder of packed records met.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PackedCounts {
    /// Events before the first time word: they have no time and are dropped.
    pub before_time: u32,
    /// Number of times the clock was reset.
    pub clock_resets: u32,
}

/// Decodes words to events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PackedDecoder {
    /// Time of the last time word, and the word itself; `None` before the first.
    base: Option<(i64, u32)>,
    /// Time of the last event.
    last_us: i64,
    counts: PackedCounts,
}

impl PackedDecoder {
    /// Creates a decoder for the beginning of a stream.
    pub const fn new() -> Self {
        Self { base: None, last_us: 0, counts: PackedCounts { before_time: 0, clock_resets: 0 } }
    }

    /// Decodes the next word; returns `None` if it is not an event.
    #[inline]
    pub fn push(&mut self, word: u32) -> Option<Event> {
        if word & TIME_WORD != 0 {
            self.set_time(word & TIME_MASK);
            return None;
        }
        let Some((base_us, _)) = self.base else {
            self.counts.before_time = self.counts.before_time.saturating_add(1);
            return None;
        };
        self.last_us = base_us.saturating_add(i64::from(word >> 22));
        Some(Event {
            t: self.last_us,
            x: (word >> 10) as u16 & MAX_X,
            y: word as u16 & MAX_Y,
            polarity: if word & (1 << 21) != 0 { Polarity::On } else { Polarity::Off },
        })
    }

    /// Returns the counts so far.
    pub const fn counts(&self) -> &PackedCounts {
        &self.counts
    }

    fn set_time(&mut self, low: u32) {
        let base_us = match self.base {
            None => i64::from(low),
            Some((base_us, before)) => {
                let elapsed = low.wrapping_sub(before) & TIME_MASK;
                if elapsed < HALF_RANGE {
                    base_us.saturating_add(i64::from(elapsed))
                } else {
                    self.counts.clock_resets = self.counts.clock_resets.saturating_add(1);
                    base_us.max(self.last_us)
                }
            }
        };
        self.base = Some((base_us, low));
    }
}

/// The one or two words of an event.
pub type PackedWords = heapless::Vec<u32, 2>;

/// Encodes events to words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PackedEncoder {
    base_us: Option<i64>,
}

impl PackedEncoder {
    /// Creates an encoder for the beginning of a stream.
    pub const fn new() -> Self {
        Self { base_us: None }
    }

    /// Returns the words of the next event.
    ///
    /// # Errors
    /// Returns an error if the column is beyond 2047 or the row beyond 1023.
    pub fn encode(&mut self, event: Event) -> Result<PackedWords, DoesNotFit> {
        if event.x > MAX_X || event.y > MAX_Y {
            return Err(DoesNotFit);
        }
        let mut words = PackedWords::new();
        let offset = self.base_us.and_then(|base_us| u32::try_from(event.t.checked_sub(base_us)?).ok());
        let offset = match offset {
            Some(offset) if offset <= LONGEST_OFFSET => offset,
            _ => {
                self.base_us = Some(event.t);
                words.push(TIME_WORD | (event.t as u32 & TIME_MASK)).map_err(|_| DoesNotFit)?;
                0
            }
        };
        let polarity = (event.polarity.index() as u32) << 21;
        let word = (offset << 22) | polarity | (u32::from(event.x) << 10) | u32::from(event.y);
        words.push(word).map_err(|_| DoesNotFit)?;
        Ok(words)
    }
}
