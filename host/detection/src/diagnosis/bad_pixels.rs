//! Faulty pixels: hot pixels, which send far too many events; pixels that send an event twice; and columns without events.

use std::fmt;

use serde::Serialize;

use evcal_geometry::numerics::statistics::median;

use super::rounded::Rounded;
use super::silent_lines::SilentLines;

/// A hot pixel has more than this many times the events of the busiest of its neighbours but two, because an edge that passes reaches
/// more of them. In simulated recordings of dots and squares, these are 11 or 12 of 12 hot pixels, and no others.
pub(super) const HOT_FACTOR: u64 = 3;
/// Position of that neighbour among all, the busiest first. If it had no event, the median active pixel of the sensor takes its place.
const COMPARED: usize = 2;
/// A pixel with at most this number of events is never hot.
const FEWEST_OF_HOT: u64 = 50;
/// Share of all events from which repeated events are reported. With timestamps rounded to 1 ms, 0.02 % are repeated, with 10 ms
/// 44 %.
const MANY_REPEATED: f64 = 0.05;

/// Events with the same time and polarity as the last one of their pixel: the recording contains them twice, or its timestamps
/// were rounded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Repetition {
    /// Their share of all events.
    pub share: f64,
}

/// Hot pixels are reported if they send more than this share of the events.
const MANY_HOT: f64 = 0.02;

/// Pixels that send far too many events.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HotPixels {
    /// Their number.
    pub count: usize,
    /// Their share of all events.
    pub share: f64,
}

impl HotPixels {
    /// Remedy.
    pub const ADVICE: &str = "raise the contrast thresholds of the camera's pixels";

    /// Returns number and share of the hot pixels from the number of events of each pixel, row by row of `width` pixels.
    pub fn of_counts(counts: &[u32], width: usize) -> Self {
        let width = width.max(1);
        let count = |x: usize, y: usize| counts.get(y * width + x).filter(|_| x < width).copied().map_or(0, u64::from);
        let pixels = counts.iter().enumerate().map(|(at, events)| (at % width, at / width, u64::from(*events)));
        let hot = hot_pixels(pixels, count);
        let (of_hot, all) =
            (hot.iter().map(|pixel| pixel.2).sum::<u64>(), counts.iter().map(|count| u64::from(*count)).sum::<u64>());
        Self { count: hot.len(), share: of_hot as f64 / all.max(1) as f64 }
    }
}

impl fmt::Display for HotPixels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} hot pixels send {:.0} % of all events", self.count, 100.0 * self.share)
    }
}

/// Returns column, row and number of events of the hot pixels among `pixels`; `count` returns the number of events of any pixel.
pub(super) fn hot_pixels(
    pixels: impl Iterator<Item = (usize, usize, u64)> + Clone,
    count: impl Fn(usize, usize) -> u64,
) -> Vec<(usize, usize, u64)> {
    let around = |x: usize, y: usize| {
        let near = |at: usize| at.saturating_sub(1)..=at + 1;
        let places = near(y).flat_map(move |row| near(x).map(move |column| (column, row)));
        places.filter(move |place| *place != (x, y)).map(|(x, y)| count(x, y))
    };
    let mut active: Vec<u64> = pixels.clone().map(|pixel| pixel.2).filter(|events| *events > 0).collect();
    let of_sensor = median(&mut active, u64::cmp).unwrap_or(0);
    let usual = |x: usize, y: usize| {
        let mut around: Vec<u64> = around(x, y).filter(|events| *events > 0).collect();
        around.sort_unstable_by(|a, b| b.cmp(a));
        around.get(COMPARED).copied().unwrap_or(of_sensor)
    };
    let is_hot = |&(x, y, events): &(usize, usize, u64)| {
        events > FEWEST_OF_HOT && events > usual(x, y).saturating_mul(HOT_FACTOR)
    };
    pixels.filter(is_hot).collect()
}

/// Result of the diagnosis of pixels.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BadPixels {
    /// Hot pixels, if they send many events.
    pub hot: Option<HotPixels>,
    /// Repeated events, if there are many.
    pub repeated: Option<Repetition>,
    /// Columns and rows without events, if there are any.
    pub silent: Option<SilentLines>,
    /// Pixels without events, as in undistorted recordings.
    pub rounded: Option<Rounded>,
}

impl BadPixels {
    /// Diagnoses the pixels from the number of events of each, row by row of `width` pixels, and from the number of `repeated`
    /// events.
    pub fn of_counts(counts: &[u32], width: usize, repeated: u64) -> Self {
        let all: u64 = counts.iter().map(|count| u64::from(*count)).sum();
        Self {
            hot: Some(HotPixels::of_counts(counts, width)).filter(|hot| hot.share > MANY_HOT),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hot_pixels_and_dead_columns_are_found() {
        // A hundred events each, and none in columns 4 and 17.
        let mut counts: Vec<u32> = (0..300).map(|pixel| if matches!(pixel % 20, 4 | 17) { 0 } else { 100 }).collect();
        let silent = Some(SilentLines::Lines { columns: vec![4, 17], rows: Vec::new() });
        let expected = BadPixels { silent, ..BadPixels::default() };
        assert_eq!(BadPixels::of_counts(&counts, 20, 0), expected);
        // As many as all others.
        counts[63] = 27_000;
        let found = BadPixels::of_counts(&counts, 20, 0);
        assert!(found.hot.is_some_and(|hot| hot.count == 1 && (hot.share - 0.5).abs() < 0.01), "{found:?}");
    }

    /// A recording that contains each event twice must be reported, because its standard deviations are too small.
    #[test]
    fn repeated_events_are_reported_if_there_are_many() {
        let repeated = |count| BadPixels::of_counts(&[10, 10, 10, 10], 2, count).repeated;
        assert_eq!(repeated(20), Some(Repetition { share: 0.5 }));
        assert!(Repetition { share: 0.5 }.to_string().starts_with("50 % of the events repeat another"));
        assert_eq!(repeated(0), None);
    }

    #[test]
    fn hot_pixels_exceed_three_times_their_neighbours_and_fifty_events() {
        let hot = |events: u32, others: u32| {
            let counts: Vec<u32> = (0..100).map(|at| if at == 55 { events } else { others }).collect();
            HotPixels::of_counts(&counts, 10).count
        };
        assert_eq!((hot(50, 1), hot(51, 1), hot(60, 20), hot(61, 20)), (0, 1, 0, 1));
        // Pixels without active neighbours, such as those of doubled coordinates, are compared with the sensor.
        let lattice: Vec<u32> = (0..100).map(|at| if at % 2 == 0 && at / 10 % 2 == 0 { 60 } else { 0 }).collect();
        assert_eq!(HotPixels::of_counts(&lattice, 10).count, 0);
        assert_eq!(HotPixels::of_counts(&[], 10).count, 0);
    }

    /// A board in a corner of the image, which only noise reaches otherwise: its pixels are not hot, but one pixel of the noise is.
    #[test]
    fn busy_parts_of_the_image_are_not_hot() {
        let mut counts: Vec<u32> =
            (0..1200).map(|at| if at % 40 < 15 && at / 40 < 15 { 300 + at } else { 4 }).collect();
        counts[29 * 40 + 39] = 200;
        assert_eq!(HotPixels::of_counts(&counts, 40).count, 1);
        assert_eq!(BadPixels::of_counts(&counts, 40, 0).hot, None);
    }
}
