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
//!
//! A sensor repeats time high all the time, so it never leaps. A leap is a word that was damaged on its way
//! (unless the next time high confirms it); followed at once, a single one would put the rest of the
//! stream in the wrong hour.

use super::DoesNotFit;
use crate::event::{Event, Polarity};

const HIGH_MASK: u32 = (1 << 28) - 1;
/// A time high that is further ahead of the one before than this (2¹⁴ × 64 µs ≈ 1 s) is not believed at once.
const LEAP: u32 = 1 << 14;
const HALF_RANGE: u32 = 1 << 27;
const MAX_COORDINATE: u16 = 2047;

/// An edge at one of the sensor's trigger inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trigger {
    /// Time in microseconds, on the clock of the events.
    pub t: i64,
    /// Number of the input, 0 to 31.
    pub channel: u8,
    /// True for a rising edge.
    pub rising: bool,
}

/// What a word can say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Evt2Record {
    /// An event of a pixel.
    Event(Event),
    /// An edge at a trigger input.
    Trigger(Trigger),
}

/// What a decoder of EVT 2.0 met so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt2Counts {
    /// Events and triggers left out because their time is not known: before the first time high, or
    /// after one that leaps and is not confirmed.
    pub without_time: u32,
    /// Leaps of time high that the next one did not confirm: damaged words.
    pub false_leaps: u32,
    /// Leaps ahead: words were lost, for more than a second.
    pub leaps: u32,
    /// Times the clock was set back.
    pub clock_resets: u32,
    /// Vendor-specific words, passed over.
    pub vendor: u32,
    /// Words of a type that the format does not have: not EVT 2.0, or damaged.
    pub unknown: u32,
}

/// How far time high can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Trust {
    /// None came yet.
    Nothing,
    /// It goes on as it should.
    Steady,
    /// It leapt to this value, and nothing confirms it yet.
    Leapt(u32),
}

/// Words to events and triggers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Evt2Decoder {
    trust: Trust,
    /// Last time high believed.
    high: u32,
    /// Its time, extended to 64 bits, in microseconds.
    base_us: i64,
    counts: Evt2Counts,
}

impl Evt2Decoder {
    /// At the beginning of a stream, or anywhere in it.
    pub const fn new() -> Self {
        let counts = Evt2Counts { without_time: 0, false_leaps: 0, leaps: 0, clock_resets: 0, vendor: 0, unknown: 0 };
        Self { trust: Trust::Nothing, high: 0, base_us: 0, counts }
    }

    /// Takes the next word; `None` if it is neither event nor trigger.
    #[inline]
    pub fn push(&mut self, word: u32) -> Option<Evt2Record> {
        let count = match word >> 28 {
            0x0 | 0x1 => {
                let polarity = if word >> 28 == 1 { Polarity::On } else { Polarity::Off };
                let (x, y) = ((word >> 11) as u16 & MAX_COORDINATE, word as u16 & MAX_COORDINATE);
                return self.time(word).map(|t| Evt2Record::Event(Event { t, x, y, polarity }));
            }
            0x8 => {
                self.set_high(word & HIGH_MASK);
                return None;
            }
            0xa => {
                let (channel, rising) = ((word >> 8) as u8 & 31, word & 1 == 1);
                return self.time(word).map(|t| Evt2Record::Trigger(Trigger { t, channel, rising }));
            }
            0xe | 0xf => &mut self.counts.vendor,
            _ => &mut self.counts.unknown,
        };
        *count = count.saturating_add(1);
        None
    }

    /// What was met so far.
    pub const fn counts(&self) -> &Evt2Counts {
        &self.counts
    }

    /// The time of a word with time low.
    fn time(&mut self, word: u32) -> Option<i64> {
        if self.trust != Trust::Steady {
            self.counts.without_time = self.counts.without_time.saturating_add(1);
            return None;
        }
        Some(self.base_us.saturating_add(i64::from((word >> 22) & 63)))
    }

    fn set_high(&mut self, high: u32) {
        let follows = |before: u32| high.wrapping_sub(before) & HIGH_MASK <= LEAP;
        match self.trust {
            Trust::Nothing => self.base_us = i64::from(high) << 6,
            _ if follows(self.high) => {
                if self.trust != Trust::Steady {
                    self.counts.false_leaps = self.counts.false_leaps.saturating_add(1);
                }
                self.advance(high);
            }
            Trust::Leapt(leapt) if follows(leapt) => {
                let count = if high.wrapping_sub(self.high) & HIGH_MASK < HALF_RANGE {
                    self.advance(high);
                    &mut self.counts.leaps
                } else {
                    // Beyond all times given out before the reset.
                    self.base_us = self.base_us.saturating_add(64);
                    &mut self.counts.clock_resets
                };
                *count = count.saturating_add(1);
            }
            Trust::Leapt(_) => {
                self.counts.false_leaps = self.counts.false_leaps.saturating_add(1);
                self.trust = Trust::Leapt(high);
                return;
            }
            Trust::Steady => {
                self.trust = Trust::Leapt(high);
                return;
            }
        }
        self.high = high;
        self.trust = Trust::Steady;
    }

    fn advance(&mut self, high: u32) {
        let elapsed = high.wrapping_sub(self.high) & HIGH_MASK;
        self.base_us = self.base_us.saturating_add(i64::from(elapsed) << 6);
    }
}

impl Default for Evt2Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// The one or two words of an event.
pub type Evt2Words = heapless::Vec<u32, 2>;

/// Events to words, with a time high only where it changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt2Encoder {
    high: Option<u32>,
}

impl Evt2Encoder {
    /// At the beginning of a stream.
    pub const fn new() -> Self {
        Self { high: None }
    }

    /// The words of the next event. Of its time the low 34 bits are kept.
    ///
    /// After a second without events [`time`](Self::time) must be called, as a sensor does all the time: a
    /// decoder takes the leap for damage.
    ///
    /// # Errors
    /// If its column or row is beyond 2047.
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

    /// The time high of `time_us`, if it is not the one sent last.
    pub fn time(&mut self, time_us: i64) -> Option<u32> {
        let high = (time_us >> 6) as u32 & HIGH_MASK;
        (self.high.replace(high) != Some(high)).then_some(0x8 << 28 | high)
    }
}
