//! Detection of hot pixels in the last two seconds, as [`bad_pixels`] defines them.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_detection::diagnosis::bad_pixels;

/// Period whose events are counted (µs).
const PERIOD: i64 = 2_000_000;

/// Counts hot pixels.
#[derive(Clone, Debug)]
pub struct HotPixels {
    width: usize,
    /// For each pixel the number of events in this period.
    counts: Vec<u32>,
    /// Start of this period (µs).
    first: i64,
    count: Option<usize>,
}

impl HotPixels {
    /// Creates a counter for this sensor.
    pub fn new(sensor: Sensor) -> Self {
        let (width, height) = (usize::from(sensor.width), usize::from(sensor.height));
        Self { width, counts: vec![0; width * height], first: 0, count: None }
    }

    /// Adds the next events, in order of time (µs).
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            let periods = event.t.saturating_sub(self.first).div_euclid(PERIOD);
            if periods > 0 {
                // A period with a gap is not evaluated.
                if periods == 1 {
                    self.count = Some(bad_pixels::HotPixels::of_counts(&self.counts, self.width).count);
                }
                self.counts.fill(0);
                self.first = event.t - event.t.rem_euclid(PERIOD);
            }
            if usize::from(event.x) < self.width
                && let Some(count) = self.counts.get_mut(usize::from(event.y) * self.width + usize::from(event.x))
            {
                *count += 1;
            }
        }
    }

    /// Returns the number of hot pixels in the last complete 2 s; `None` before.
    pub fn count(&self) -> Option<usize> {
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
            // Noise; a hot pixel; an edge that returns; a pixel outside the sensor.
            if t % 500_000 == 0 {
                events.extend((0..200).map(|at| Event { y: at / 20, ..event(t, at % 20) }));
            }
            events.push(event(t, 1));
            if t / 200_000 % 2 == 0 {
                events.extend((5..9).flat_map(|x| (0..10).map(move |y| Event { y, ..event(t, x) })));
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
