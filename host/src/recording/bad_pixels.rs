//! Pixels that do not do what they should: hot ones, which send far too much, and columns that send nothing.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

/// A pixel with more than this many times the events of the median active pixel is hot.
const HOT_FACTOR: u32 = 10;
/// Fewest events of a hot pixel.
const FEWEST_OF_HOT: u32 = 50;
/// A column without events is dead if the median column has so many.
const FEWEST_OF_COLUMN: u64 = 1000;

/// Counts the events of each pixel.
#[derive(Clone, Debug)]
pub struct PixelCounter {
    width: usize,
    counts: Vec<u32>,
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BadPixels {
    /// Number of hot pixels.
    pub hot: usize,
    /// Their share of all events.
    pub hot_share: f64,
    /// Columns that send nothing.
    pub dead_columns: Vec<u16>,
}

impl PixelCounter {
    /// For a sensor of this size.
    pub fn new(sensor: Sensor) -> Self {
        let width = usize::from(sensor.width);
        Self { width, counts: vec![0; width * usize::from(sensor.height)] }
    }

    /// Adds events.
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            if let Some(count) = self.counts.get_mut(usize::from(event.y) * self.width + usize::from(event.x)) {
                *count = count.saturating_add(1);
            }
        }
    }

    /// What was found.
    pub fn finish(&self) -> BadPixels {
        let mut active: Vec<u32> = self.counts.iter().copied().filter(|count| *count > 0).collect();
        let middle = active.len() / 2;
        let median = if active.is_empty() { 0 } else { *active.select_nth_unstable(middle).1 };
        let all: u64 = active.iter().map(|count| u64::from(*count)).sum();
        let limit = median.saturating_mul(HOT_FACTOR).max(FEWEST_OF_HOT);
        let hot: Vec<u32> = active.into_iter().filter(|count| *count > limit).collect();
        let of_hot: u64 = hot.iter().map(|count| u64::from(*count)).sum();
        let mut columns = vec![0_u64; self.width];
        for row in self.counts.chunks(self.width.max(1)) {
            columns.iter_mut().zip(row).for_each(|(column, count)| *column += u64::from(*count));
        }
        BadPixels { hot: hot.len(), hot_share: of_hot as f64 / all.max(1) as f64, dead_columns: dead_lines(&columns) }
    }
}

/// Those of some lines of pixels that have no events while most have many.
pub(super) fn dead_lines(events: &[u64]) -> Vec<u16> {
    let mut sorted = events.to_vec();
    sorted.sort_unstable();
    if sorted.get(sorted.len() / 2).is_none_or(|median| *median < FEWEST_OF_COLUMN) {
        return Vec::new();
    }
    (0..).zip(events).filter(|(_, events)| **events == 0).map(|(line, _)| line).collect()
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;

    #[test]
    fn hot_pixels_and_dead_columns_are_found() {
        let mut counter = PixelCounter::new(Sensor::new(20, 15));
        let event = |x: u16, y: u16| Event { t: 0, x, y, polarity: Polarity::On };
        for round in 0..150 {
            for (x, y) in (0..15).flat_map(|y| (0..20).map(move |x| (x, y))) {
                if x != 4 && x != 17 && (round + x + y) % 3 != 0 {
                    counter.push(&[event(x, y)]);
                }
            }
        }
        assert_eq!(counter.finish(), BadPixels { hot: 0, hot_share: 0.0, dead_columns: vec![4, 17] });
        counter.push(&vec![event(3, 3); 27_000]);
        // Two thirds of 150 rounds of 18 columns and 15 rows, and what was added.
        let found = counter.finish();
        assert_eq!(found.hot, 1);
        assert!((found.hot_share - 0.5).abs() < 0.01, "{found:?}");
    }

    #[test]
    fn few_events_make_no_column_dead() {
        assert_eq!(dead_lines(&[0, 999, 999]), [0_u16; 0]);
        assert_eq!(dead_lines(&[0, 1000, 1000]), [0]);
        assert_eq!(dead_lines(&[]), [0_u16; 0]);
    }
}
