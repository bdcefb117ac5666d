//! Scatter of the estimate when blocks of time are left out.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use evcal_solve::solve::equations::system::{Contribution, PackedContribution};

/// Sums the contributions of observations over even blocks of about `length` seconds. Contributions come from intervals that
/// begin at `starts` (segment, seconds).
///
/// Time between segments does not count, so that drifts over a recording in several pieces show between its parts too.
pub fn sum_by_block(
    starts: &[(usize, f64)],
    contributions: &[PackedContribution],
    length: f64,
) -> impl Iterator<Item = Contribution> {
    let (times, total) = observed_times(starts);
    let count = (total / length).round().max(1.0);
    let block = |t: &f64| (t / total * count).floor().min(count - 1.0) as usize;
    let mut keyed: BTreeMap<usize, Vec<&PackedContribution>> = BTreeMap::new();
    for (t, part) in times.iter().zip(contributions) {
        keyed.entry(block(t)).or_default().push(part);
    }
    keyed.into_values().filter_map(PackedContribution::sum)
}

/// Returns the middles of the intervals that begin at `starts`, in order, as if the segments followed each other without pause
/// from 0 on, and the total length. All intervals have the mean length.
fn observed_times(starts: &[(usize, f64)]) -> (Vec<f64>, f64) {
    let mut spans: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    let mut steps = 0;
    for &(segment, t) in starts {
        let (_, last) = spans.entry(segment).or_insert((t, t));
        if t > *last {
            (*last, steps) = (t, steps + 1);
        }
    }
    let spanned: f64 = spans.values().map(|(first, last)| last - first).sum();
    // If each interval is alone in its segment, its length is unknown; any length will do, because all are equal.
    let length = if steps > 0 { spanned / f64::from(steps) } else { 1.0 };
    let mut shifts = BTreeMap::new();
    let mut total = 0.0;
    for (segment, (first, last)) in spans {
        shifts.insert(segment, total - first + 0.5 * length);
        total += last - first + length;
    }
    (starts.iter().map(|(segment, t)| t + shifts.get(segment).copied().unwrap_or(0.0)).collect(), total)
}

/// Scatter of the estimate from block to block.
#[derive(Clone, Debug, PartialEq)]
pub struct Scatter {
    /// Covariance of the intrinsics.
    pub covariance: DMatrix<f64>,
    /// Ratio to the formal covariance.
    pub inflation: f64,
    /// Number of blocks.
    pub blocks: usize,
}

/// Computes the scatter of the first `intrinsics` parameters over `blocks`; `formal` is the inverse of the whole information, and
/// `step_without` is [`jackknife_step`] or [`limited_step`]. Returns `None` if it cannot be determined.
pub fn scatter(
    formal: &DMatrix<f64>,
    blocks: impl IntoIterator<Item = Contribution>,
    intrinsics: usize,
    step_without: StepWithout,
) -> Option<Scatter> {
    let (covariance, blocks) = covariance_of_steps(formal, blocks, intrinsics, step_without)?;
    let inflation = inflation(&formal.view((0, 0), (intrinsics, intrinsics)).into_owned(), &covariance)?;
    (inflation > 0.0).then_some(Scatter { covariance, inflation, blocks })
}

/// Returns the covariance of the first `intrinsics` parameters from their steps without each of `blocks`, and the number of blocks;
/// `formal` is the inverse of the whole information. Returns `None` with fewer than two blocks.
fn covariance_of_steps(
    formal: &DMatrix<f64>,
    blocks: impl IntoIterator<Item = Contribution>,
    intrinsics: usize,
    step_without: StepWithout,
) -> Option<(DMatrix<f64>, usize)> {
    let mut count = 0;
    let factor = formal.clone().cholesky()?;
    let information = Information { matrix: factor.inverse(), formal, root: factor.unpack() };
    let mut sum = DMatrix::zeros(intrinsics, intrinsics);
    for block in blocks {
        count += 1;
        let step = step_without(&block, &information).rows(0, intrinsics).into_owned();
        sum += &step * step.transpose();
    }
    (count > 1).then(|| (sum * ((count - 1) as f64 / count as f64), count))
}

/// The information of all blocks together.
pub struct Information<'a> {
    matrix: DMatrix<f64>,
    /// Its inverse.
    formal: &'a DMatrix<f64>,
    /// The lower triangle L with `formal` = L Lᵀ.
    root: DMatrix<f64>,
}

/// Computes the step of the estimate when a block is left out, to first order.
pub type StepWithout = fn(&Contribution, &Information) -> DVector<f64>;

/// Returns the step of the jackknife without block k, (S − Sₖ)⁻¹ gₖ.
///
/// If only this block determines a parameter, the estimate without it does not exist; the full step of the block is then an upper
/// bound.
pub fn jackknife_step(block: &Contribution, information: &Information) -> DVector<f64> {
    match (&information.matrix - &block.information).cholesky() {
        Some(others) => others.solve(&block.gradient),
        None => information.formal * &block.gradient,
    }
}

/// Share of one block in the information about a direction of the parameters, above which [`limited_step`] is shorter than the step
/// of the jackknife.
const HIGH_SHARE: f64 = 0.9;
/// Smallest share of the other blocks that counts, so that a direction that only one block determines has a finite step.
const LEAST_REST: f64 = 1e-4;

/// Returns the step of the jackknife without a block, except along directions about which the block has nearly all information.
///
/// Along a direction in which the block has the share h of the information, its gradient has the variance h (1 − h). The step of the
/// jackknife is the gradient divided by 1 − h and has the variance h / (1 − h), without a limit. Divided by √(1 − h) the variance is h
/// (Bell and McCaffrey 2002). Above a share of 0.9 the step grows like that, without a jump.
pub fn limited_step(block: &Contribution, information: &Information) -> DVector<f64> {
    let has_small_shares = (&information.matrix * HIGH_SHARE - &block.information).cholesky().is_some();
    if has_small_shares {
        return jackknife_step(block, information);
    }
    let root = &information.root;
    let shares = (root.tr_mul(&block.information) * root).symmetric_eigen();
    let gradient = shares.eigenvectors.tr_mul(&root.tr_mul(&block.gradient));
    let growth = shares.eigenvalues.map(|share| {
        let rest = (1.0 - share).max(LEAST_REST);
        if share > HIGH_SHARE { 1.0 / ((1.0 - HIGH_SHARE) * rest).sqrt() } else { 1.0 / rest }
    });
    root * (shares.eigenvectors * gradient.component_mul(&growth))
}

/// Returns the ratio of `covariance` to `formal`: the mean over all directions in which the parameters can change, each in units
/// of its own formal σ.
fn inflation(formal: &DMatrix<f64>, covariance: &DMatrix<f64>) -> Option<f64> {
    let count = formal.nrows();
    (count > 0).then_some(())?;
    Some(formal.clone().cholesky()?.solve(covariance).trace() / count as f64)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use evcal_geometry::numerics::random::{normal, uniform_in};

    /// Measurements of two numbers, x and x + y, at 60 times, each repeated `copies` times.
    fn contributions(copies: usize) -> (Vec<(usize, f64)>, Vec<PackedContribution>) {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let variance = 1.0 / 3.0;
        let mut noise: Vec<[f64; 2]> =
            (0..60).map(|_| [uniform_in(&mut rng, -1.0, 1.0), uniform_in(&mut rng, -1.0, 1.0)]).collect();
        // The estimate is the point at which the sum of the gradients is zero.
        let mean = [0, 1].map(|axis| noise.iter().map(|pair| pair[axis]).sum::<f64>() / 60.0);
        noise.iter_mut().for_each(|pair| *pair = [pair[0] - mean[0], pair[1] - mean[1]]);
        let jacobian = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 1.0, 1.0]);
        let all = noise.iter().enumerate().flat_map(|(index, pair)| {
            let one = Contribution {
                gradient: jacobian.transpose() * DVector::from_column_slice(pair) / variance,
                information: jacobian.transpose() * &jacobian / variance,
            };
            vec![((0, index as f64 * 0.1 + 0.01), one.into()); copies]
        });
        all.unzip()
    }

    fn ratio(copies: usize, length: f64) -> f64 {
        let (times, contributions) = contributions(copies);
        let information = PackedContribution::sum(&contributions).unwrap().information;
        let formal = information.try_inverse().unwrap();
        scatter(&formal, sum_by_block(&times, &contributions, length), 2, jackknife_step).unwrap().inflation
    }

    #[test]
    fn independent_observations_are_not_inflated() {
        assert!((ratio(1, 0.1) - 1.0).abs() < 0.2, "{}", ratio(1, 0.1));
    }

    /// The same measurement, copied ten times, counts once.
    #[test]
    fn copied_measurements_count_once() {
        assert!((ratio(10, 0.1) / ratio(1, 0.1) - 10.0).abs() < 1e-9);
    }

    /// A drift from one end of a recording to the other shows in its halves, even with pauses between its pieces.
    #[test]
    fn a_recording_in_pieces_has_halves_too() {
        let one = |value: f64| {
            let gradient = DVector::from_element(1, value);
            PackedContribution::from(Contribution { gradient, information: DMatrix::from_element(1, 1, 1.0) })
        };
        let pieces: Vec<(usize, f64)> =
            (0..40).map(|index| (index / 4, (index / 4) as f64 * 7.0 + (index % 4) as f64 * 0.25)).collect();
        let drift: Vec<PackedContribution> = (0..40).map(|index| one(if index < 20 { -1.0 } else { 1.0 })).collect();
        let halves = sum_by_block(&pieces, &drift, 5.0);
        let gradients: Vec<f64> = halves.map(|half| half.gradient[0]).collect();
        assert_eq!(gradients, [-20.0, 20.0]);
        assert_eq!(sum_by_block(&pieces, &drift, 1.0).count(), 10);
    }

    /// One of eight blocks has 98 % of the information about the second parameter. Independent observations are inflated by less than
    /// (1 + 10) / 2 on average, where 10 follows from the share of 0.9.
    #[test]
    fn a_block_with_most_of_the_information_inflates_little() {
        const RECORDINGS: usize = 300;
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let information: Vec<DVector<f64>> =
            (0..8).map(|block| DVector::from_column_slice(&[1.0, if block == 0 { 343.0 } else { 1.0 }])).collect();
        let total = information.iter().sum::<DVector<f64>>();
        let formal = DMatrix::from_diagonal(&total.map(f64::recip));
        let mut means = [0.0; 2];
        for _ in 0..RECORDINGS {
            let noise = information.iter().map(|one| one.map(|one| one.sqrt() * normal(&mut rng)));
            let gradients: Vec<DVector<f64>> = noise.collect();
            let estimate = gradients.iter().sum::<DVector<f64>>().component_div(&total);
            let block = |(one, gradient): (&DVector<f64>, DVector<f64>)| Contribution {
                gradient: gradient - one.component_mul(&estimate),
                information: DMatrix::from_diagonal(one),
            };
            let blocks: Vec<Contribution> = information.iter().zip(gradients).map(block).collect();
            for (mean, step_without) in means.iter_mut().zip([limited_step, jackknife_step as StepWithout]) {
                *mean += scatter(&formal, blocks.clone(), 2, step_without).unwrap().inflation / RECORDINGS as f64;
            }
        }
        let [limited, jackknife] = means;
        assert!((1.0..6.0).contains(&limited) && jackknife > 15.0, "{limited} {jackknife}");
    }

    #[test]
    fn a_block_that_alone_determines_a_parameter_has_a_finite_effect() {
        let contribution = |value: f64, index: usize| {
            let mut information = DMatrix::zeros(2, 2);
            information[(index, index)] = 4.0;
            let mut gradient = DVector::zeros(2);
            gradient[index] = value;
            Contribution { gradient, information }
        };
        let blocks = [contribution(1.0, 0), contribution(-1.0, 0), contribution(0.0, 1)];
        let formal = DMatrix::from_diagonal(&DVector::from_column_slice(&[1.0 / 8.0, 1.0 / 4.0]));
        for step_without in [jackknife_step, limited_step as StepWithout] {
            let covariance = covariance_of_steps(&formal, blocks.clone(), 2, step_without).unwrap().0;
            assert!(covariance.iter().all(|value| value.is_finite()));
        }
    }
}
