//! Faulty pixels: hot pixels, which send far too many events; pixels that send an event twice; and columns without events.

use std::fmt;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use serde::Serialize;

use super::rounded::Rounded;
use super::silent_lines::SilentLines;

/// A pixel is hot if it has more than this many times the events of the median active pixel.
pub(super) const HOT_FACTOR: u64 = 10;
/// A pixel with at most this number of events is never hot.
const FEWEST_OF_HOT: u64 = 50;
/// Share of all events from which repeated events are reported. With timestamps rounded to 1 ms, 0.02 % are repeated, with 10 ms
/// 44 %.
const MANY_REPEATED: f64 = 0.05;

/// Counts the events of each pixel.
#[derive(Clone, Debug)]
pub struct PixelCounter {
    width: usize,
    pixels: Vec<Pixel>,
    repeated: u64,
}

#[derive(Clone, Copy, Debug)]
struct Pixel {
    count: u32,
    polarity: Polarity,
    /// Time of its last event.
    last: i64,
}

/// Events with the same time and polarity as the last one of their pixel: the recording contains them twice, or its timestamps
/// were rounded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Repetition {
    /// Their share of all events.
    pub share: f64,
}

/// Result of the diagnosis of pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BadPixels {
    /// Number of hot pixels.
    pub hot: usize,
    /// Their share of all events.
    pub hot_share: f64,
    /// Repeated events, if there are many.
    pub repeated: Option<Repetition>,
    /// Columns and rows without events, if there are any.
    pub silent: Option<SilentLines>,
    /// Pixels without events, as in undistorted recordings.
    pub rounded: Option<Rounded>,
}

impl PixelCounter {
    /// Creates a counter for a sensor of this size.
    pub fn new(sensor: Sensor) -> Self {
        let width = usize::from(sensor.width);
        let silent = Pixel { count: 0, polarity: Polarity::Off, last: i64::MIN };
        Self { width, pixels: vec![silent; width * usize::from(sensor.height)], repeated: 0 }
    }

    /// Adds events.
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            if let Some(pixel) = self.pixels.get_mut(usize::from(event.y) * self.width + usize::from(event.x)) {
                self.repeated += u64::from(pixel.last == event.t && pixel.polarity == event.polarity);
                *pixel = Pixel { count: pixel.count.saturating_add(1), polarity: event.polarity, last: event.t };
            }
        }
    }

    /// Returns the result.
    pub fn finish(&self) -> BadPixels {
        let counts: Vec<u32> = self.pixels.iter().map(|pixel| pixel.count).collect();
        BadPixels::of_counts(&counts, self.width, self.repeated)
    }
}

impl BadPixels {
    /// Diagnoses the pixels from the number of events of each, row by row of `width` pixels, and from the number of `repeated`
    /// events.
    pub fn of_counts(counts: &[u32], width: usize, repeated: u64) -> Self {
        let each = || counts.iter().map(|count| u64::from(*count));
        let limit = most_of_good(each().filter(|count| *count > 0));
        let hot = || each().filter(|count| *count > limit);
        let (of_hot, all): (u64, u64) = (hot().sum(), each().sum());
        Self {
            hot: hot().count(),
            hot_share: of_hot as f64 / all.max(1) as f64,
            repeated: Some(Repetition { share: repeated as f64 / all.max(1) as f64 })
                .filter(|repeated| repeated.share > MANY_REPEATED),
            silent: SilentLines::found(counts, width),
            rounded: Rounded::found(counts, width),
        }
    }
}

impl Repetition {
    /// Remedy.
    pub const ADVICE: &str = "export each event once, with its time in full microseconds";
}

impl fmt::Display for Repetition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = 100.0 * self.share;
        write!(
            f,
            "{percent:.0} % of the events repeat another of the same pixel, time and polarity, and no pixel sends two at once"
        )
    }
}

/// Returns the largest number of events of a pixel that is not hot, from the numbers of events of the active pixels.
pub(super) fn most_of_good(active: impl Iterator<Item = u64>) -> u64 {
    let mut active: Vec<u64> = active.collect();
    let middle = active.len() / 2;
    let median = if active.is_empty() { 0 } else { *active.select_nth_unstable(middle).1 };
    median.saturating_mul(HOT_FACTOR).max(FEWEST_OF_HOT)
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;

    #[test]
    fn hot_pixels_and_dead_columns_are_found() {
        let mut counter = PixelCounter::new(Sensor::new(20, 15));
        let event = |t: i64, x: u16, y: u16| Event { t, x, y, polarity: Polarity::On };
        for round in 0..150 {
            for (x, y) in (0..15).flat_map(|y| (0..20).map(move |x| (x, y))) {
                if x != 4 && x != 17 && (round + x + y) % 3 != 0 {
                    counter.push(&[event(i64::from(round), x, y)]);
                }
            }
        }
        assert_eq!(
            counter.finish(),
            BadPixels {
                silent: Some(SilentLines::Lines { columns: vec![4, 17], rows: Vec::new() }),
                ..BadPixels::default()
            }
        );
        counter.push(&(0..27_000).map(|t| event(150 + t, 3, 3)).collect::<Vec<_>>());
        // Two thirds of 150 rounds of 18 columns and 15 rows, and the added events.
        let found = counter.finish();
        assert_eq!(found.hot, 1);
        assert!((found.hot_share - 0.5).abs() < 0.01, "{found:?}");
    }

    /// A recording that contains each event twice must be reported, because its standard deviations are too small.
    #[test]
    fn events_that_repeat_others_are_counted() {
        let repeated = |events: &[Event]| {
            let mut counter = PixelCounter::new(Sensor::new(20, 15));
            counter.push(events);
            counter.finish()
        };
        let at = |t: i64, x: u16, polarity: Polarity| Event { t, x, y: 2, polarity };
        // Sorted by time alone, so that the events of one time come as a b a b.
        let twice: Vec<Event> = (0..40).map(|index| at(index / 4, (index % 2) as u16, Polarity::On)).collect();
        assert_eq!(repeated(&twice).repeated, Some(Repetition { share: 0.5 }));
        assert!(Repetition { share: 0.5 }.to_string().starts_with("50 % of the events repeat another"));
        // Another time, pixel or polarity is another event.
        let once = [at(0, 1, Polarity::On), at(0, 2, Polarity::On), at(0, 1, Polarity::Off), at(1, 1, Polarity::Off)];
        assert_eq!(repeated(&once), BadPixels::default());
        assert_eq!(repeated(&[]), BadPixels::default());
    }

    #[test]
    fn hot_pixels_exceed_ten_times_the_median_and_fifty_events() {
        assert_eq!(most_of_good([1, 2, 3, 1000].into_iter()), 50);
        assert_eq!(most_of_good([1, 7, 9, 100, 200].into_iter()), 90);
        assert_eq!(most_of_good([].into_iter()), 50);
    }
}
