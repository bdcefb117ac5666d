//! Detection of edges that appear twice, as in a stream with the events of two cameras.
//!
//! When an edge passes a pixel, the pixel sends events of one polarity at intervals of about a threshold's worth of contrast. An
//! interval that is much shorter than these does not occur: the light needs time to change, and the pixel to recover. If two images of
//! one scene share the pixels, the next event is often of the other image, and may follow at any time: the number of intervals per
//! microsecond is the same for all short ones, and a considerable share of the number at the usual interval. Other short intervals do
//! not look like this. Noise follows with either polarity, so that pairs of opposite polarity are subtracted. Pixels that oscillate, or
//! send an event twice, prefer certain intervals.
//!
//! Pixels that were binned have more than two images, so that a third event often follows the second as shortly. Their images differ
//! everywhere by the same half pixel, which does not move the calibration.

use std::fmt;

use serde::Serialize;

/// Number of octaves of intervals: interval number `k` is from 2^k to below 2^(k+1) µs.
pub const OCTAVES: usize = 16;
/// Octaves of short intervals: 8 to 255 µs. Below, some cameras send an event twice.
const SHORT: std::ops::Range<usize> = 3..8;
/// Octaves of usual intervals: 0.25 to 32 ms.
const USUAL: std::ops::Range<usize> = 8..15;
/// Octaves of the intervals before and of a third event: 8 to 127 µs.
pub const CLOSE: std::ops::Range<usize> = 3..7;
/// Fewest short intervals for a decision.
const FEWEST: u64 = 500;
/// Largest ratio of the numbers per microsecond of two octaves of short intervals. It is 1.03 to 1.28 for two simulated cameras, and
/// larger for one whose times are dithered by half a millisecond, because its intervals of that length are usual ones.
const EVEN: f64 = 1.5;
/// Smallest ratio of the number of short intervals per microsecond to the largest number of usual ones. It is 0.15 to 0.90 in six
/// recordings of two simulated cameras; below 0.001 in simulated recordings of one, and 0.04 in one of ten real ones, where it is not
/// even.
const SMALLEST: f64 = 0.07;
/// Number of third events, as a share of the number with a third image, from which there are more than two images. With intervals up
/// to 0.25 ms it is 0.15 to 0.4 for binned pixels, and at most 0.05 for two cameras.
const THIRD: f64 = 0.08;

/// Intervals between the first event of a burst and the next event of its pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FirstIntervals {
    /// Number of intervals in each octave to an event of the same polarity; the last has all longer ones.
    pub same: [u64; OCTAVES],
    /// The same for events of the opposite polarity.
    pub opposite: [u64; OCTAVES],
    /// Number of third events after two intervals in [`CLOSE`]: of the opposite and of the same polarity.
    pub thirds: [u64; 2],
}

/// Edges that appear twice.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DoubleEdges {
    /// Number of intervals of 8 to 255 µs per 100 bursts.
    pub percent: f64,
}

impl DoubleEdges {
    /// Returns the double edges that these intervals show, if there are any.
    pub fn found(intervals: &FirstIntervals) -> Option<Self> {
        let FirstIntervals { same, opposite, thirds } = intervals;
        let density: Vec<f64> = same
            .iter()
            .zip(opposite)
            .enumerate()
            .map(|(octave, (&same, &opposite))| (same as f64 - opposite as f64) / f64::from(1_u32 << octave))
            .collect();
        let (short, usual) = (density.get(SHORT)?, density.get(USUAL)?);
        let largest = |of: &[f64]| of.iter().copied().fold(0.0, f64::max);
        let smallest = short.iter().copied().fold(f64::INFINITY, f64::min);
        let counted = |octaves: std::ops::Range<usize>| same.get(octaves).unwrap_or_default().iter().sum::<u64>();
        let is_even = smallest > 0.0 && largest(short) <= EVEN * smallest;
        if counted(SHORT) < FEWEST || !is_even || smallest < SMALLEST * largest(usual) {
            return None;
        }
        let bursts = same.iter().chain(opposite).sum::<u64>().max(1) as f64;
        let pairs = counted(CLOSE) as f64;
        let [noise, thirds] = thirds.map(|count| count as f64);
        let is_double = thirds - noise < THIRD * pairs * pairs / bursts;
        is_double.then(|| Self { percent: 100.0 * counted(SHORT) as f64 / bursts })
    }

    /// Remedy.
    pub const ADVICE: &str = "were the events of two cameras merged, or those of one camera stored twice? Calibrate from the events of each camera alone";
}

impl fmt::Display for DoubleEdges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "edges appear twice: after {:.1} % of the first events of an edge, the pixel sends another one within 0.25 ms, at any time, \
             as no single pixel does",
            self.percent
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of intervals of this density in each octave.
    fn intervals(same: [u64; OCTAVES], opposite: u64, thirds: [u64; 2]) -> FirstIntervals {
        let count = |(octave, density): (usize, u64)| density << octave;
        let same = std::array::from_fn(|octave| count((octave, same[octave])));
        FirstIntervals { same, opposite: std::array::from_fn(|octave| count((octave, opposite))), thirds }
    }

    #[test]
    fn short_intervals_of_any_length_are_two_images() {
        // A usual interval of 1 to 2 ms.
        let two = [9, 21, 20, 21, 20, 22, 21, 21, 20, 35, 60, 14, 3, 1, 0, 0];
        let found = DoubleEdges::found(&intervals(two, 1, [2, 3])).expect("two images");
        assert!((1.0..6.0).contains(&found.percent), "{found}");
        assert!(found.to_string().starts_with("edges appear twice"), "{found}");
    }

    #[test]
    fn noise_glitches_and_oscillation_are_one_image() {
        let usual = |short: [u64; 8]| {
            let mut same = [0, 0, 0, 0, 0, 0, 0, 0, 20, 35, 60, 14, 3, 1, 0, 0];
            same[..8].copy_from_slice(&short);
            same
        };
        let one = |same, opposite| DoubleEdges::found(&intervals(same, opposite, [0, 0]));
        assert_eq!(one(usual([0; 8]), 0), None);
        // As many intervals to opposite events: noise.
        assert_eq!(one(usual([25; 8]), 24), None);
        // Most pixels send an event twice.
        assert_eq!(one(usual([900, 300, 90, 9, 0, 0, 0, 0]), 0), None);
        // Oscillation at 20 µs.
        assert_eq!(one(usual([0, 0, 1, 20, 900, 700, 300, 40]), 0), None);
        // Times dithered by half a millisecond: the short intervals are the beginning of the usual ones.
        assert_eq!(one(usual([0, 0, 0, 6, 6, 7, 9, 11]), 0), None);
        assert_eq!(one([0; OCTAVES], 0), None);
    }

    /// With more than two images in a pixel, as with binned pixels, a third event follows.
    #[test]
    fn binned_pixels_are_not_two_images() {
        let binned = [20, 21, 20, 21, 20, 22, 21, 21, 20, 35, 60, 14, 3, 1, 0, 0];
        assert_eq!(DoubleEdges::found(&intervals(binned, 0, [2, 40])), None);
    }
}
