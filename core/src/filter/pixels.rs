//! Filter for hot and refractory pixels.

use super::{EventFate, FilterSettings};
use crate::sensor::Sensor;

/// Bits by which microseconds are shifted right: a unit is 16 µs, and 16 bits wrap after 1.05 s.
const UNIT: u32 = 4;
/// Three periods must be shorter than the range of the 16-bit times.
const LONGEST_PERIOD_US: u32 = 300_000;
/// Largest number of periods skipped at once; any number above 1 has the same effect.
const MOST_PERIODS: i64 = 1000;
const HOT: u16 = 0x8000;

/// The pixel that a slot currently tracks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot {
    /// Identifies the pixel among those that share the slot.
    tag: u16,
    /// Time of its last event that was not refractory, in units.
    last: u16,
    /// Period of its last event.
    period: u16,
    /// Number of its events in that period. The highest bit is set if it is hot because of the previous period.
    count: u16,
}

impl Slot {
    pub const EMPTY: Self = Self { tag: 0, last: 0, period: 0, count: 0 };
}

#[derive(Debug)]
pub(super) struct PixelFilter<'a, const SLOTS: usize> {
    slots: &'a mut [Slot; SLOTS],
    width: u16,
    /// `false` if neither filter is on.
    active: bool,
    /// Largest number of events in a period.
    hot_events: u16,
    /// In units; 0 when off.
    refractory: u16,
    period_us: i64,
    /// Number of the current period.
    period: u16,
    /// End of the current period in microseconds.
    period_end_us: i64,
}

impl<'a, const SLOTS: usize> PixelFilter<'a, SLOTS> {
    pub fn new(sensor: Sensor, settings: &FilterSettings, slots: &'a mut [Slot; SLOTS]) -> Option<Self> {
        let pixels = u64::from(sensor.width) * u64::from(sensor.height);
        let active = settings.hot_events > 0 || settings.refractory_us > 0;
        if active && pixels.div_ceil(SLOTS as u64) > 1 << 16 {
            return None;
        }
        slots.fill(Slot::EMPTY);
        let period_us = i64::from(settings.hot_period_us.clamp(1, LONGEST_PERIOD_US));
        let longest = settings.refractory_us.min(period_us as u32);
        Some(Self {
            slots,
            width: sensor.width,
            active,
            hot_events: if settings.hot_events == 0 { u16::MAX } else { settings.hot_events.min(HOT - 2) },
            refractory: longest.div_ceil(1 << UNIT) as u16,
            period_us,
            // An empty slot belongs to period 0, which is too long ago.
            period: 2,
            period_end_us: period_us,
        })
    }

    #[inline]
    pub fn fate(&mut self, x: u16, y: u16, elapsed_us: i64) -> EventFate {
        if !self.active {
            return EventFate::Keep;
        }
        if elapsed_us >= self.period_end_us {
            self.next_period(elapsed_us);
        }
        let pixel = u32::from(y) * u32::from(self.width) + u32::from(x);
        // SLOTS is a power of two.
        let Some(slot) = self.slots.get_mut(pixel as usize & (SLOTS - 1)) else { return EventFate::Keep };
        let tag = (pixel >> SLOTS.trailing_zeros()) as u16;
        let now = (elapsed_us >> UNIT) as u16;

        let periods = self.period.wrapping_sub(slot.period);
        if periods != 0 {
            let hot = periods == 1 && slot.count & !HOT > self.hot_events;
            slot.count = if hot { HOT } else { 0 };
            slot.period = self.period;
        }
        if slot.tag != tag {
            if slot.count <= 1 {
                *slot = Slot { tag, last: now, period: self.period, count: 1 };
            } else if slot.count & HOT == 0 {
                slot.count -= 1;
            }
            return EventFate::Keep;
        }
        let count = (slot.count & !HOT).saturating_add(1).min(HOT - 1);
        slot.count = (slot.count & HOT) | count;
        if slot.count > self.hot_events {
            slot.last = now;
            return EventFate::Hot;
        }
        if periods <= 1 && now.wrapping_sub(slot.last) < self.refractory {
            return EventFate::Refractory;
        }
        slot.last = now;
        EventFate::Keep
    }

    #[cold]
    fn next_period(&mut self, elapsed_us: i64) {
        let passed = (elapsed_us.saturating_sub(self.period_end_us) / self.period_us.max(1)).saturating_add(1);
        self.period = self.period.wrapping_add(passed.min(MOST_PERIODS) as u16);
        self.period_end_us = self.period_end_us.saturating_add(passed.saturating_mul(self.period_us));
    }
}
