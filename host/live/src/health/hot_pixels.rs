//! Detection of hot pixels, which fire in nearly every slot of a twentieth of a second, unlike pixels that see moving
//! edges.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

/// Length of the slots (µs).
const SLOT: i64 = 50_000;
/// Slots that are analysed at once: 2 s.
const SLOTS: i64 = 40;
/// A pixel that fires in at least this many of them is hot.
const FEWEST: u8 = 37;

/// Counts hot pixels.
#[derive(Clone, Debug)]
pub struct HotPixels {
    width: usize,
    /// For each pixel: the number of slots of this period in which it fired, and whether it fired in the current one.
    pixels: Vec<(u8, bool)>,
    slot: i64,
    /// The first slot of the period.
    first: i64,
    count: Option<u32>,
}

impl HotPixels {
    /// Creates a counter for this sensor.
    pub fn new(sensor: Sensor) -> Self {
        let (width, height) = (usize::from(sensor.width), usize::from(sensor.height));
        Self { width, pixels: vec![(0, false); width * height], slot: 0, first: 0, count: None }
    }

    /// Adds the next events, in order of time (µs).
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            let slot = event.t.div_euclid(SLOT);
            if slot > self.slot {
                self.close_slot(slot);
            }
            if usize::from(event.x) < self.width
                && let Some(pixel) = self.pixels.get_mut(usize::from(event.y) * self.width + usize::from(event.x))
            {
                pixel.1 = true;
            }
        }
    }

    fn close_slot(&mut self, next: i64) {
        self.slot = next;
        let is_over = next - self.first >= SLOTS;
        let mut count = 0;
        for (slots, fired) in &mut self.pixels {
            *slots += u8::from(std::mem::take(fired));
            if is_over {
                count += u32::from(std::mem::take(slots) >= FEWEST);
            }
        }
        if is_over {
            // A period with a gap is not evaluated.
            if next - self.first == SLOTS {
                self.count = Some(count);
            }
            self.first = next;
        }
    }

    /// Returns the number of hot pixels in the last complete 2 s; `None` before.
    pub fn count(&self) -> Option<u32> {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;

    fn event(t: i64, x: u16) -> Event {
        Event { t, x, y: 3, polarity: Polarity::On }
    }

    #[test]
    fn only_pixels_that_fire_all_the_time_are_hot() {
        let mut pixels = HotPixels::new(Sensor::new(20, 10));
        let mut events = Vec::new();
        for t in (0..2_010_000).step_by(10_000) {
            // A hot pixel; an edge that returns; a pixel outside the sensor.
            events.push(event(t, 1));
            if t / 200_000 % 2 == 0 {
                events.extend([event(t, 2); 50]);
            }
            events.push(event(t, 20));
        }
        pixels.push(&events);
        assert_eq!(pixels.count(), Some(1));
    }

    #[test]
    fn hot_pixels_are_unknown_after_a_gap() {
        let mut pixels = HotPixels::new(Sensor::new(20, 10));
        pixels.push(&[event(0, 1), event(i64::MAX / 2, 1)]);
        assert_eq!(pixels.count(), None);
    }
}
