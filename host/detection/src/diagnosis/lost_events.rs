//! Detection of events that were lost at random.
//!
//! An edge of high contrast makes a long burst of events at a pixel, the edge behind it (the other side of the dot or square) a burst
//! of about the same length. If events are lost at random, on the way or in the camera, neighbouring bursts of a pixel have lengths
//! that do not depend on each other. Then the rank of an event in its burst is not the one that it has in what is left, and the
//! focal length absorbs a part of the error.

use std::fmt;

use serde::Serialize;

/// Number of lengths: 0 to 7 events; longer bursts count as 7.
const LENGTHS: usize = 8;
/// Fewest pairs for a decision.
const FEWEST: u64 = 10_000;
/// Correlations at which surely nothing was lost, and at which most events were. It is 0.26 in the real recording of a board and 0.53
/// to 0.88 in simulated ones of six cameras, at most 0.20 if half of their events are lost, and at most 0.08 with seven of ten.
const RELATED: f64 = 0.3;
const UNRELATED: f64 = 0.1;
/// Smallest variance of the lengths, as a share of their mean. Bursts that all have the same length lost nothing.
const VARIED: f64 = 0.1;

/// Lengths of two successive bursts of opposite polarity of the same pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BurstPairs {
    /// Number of pairs by the polarity of the later burst, the length of the earlier and that of the later one.
    counts: [[[u32; LENGTHS]; LENGTHS]; 2],
}

impl BurstPairs {
    /// Adds `count` pairs, 0 or 1, whose later burst has this index of its polarity.
    #[inline(always)]
    pub fn add(&mut self, polarity: u8, earlier: u8, later: u8, count: u32) {
        let length = |events: u8| usize::from(events).min(LENGTHS - 1);
        self.counts[usize::from(polarity & 1)][length(earlier)][length(later)] += count;
    }
}

/// Events that were lost at random.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LostEvents {
    /// Correlation of the lengths of successive bursts.
    pub correlation: f64,
}

impl LostEvents {
    /// Returns the loss that the lengths of bursts show, if there may be one. One polarity is enough to show that nothing was lost:
    /// between the dark side of a dot and its bright surroundings, little varies.
    pub fn found(pairs: &BurstPairs) -> Option<Self> {
        let correlations: Vec<f64> = pairs.counts.iter().filter_map(correlation).collect();
        let correlation = correlations.iter().copied().reduce(f64::max)?;
        (correlation < RELATED).then_some(Self { correlation })
    }

    /// Returns `true` if most events were lost.
    pub fn is_certain(&self) -> bool {
        self.correlation < UNRELATED
    }

    /// Returns the standard deviation of the focal length of a camera from such events, as a share of it. (In simulated recordings of
    /// which 70 to 85 % of the events were removed, it was wrong by 0.04 to 0.09 %.)
    pub fn scale(&self) -> f64 {
        const OF_MOST: f64 = 6e-4;
        OF_MOST * ((RELATED - self.correlation) / (RELATED - UNRELATED)).clamp(0.0, 1.0)
    }

    /// Remedy.
    pub const ADVICE: &str =
        "turn off the camera's rate limiter or raise its contrast thresholds, and record what the camera sends";
}

/// Returns the correlation of the two lengths; `None` if there are few pairs or all have the same length.
fn correlation(counts: &[[u32; LENGTHS]; LENGTHS]) -> Option<f64> {
    let (mut number, mut sums, mut squares, mut product) = (0_u64, [0.0; 2], [0.0; 2], 0.0);
    for (earlier, row) in counts.iter().enumerate() {
        for (later, &count) in row.iter().enumerate() {
            number += u64::from(count);
            let (count, lengths) = (f64::from(count), [earlier as f64, later as f64]);
            product += count * lengths[0] * lengths[1];
            for ((sum, square), length) in sums.iter_mut().zip(&mut squares).zip(lengths) {
                *sum += count * length;
                *square += count * length * length;
            }
        }
    }
    let total = number as f64;
    let mean = sums.map(|sum| sum / total);
    let variance: [f64; 2] = std::array::from_fn(|of| squares[of] / total - mean[of] * mean[of]);
    let is_varied = mean.iter().zip(variance).all(|(mean, variance)| variance > VARIED * mean);
    (number >= FEWEST && is_varied).then(|| (product / total - mean[0] * mean[1]) / (variance[0] * variance[1]).sqrt())
}

impl fmt::Display for LostEvents {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "more than half of the events were lost at random: neighbouring edges send numbers of events that do not depend on each other",
        )
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use evcal_geometry::numerics::random::uniform_in;

    /// Pairs of bursts of two to five events, of which a `share` arrives.
    fn pairs(share: f64, count: usize) -> BurstPairs {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut pairs = BurstPairs::default();
        for _ in 0..count {
            let sent = uniform_in(&mut random, 2.0, 6.0) as u8;
            let [earlier, later] =
                [0; 2].map(|_| (0..sent).filter(|_| uniform_in(&mut random, 0.0, 1.0) < share).count() as u8);
            pairs.add(1, earlier, later, u32::from(earlier > 0 && later > 0));
        }
        pairs
    }

    #[test]
    fn a_random_loss_of_most_events_is_found() {
        assert_eq!(LostEvents::found(&pairs(0.9, 40_000)), None);
        let most = LostEvents::found(&pairs(0.25, 100_000)).expect("a loss");
        assert!(most.is_certain() && most.scale() > 5e-4, "{most:?}");
        let some = LostEvents::found(&pairs(0.45, 100_000)).expect("a loss");
        assert!(!some.is_certain() && some.scale() < most.scale(), "{some:?}");
        assert_eq!(LostEvents::found(&pairs(0.3, 1000)), None, "too few");
    }

    #[test]
    fn bursts_of_one_length_lost_nothing() {
        let mut one = BurstPairs::default();
        (0..50_000).for_each(|_| one.add(0, 1, 1, 1));
        assert_eq!(LostEvents::found(&one), None);
    }
}
