//! Common parts of Prophesee's formats: triggers, records, and a clock whose upper bits arrive in separate words (*time
//! high*).
//!
//! A sensor repeats time high continuously, so time high never jumps. A jump indicates a damaged word, unless the next
//! time high confirms the new value. Following a jump at once would shift the times of the rest of the stream because
//! of a single damaged word. Small backward steps are normal and are followed.

use crate::event::Event;

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

/// The content of a decoded word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EvtRecord {
    /// An event of a pixel.
    Event(Event),
    /// An edge at a trigger input.
    Trigger(Trigger),
}

/// The content of one word: a trigger, or events of neighbouring pixels of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EvtRecords {
    trigger: Option<Trigger>,
    /// The event of the first pixel.
    event: Event,
    /// Bit n is set if the pixel n columns to the right of `event` has an event.
    mask: u32,
}

impl EvtRecords {
    const EMPTY_EVENT: Event = Event { t: 0, x: 0, y: 0, polarity: crate::event::Polarity::Off };

    /// Returns records without content.
    pub(super) const fn none() -> Self {
        Self { trigger: None, event: Self::EMPTY_EVENT, mask: 0 }
    }

    pub(super) const fn trigger(trigger: Trigger) -> Self {
        Self { trigger: Some(trigger), event: Self::EMPTY_EVENT, mask: 0 }
    }

    pub(super) const fn events(event: Event, mask: u32) -> Self {
        Self { trigger: None, event, mask }
    }
}

impl Iterator for EvtRecords {
    type Item = EvtRecord;

    #[inline]
    fn next(&mut self) -> Option<EvtRecord> {
        if let Some(trigger) = self.trigger.take() {
            return Some(EvtRecord::Trigger(trigger));
        }
        if self.mask == 0 {
            return None;
        }
        let column = self.mask.trailing_zeros() as u16;
        self.mask &= self.mask.wrapping_sub(1);
        Some(EvtRecord::Event(Event { x: self.event.x.saturating_add(column), ..self.event }))
    }
}

/// Counts of the irregularities that a decoder met.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EvtCounts {
    /// Words of events and triggers dropped because their time is not known: before the first time high, or after a
    /// time high that jumped and is not confirmed.
    pub without_time: u32,
    /// Words of events dropped because no row came before them.
    pub without_row: u32,
    /// Jumps of time high that the next time high did not confirm: damaged words.
    pub false_leaps: u32,
    /// Confirmed forward jumps: words of more than a second were lost.
    pub leaps: u32,
    /// Number of times the clock was reset.
    pub clock_resets: u32,
    /// Vendor-specific words, skipped.
    pub vendor: u32,
    /// Words of a type that the format does not define: another format, or damaged.
    pub unknown: u32,
}

/// State of the time high.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Trust {
    /// No time high was received yet.
    #[default]
    Nothing,
    /// Time high advances as it should.
    Steady,
    /// Time high jumped to this value, which is not confirmed yet.
    Leapt(u32),
}

/// Computes times from a time high of `BITS` bits in units of 2^`SHIFT` µs, and a time low. A time high that is more
/// than `LEAP` ahead of the previous one must be confirmed by the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct EvtClock<const BITS: u32, const SHIFT: u32, const LEAP: u32> {
    trust: Trust,
    /// Last accepted time high.
    high: u32,
    /// Its time, extended to 64 bits, in microseconds.
    base_us: i64,
    /// Difference between the latest time and `base_us`, in microseconds.
    behind_us: u32,
    pub(super) counts: EvtCounts,
}

/// Longest backward step of a sensor, in microseconds: ten time highs of EVT 3.0, the tolerance of event_camera_codecs.
const MOST_BACK_US: u32 = 10 << 12;

impl<const BITS: u32, const SHIFT: u32, const LEAP: u32> EvtClock<BITS, SHIFT, LEAP> {
    const MASK: u32 = (1 << BITS) - 1;
    const MOST_BACK: u32 = MOST_BACK_US >> SHIFT;
    const HALF_RANGE: u32 = 1 << (BITS - 1);

    pub(super) const fn new() -> Self {
        let counts = EvtCounts {
            without_time: 0,
            without_row: 0,
            false_leaps: 0,
            leaps: 0,
            clock_resets: 0,
            vendor: 0,
            unknown: 0,
        };
        Self { trust: Trust::Nothing, high: 0, base_us: 0, behind_us: 0, counts }
    }

    /// Returns the time `low` µs after time high; `None` if time high is not known or not confirmed.
    #[inline]
    pub(super) fn time(&mut self, low: u32) -> Option<i64> {
        if self.trust != Trust::Steady {
            self.counts.without_time = self.counts.without_time.saturating_add(1);
            return None;
        }
        Some(self.base_us.saturating_add(i64::from(low)))
    }

    /// Accepts the time high in the lowest bits of `word`; returns `true` if the state changed.
    pub(super) fn set_high(&mut self, word: u32) -> bool {
        let high = word & Self::MASK;
        let before = (self.trust, self.high);
        let follows = |before: u32| high.wrapping_sub(before) & Self::MASK <= LEAP;
        let back = self.high.wrapping_sub(high) & Self::MASK;
        let steps_back = back <= Self::MOST_BACK && self.behind_us + (back << SHIFT) <= MOST_BACK_US;
        match self.trust {
            Trust::Nothing => self.base_us = i64::from(high) << SHIFT,
            _ if follows(self.high) || steps_back => {
                if self.trust != Trust::Steady {
                    self.counts.false_leaps = self.counts.false_leaps.saturating_add(1);
                }
                if follows(self.high) {
                    self.advance(high);
                } else {
                    self.base_us = self.base_us.saturating_sub(i64::from(back) << SHIFT);
                    self.behind_us += back << SHIFT;
                }
            }
            Trust::Leapt(leapt) if follows(leapt) => {
                let count = if high.wrapping_sub(self.high) & Self::MASK < Self::HALF_RANGE {
                    self.advance(high);
                    &mut self.counts.leaps
                } else {
                    // The new times follow all times that were returned before the reset.
                    self.base_us = self.base_us.saturating_add(i64::from(self.behind_us) + (1 << SHIFT));
                    self.behind_us = 0;
                    &mut self.counts.clock_resets
                };
                *count = count.saturating_add(1);
            }
            Trust::Leapt(_) => {
                self.counts.false_leaps = self.counts.false_leaps.saturating_add(1);
                self.trust = Trust::Leapt(high);
                return true;
            }
            Trust::Steady => {
                self.trust = Trust::Leapt(high);
                return true;
            }
        }
        self.high = high;
        self.trust = Trust::Steady;
        before != (self.trust, self.high)
    }

    /// Advances time high by one, because time low wrapped.
    pub(super) fn step(&mut self) {
        if self.trust == Trust::Steady {
            let high = (self.high + 1) & Self::MASK;
            self.advance(high);
            self.high = high;
        }
    }

    fn advance(&mut self, high: u32) {
        let elapsed = high.wrapping_sub(self.high) & Self::MASK;
        self.base_us = self.base_us.saturating_add(i64::from(elapsed) << SHIFT);
        self.behind_us = i64::from(self.behind_us).saturating_sub(i64::from(elapsed) << SHIFT).max(0) as u32;
    }
}
