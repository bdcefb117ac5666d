//! Timestamps of IMU samples that do not belong to the samples: several samples with one timestamp, and timestamps that scatter
//! more than the time between samples.
//!
//! Samples arrive in the order in which they were taken. If they were taken at a constant rate, their number in that order is a
//! better clock than such timestamps: times are spread evenly again, and the relation of the timestamps to the samples is
//! uncertain by the time over which they were spread.

use serde::{Deserialize, Serialize};

use super::sample::Sample;
use evcal_geometry::numerics::statistics::median;

/// Share of samples that are not later than the previous ones from which timestamps are not taken as they are.
const MOST_LATE: f64 = 0.01;
/// Ratio of the median to the mean interval below which samples arrive in groups.
const GROUPED: f64 = 0.1;
/// Share of the groups with one timestamp whose samples must be as far apart as usual.
const ALIKE: f64 = 0.8;
/// Largest relative error of an interval, as a multiple of the usual one.
const INTERVAL_ERROR: f64 = 0.25;
/// A gap in the timestamps longer than this (s) and this number of mean intervals separates parts without a common rate.
const GAP: f64 = 0.1;
const GAP_INTERVALS: f64 = 20.0;
/// Fewest samples of a part.
const FEWEST: usize = 50;
/// Number of pieces of a part in which the mean deviation from a constant rate is examined, and fewest samples of a piece.
const PIECES: usize = 20;
const FEWEST_OF_PIECE: usize = 32;
/// Largest mean deviation of a piece from a constant rate: in intervals, and in standard errors.
const DEVIATION: f64 = 1.0;
const ERRORS: f64 = 4.0;

/// Treatment of the timestamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Timing {
    /// They are the times of the samples.
    #[default]
    Own,
    /// Samples share timestamps; they were spread evenly over the time up to their timestamp.
    Groups {
        /// Samples per timestamp, the median.
        samples: usize,
        /// Time that so many samples take (s).
        interval: f64,
    },
    /// They scatter; the samples were placed evenly in the order in which they arrived.
    Even {
        /// Scatter of the timestamps (s, root mean square).
        scatter: f64,
    },
    /// They scatter, and the samples do not arrive at a constant rate: the samples were sorted by their timestamps.
    Sorted {
        /// Scatter of the timestamps (s, root mean square).
        scatter: f64,
    },
}

impl Timing {
    /// Returns `true` if the timestamps were taken as they are.
    pub fn is_own(&self) -> bool {
        *self == Self::Own
    }

    /// Returns the uncertainty of the relation between timestamps and samples (s).
    pub fn uncertainty(&self) -> f64 {
        match *self {
            Self::Own => 0.0,
            Self::Groups { interval, .. } => interval,
            Self::Even { scatter } | Self::Sorted { scatter } => scatter,
        }
    }
}

/// Samples in strict order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Ordered {
    /// The samples.
    pub samples: Vec<Sample>,
    /// Treatment of their timestamps.
    pub timing: Timing,
}

/// Returns the `samples`, given in the order in which they arrived, in strict order of time; samples without a time of their own
/// are left out.
pub fn ordered(samples: Vec<Sample>) -> Ordered {
    let kept = rising(samples.iter().copied());
    let is_late = (samples.len() - kept.len()) as f64 > MOST_LATE * samples.len() as f64;
    if !is_late && !is_grouped(&kept) {
        return Ordered { samples: kept, timing: Timing::Own };
    }
    let by_time = by_time(&samples);
    let is_whole = (samples.len() - by_time.len()) as f64 <= MOST_LATE * samples.len() as f64;
    if is_whole && is_regular(&by_time) {
        // Timestamps are right, and the file contains the samples in another order.
        return Ordered { samples: by_time, timing: Timing::Own };
    }
    in_groups(&samples).or_else(|| evenly(&samples)).unwrap_or_else(|| {
        let timing = if is_late { Timing::Sorted { scatter: scatter(&samples) } } else { Timing::Own };
        Ordered { samples: by_time, timing }
    })
}

/// Returns the samples that are later than all before them.
fn rising(samples: impl Iterator<Item = Sample>) -> Vec<Sample> {
    let mut kept: Vec<Sample> = Vec::new();
    for sample in samples {
        if kept.last().is_none_or(|before| sample.t > before.t) {
            kept.push(sample);
        }
    }
    kept
}

fn intervals(samples: &[Sample]) -> Vec<f64> {
    samples.iter().zip(samples.iter().skip(1)).map(|(before, after)| after.t - before.t).collect()
}

/// Returns `true` if most samples follow each other in a small part of the mean interval.
fn is_grouped(samples: &[Sample]) -> bool {
    let mut intervals = intervals(samples);
    let mean = intervals.iter().sum::<f64>() / intervals.len().max(1) as f64;
    median(&mut intervals, f64::total_cmp).is_some_and(|middle| middle < GROUPED * mean)
}

/// Spreads groups of samples with one timestamp evenly over the time up to it; `None` if there are no such groups, or if the time
/// since the group before is not as long as the number of their samples makes it.
fn in_groups(samples: &[Sample]) -> Option<Ordered> {
    let groups: Vec<&[Sample]> = samples.chunk_by(|a, b| a.t == b.t).collect();
    let mut sizes: Vec<usize> = groups.iter().map(|group| group.len()).collect();
    let size = median(&mut sizes, usize::cmp)?;
    let step =
        |before: &&[Sample], group: &&[Sample]| Some((group.first()?.t - before.first()?.t) / group.len() as f64);
    let steps: Vec<f64> =
        groups.iter().zip(groups.iter().skip(1)).filter_map(|(before, group)| step(before, group)).collect();
    let apart = median(&mut steps.clone(), f64::total_cmp).filter(|apart| *apart > 0.0)?;
    let is_usual = |step: &&f64| (**step / apart - 1.0).abs() <= INTERVAL_ERROR;
    let regular = steps.iter().filter(is_usual).count() as f64 >= ALIKE * steps.len() as f64;
    if size < 2 || groups.len() < FEWEST.div_ceil(size) || !regular {
        return None;
    }
    let spread = groups.iter().flat_map(|group| {
        let last = group.len() - 1;
        let place =
            move |(index, sample): (usize, &Sample)| Sample { t: sample.t - apart * (last - index) as f64, ..*sample };
        group.iter().enumerate().map(place)
    });
    Some(Ordered { samples: rising(spread), timing: Timing::Groups { samples: size, interval: size as f64 * apart } })
}

/// Places samples of a constant rate evenly in their order; `None` if the rate is not constant.
fn evenly(samples: &[Sample]) -> Option<Ordered> {
    let (first, last) = (samples.first()?, samples.last()?);
    let mean = (last.t - first.t) / samples.len() as f64;
    let longest = GAP.max(GAP_INTERVALS * mean);
    let parts = samples.chunk_by(|before, after| (after.t - before.t).abs() < longest);
    let (mut placed, mut squares) = (Vec::new(), 0.0);
    for part in parts.filter(|part| part.len() >= FEWEST) {
        let line = Line::through(part);
        let off: Vec<f64> = part.iter().enumerate().map(|(index, sample)| sample.t - line.at(index)).collect();
        let scatter = root_mean_square(&off);
        let pieces = off.chunks((part.len() / PIECES).max(FEWEST_OF_PIECE));
        let means: Vec<f64> = pieces.clone().map(|piece| piece.iter().sum::<f64>() / piece.len() as f64).collect();
        let of_piece = pieces.map(<[f64]>::len).max().unwrap_or(1) as f64;
        let limit = (DEVIATION * line.step).max(ERRORS * scatter / of_piece.sqrt());
        if line.step <= 0.0 || means.iter().any(|mean| mean.abs() > limit) {
            return None;
        }
        squares += off.iter().map(|off| off * off).sum::<f64>();
        placed.extend(part.iter().enumerate().map(|(index, sample)| Sample { t: line.at(index), ..*sample }));
    }
    let scatter = (squares / placed.len().max(1) as f64).sqrt();
    // Most samples must have a time.
    (placed.len() as f64 >= ALIKE * samples.len() as f64)
        .then(|| Ordered { samples: rising(placed.into_iter()), timing: Timing::Even { scatter } })
}

/// Returns the samples in order of their timestamps, each timestamp once.
fn by_time(samples: &[Sample]) -> Vec<Sample> {
    let mut samples = samples.to_vec();
    samples.sort_by(|a, b| a.t.total_cmp(&b.t));
    rising(samples.into_iter())
}

/// Returns `true` if nearly all intervals are multiples of the usual one, as they are if only some samples are missing.
fn is_regular(samples: &[Sample]) -> bool {
    let intervals = intervals(samples);
    let Some(usual) = median(&mut intervals.clone(), f64::total_cmp) else { return false };
    intervals.iter().filter(|interval| is_multiple(**interval, usual)).count() as f64 >= ALIKE * intervals.len() as f64
}

fn is_multiple(interval: f64, usual: f64) -> bool {
    let times = (interval / usual).round();
    times >= 1.0 && (interval / usual - times).abs() <= INTERVAL_ERROR
}

/// Returns the scatter of the timestamps about a constant rate within some samples.
fn scatter(samples: &[Sample]) -> f64 {
    let of_piece = |piece: &[Sample]| {
        let line = Line::through(piece);
        piece.iter().enumerate().map(|(index, sample)| sample.t - line.at(index)).collect::<Vec<f64>>()
    };
    root_mean_square(&samples.chunks(FEWEST).flat_map(of_piece).collect::<Vec<f64>>())
}

fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Times of samples of a constant rate.
struct Line {
    middle: f64,
    step: f64,
    /// Number of the sample at `middle`.
    centre: f64,
}

impl Line {
    /// Fits the timestamps by least squares.
    fn through(samples: &[Sample]) -> Self {
        let count = samples.len().max(1) as f64;
        let centre = 0.5 * (count - 1.0);
        let middle = samples.iter().map(|sample| sample.t).sum::<f64>() / count;
        let (mut product, mut square) = (0.0, 0.0);
        for (index, sample) in samples.iter().enumerate() {
            let place = index as f64 - centre;
            product += place * (sample.t - middle);
            square += place * place;
        }
        Self { middle, step: if square > 0.0 { product / square } else { 0.0 }, centre }
    }

    fn at(&self, index: usize) -> f64 {
        self.middle + self.step * (index as f64 - self.centre)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use evcal_geometry::numerics::random::{normal, uniform_in};

    /// Samples at `rate` (Hz); the acceleration along x is the true time.
    fn samples(count: usize, rate: f64) -> Vec<Sample> {
        let sample = |index: usize| {
            let t = 100.0 + index as f64 / rate;
            Sample { t, acceleration: Vector3::new(t, 0.0, 9.8), angular_velocity: Vector3::zeros() }
        };
        (0..count).map(sample).collect()
    }

    fn truth(sample: &Sample) -> f64 {
        sample.acceleration.x
    }

    /// Returns the mean and the largest deviation of the times from the true ones plus the mean.
    fn errors(samples: &[Sample]) -> (f64, f64) {
        let mean = samples.iter().map(|sample| sample.t - truth(sample)).sum::<f64>() / samples.len() as f64;
        (mean, samples.iter().map(|sample| (sample.t - truth(sample) - mean).abs()).fold(0.0, f64::max))
    }

    #[test]
    fn good_timestamps_stay_as_they_are() {
        let given = samples(1000, 1000.0);
        assert_eq!(ordered(given.clone()), Ordered { samples: given.clone(), timing: Timing::Own });
        // A few late samples, and lost ones.
        let mut late = given.clone();
        late[500].t -= 0.2;
        late.drain(300..350);
        let found = ordered(late);
        assert_eq!((found.samples.len(), found.timing), (949, Timing::Own));
        // Samples that arrived in another order have their times nevertheless.
        let exchanged: Vec<Sample> = given.chunks(2).flat_map(|pair| [pair[1], pair[0]]).collect();
        assert_eq!(ordered(exchanged), Ordered { samples: given, timing: Timing::Own });
        assert_eq!(ordered(Vec::new()), Ordered { samples: Vec::new(), timing: Timing::Own });
    }

    /// A driver that reads several samples at once stamps all with the time of the last one.
    #[test]
    fn groups_with_one_timestamp_are_spread_up_to_it() {
        for (size, rate) in [(2, 1000.0), (4, 1000.0), (8, 1000.0), (10, 200.0)] {
            let mut given = samples(1000, rate);
            let stamp = |index: usize| 100.0 + ((index / size + 1) * size - 1) as f64 / rate;
            given.iter_mut().enumerate().for_each(|(index, sample)| sample.t = stamp(index));
            // One group is lost.
            given.drain(40 * size..41 * size);
            let found = ordered(given.clone());
            let Timing::Groups { samples, interval } = found.timing else { panic!("{:?}", found.timing) };
            assert_eq!((samples, found.samples.len()), (size, given.len()));
            assert!((interval - size as f64 / rate).abs() < 1e-9);
            assert!(found.samples.iter().all(|sample| (sample.t - truth(sample)).abs() < 1e-9));
        }
    }

    /// A driver that reads what has arrived, again and again.
    #[test]
    fn groups_of_any_size_are_spread_up_to_their_timestamp() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        for (sizes, rate) in [([1.0, 4.0], 1000.0), ([2.0, 9.0], 800.0), ([3.0, 4.0], 200.0)] {
            let mut given = samples(1000, rate);
            let mut first = 0;
            while first < given.len() {
                let size = uniform_in(&mut random, sizes[0], sizes[1] + 1.0) as usize;
                let last = (first + size).min(given.len()) - 1;
                let stamp = given[last].t;
                given[first..=last].iter_mut().for_each(|sample| sample.t = stamp);
                first = last + 1;
            }
            let found = ordered(given.clone());
            assert!(matches!(found.timing, Timing::Groups { .. }), "{:?}", found.timing);
            assert_eq!(found.samples.len(), given.len());
            assert!(found.samples.iter().all(|sample| (sample.t - truth(sample)).abs() < 1e-9));
        }
    }

    #[test]
    fn scattering_timestamps_of_a_constant_rate_are_replaced() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for (rate, delay) in [(1000.0, 4e-3), (400.0, 10e-3), (200.0, 8e-3)] {
            let mut given = samples(4000, rate);
            given.iter_mut().for_each(|sample| sample.t += (delay * normal(&mut random)).abs());
            // A pause.
            given.drain(2000..2500);
            let found = ordered(given.clone());
            let Timing::Even { scatter } = found.timing else { panic!("{rate}: {:?}", found.timing) };
            assert_eq!(found.samples.len(), given.len());
            // The mean of |x| is 0.8 σ, and its scatter 0.6 σ.
            let (mean, largest) = errors(&found.samples);
            assert!((mean - 0.8 * delay).abs() < 0.1 * delay && largest < 0.15 * delay, "{rate}: {mean} {largest}");
            assert!((scatter - 0.6 * delay).abs() < 0.06 * delay, "{scatter}");
        }
    }

    /// If samples are lost, too, their number is not a clock.
    #[test]
    fn scattering_timestamps_without_a_constant_rate_are_reported() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let mut given = samples(5000, 1000.0);
        given.iter_mut().for_each(|sample| sample.t += (4e-3 * normal(&mut random)).abs());
        given.retain(|_| uniform_in(&mut random, 0.0, 1.0) > 0.3);
        let found = ordered(given.clone());
        assert!(
            matches!(found.timing, Timing::Sorted { scatter } if (1e-3..4e-3).contains(&scatter)),
            "{:?}",
            found.timing
        );
        assert_eq!(found.samples.len(), given.len());
        assert!(found.samples.is_sorted_by(|a, b| a.t < b.t));
    }
}
