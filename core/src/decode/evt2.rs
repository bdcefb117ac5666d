//! Prophesee EVT 2.0 (<https://docs.prophesee.ai/stable/data/encoding_formats/evt2.html>).
//!
//! Bits 31–28 of a word are its type:
//!
//! | type | word | bits |
//! |---|---|---|
//! | 0x0, 0x1 | event, OFF or ON | 27–22 time low, 21–11 column, 10–0 row |
//! | 0x8 | time high | 27–0 microseconds / 64 |
//! | 0xA | trigger | 27–22 time low, 12–8 channel, 0 value |
//! | 0xE, 0xF | other, continued | vendor specific |
//!
//! A time is time high × 64 + time low in microseconds; it wraps after 2³⁴ µs (4.8 hours).

use super::DoesNotFit;
use super::evt::{EvtClock, EvtCounts, EvtRecord, Trigger};
use crate::event::{Event, Polarity};

const HIGH_MASK: u32 = (1 << 28) - 1;
const MAX_COORDINATE: u16 = 2047;

/// Decodes words to events and triggers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt2Decoder {
    /// A jump is more than 2¹⁴ × 64 µs ≈ 1 s.
    clock: EvtClock<28, 6, { 1 << 14 }>,
}

impl Evt2Decoder {
    /// Creates a decoder for the beginning of a stream, or any position in it.
    pub const fn new() -> Self {
        Self { clock: EvtClock::new() }
    }

    /// Decodes the next word; returns `None` if it is neither an event nor a trigger.
    #[inline]
    pub fn push(&mut self, word: u32) -> Option<EvtRecord> {
        let count = match word >> 28 {
            0x0 | 0x1 => {
                let polarity = if word >> 28 == 1 { Polarity::On } else { Polarity::Off };
                let (x, y) = ((word >> 11) as u16 & MAX_COORDINATE, word as u16 & MAX_COORDINATE);
                return self.time(word).map(|t| EvtRecord::Event(Event { t, x, y, polarity }));
            }
            0x8 => {
                self.clock.set_high(word);
                return None;
            }
            0xa => {
                let (channel, rising) = ((word >> 8) as u8 & 31, word & 1 == 1);
                return self.time(word).map(|t| EvtRecord::Trigger(Trigger { t, channel, rising }));
            }
            0xe | 0xf => &mut self.clock.counts.vendor,
            _ => &mut self.clock.counts.unknown,
        };
        *count = count.saturating_add(1);
        None
    }

    /// Returns the counts so far.
    pub const fn counts(&self) -> &EvtCounts {
        &self.clock.counts
    }

    /// Returns the time of a word with time low.
    fn time(&mut self, word: u32) -> Option<i64> {
        self.clock.time((word >> 22) & 63)
    }
}

/// The one or two words of an event.
pub type Evt2Words = heapless::Vec<u32, 2>;

/// Encodes events to words; writes a time high only when it changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt2Encoder {
    high: Option<u32>,
}

impl Evt2Encoder {
    /// Creates an encoder for the beginning of a stream.
    pub const fn new() -> Self {
        Self { high: None }
    }

    /// Returns the words of the next event. The time is truncated to its low 34 bits.
    ///
    /// After a second without events call [`time`](Self::time), as a sensor does continuously; otherwise a decoder
    /// takes the jump for damage.
    ///
    /// # Errors
    /// Returns an error if the column or row is beyond 2047.
    pub fn encode(&mut self, event: Event) -> Result<Evt2Words, DoesNotFit> {
        if event.x > MAX_COORDINATE || event.y > MAX_COORDINATE {
            return Err(DoesNotFit);
        }
        let mut words = Evt2Words::new();
        let word = self.time(event.t);
        if let Some(word) = word {
            words.push(word).map_err(|_| DoesNotFit)?;
        }
        let low = (event.t as u32 & 63) << 22;
        let kind = (event.polarity.index() as u32) << 28;
        words.push(kind | low | (u32::from(event.x) << 11) | u32::from(event.y)).map_err(|_| DoesNotFit)?;
        Ok(words)
    }

    /// Returns the time high of `time_us`, if it differs from the last one.
    pub fn time(&mut self, time_us: i64) -> Option<u32> {
        let high = (time_us >> 6) as u32 & HIGH_MASK;
        (self.high.replace(high) != Some(high)).then_some(0x8 << 28 | high)
    }
}
