//! A prior on the change of a trajectory's acceleration, whose strength is estimated from the events.
//!
//! Rotating the camera and moving it sideways look nearly alike. With dense knots, the difference is lost in noise; with sparse
//! knots, the curve cannot follow a jerk. The cost therefore has the term ½ Σ λ τ j² / S over the jerks j of the trajectory (τ
//! their duration; separately for rotation and centre). The curve is then a smoothing spline, or a motion whose jerk is white
//! noise with the spectral density S, and S is the density that the motion itself shows near that time. S follows from the jerks
//! in turn (MacKay 1992): with V the variance of a jerk given events and S, and γ = 1 − V τ / S the share of it that the events
//! determine, S = Σ j² τ / Σ γ over the neighbourhood. λ is the factor by which correlated errors of events reduce their
//! information.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::control_band::Block;
use crate::trajectory::jerk::{Jerk, jerks};
use crate::trajectory::{CONTROL_POINT_PARAMETERS as CONTROL_POINT, Trajectory};
use evcal_geometry::numerics::banded::{BandedCholesky, SymmetricBand};

/// Weights of the squared jerks of a trajectory, rotation and centre, in their order.
pub type Stiffness = Vec<[f64; 2]>;

/// Number of rounds of the estimate of S.
const ROUNDS: usize = 12;
/// Half the length of the neighbourhood in which S is taken as constant (s).
const NEIGHBOURHOOD: f64 = 0.06;
/// Smallest number of jerks that a thread processes at once.
const PIECE: usize = 256;
/// Weight of the whole recording in every neighbourhood, in jerks. Without it, a segment of a tenth of a second can
/// become so stiff that its poses cannot move (seed 801 with vignetting: projection 0.046 px off, 0.020 px reported).
const WHOLE: f64 = 0.05;
/// Smallest S of rotation (rad²/s⁵) and centre (m²/s⁵), for motion calmer than any hand. With it the curve can still bend by 7 µm
/// and 7 µrad in a tenth of a second.
const LEAST_DENSITY: f64 = 1e-4;

/// The quadratic cost of a step of control points: ½ δᵀAδ − rᵀδ.
pub struct Quadratic {
    /// A, not factored.
    pub matrix: BandedCholesky,
    /// r.
    pub right: Vec<f64>,
}

/// Computes the weights of the jerks of each of `trajectories`, and the step of its control points to the least cost with them;
/// the given costs come from the events. Returns `None` for a trajectory whose step the events do not determine.
///
/// All trajectories are of one motion: a single one of a tenth of a second would often show no jerk at all, and would then be
/// fixed to a curve without any.
pub fn weigh_jerks(trajectories: &[(Trajectory, Quadratic)], noise: f64) -> Vec<Option<(Stiffness, Vec<f64>)>> {
    let begin = |(trajectory, cost): &(Trajectory, Quadratic)| {
        let jerks = jerks(trajectory);
        let weights = vec![[0.0; 2]; jerks.len()];
        let (step, inverse) = solved(&jerks, &weights, cost)?;
        Some(Estimate { jerks, weights, step, inverse })
    };
    let mut estimates: Vec<Option<Estimate>> = trajectories.par_iter().map(begin).collect();
    for round in 0..ROUNDS {
        let samples: Vec<Vec<Sample>> = estimates
            .par_iter()
            .map(|estimate| estimate.as_ref().map_or_else(Vec::new, |estimate| estimate.samples(noise, round == 0)))
            .collect();
        let whole = Sums::of(samples.iter().flatten()).densities();
        estimates = estimates
            .into_par_iter()
            .zip(trajectories)
            .zip(&samples)
            .map(|((estimate, (_, cost)), samples)| estimate?.with(&densities(samples, whole), cost, noise))
            .collect();
    }
    estimates.into_iter().map(|estimate| estimate.map(|Estimate { weights, step, .. }| (weights, step))).collect()
}

/// The jerks of a trajectory, their weights, and the step of its control points with these weights.
struct Estimate {
    jerks: Vec<Jerk>,
    weights: Stiffness,
    step: Vec<f64>,
    /// The inverse of the matrix of the step, near its diagonal.
    inverse: SymmetricBand,
}

impl Estimate {
    fn samples(&self, noise: f64, first: bool) -> Vec<Sample> {
        let jerks = self.jerks.par_iter().with_min_len(PIECE).zip(&self.weights);
        jerks.map(|(jerk, weight)| Sample::new(jerk, *weight, &self.step, &self.inverse, noise, first)).collect()
    }

    /// Returns the estimate with these `densities`, one for each jerk.
    fn with(self, densities: &[[f64; 2]], cost: &Quadratic, noise: f64) -> Option<Self> {
        let weights = self.jerks.iter().zip(densities);
        let weights = weights
            .map(|(jerk, density)| density.map(|density| noise * jerk.duration / density.max(LEAST_DENSITY)))
            .collect();
        let (step, inverse) = solved(&self.jerks, &weights, cost)?;
        Some(Self { weights, step, inverse, ..self })
    }
}

/// Adds a jerk with the weights of rotation and centre to the normal equations of a segment whose control points act together in
/// groups of `order`: `blocks` of a control point with itself and those before it, and `gradient`. Returns the added cost.
pub fn add_jerk(
    jerk: &Jerk,
    weights: [f64; 2],
    order: usize,
    blocks: &mut [Block],
    gradient: &mut [[f64; CONTROL_POINT]],
) -> f64 {
    let [rotation, translation] = weights;
    let square = |from: usize| jerk.value.iter().skip(from).take(3).map(|value| value * value).sum::<f64>();
    let cost = 0.5 * (rotation * square(0) + translation * square(3));
    let [x, y, z, moving @ ..] = jerk.value;
    for row in 0..4 {
        let index = jerk.first + row;
        let Some(gradient) = gradient.get_mut(index) else { return cost };
        let turning = jerk.by_rotation[row].transpose() * Vector3::new(x, y, z) * rotation;
        for axis in 0..3 {
            gradient[axis] += turning[axis];
            gradient[3 + axis] += translation * jerk.by_translation[row] * moving[axis];
        }
        for column in 0..=row {
            let Some(block) = blocks.get_mut(index * order + row - column) else { return cost };
            let turns = jerk.by_rotation[row].transpose() * jerk.by_rotation[column] * rotation;
            let mut view = block.fixed_view_mut::<3, 3>(0, 0);
            view += turns;
            let moved = translation * jerk.by_translation[row] * jerk.by_translation[column];
            for axis in 3..CONTROL_POINT {
                block[(axis, axis)] += moved;
            }
        }
    }
    cost
}

/// Contribution of one jerk to the estimate of S, for rotation and centre.
struct Sample {
    t: f64,
    /// j² τ.
    power: [f64; 2],
    /// γ.
    known: [f64; 2],
}

impl Sample {
    fn new(jerk: &Jerk, weight: [f64; 2], step: &[f64], inverse: &SymmetricBand, noise: f64, first: bool) -> Self {
        let mut value = jerk.value;
        let mut variance = [0.0; 2];
        for place in 0..4 {
            let index = CONTROL_POINT * (jerk.first + place);
            let part = step.get(index..index + CONTROL_POINT).unwrap_or(&[0.0; CONTROL_POINT]);
            for row in 0..3 {
                let turned: f64 = (0..3).map(|axis| jerk.by_rotation[place][(row, axis)] * part[axis]).sum();
                value[row] += turned;
                value[3 + row] += jerk.by_translation[place] * part[3 + row];
            }
            for other in 0..4 {
                let other_index = CONTROL_POINT * (jerk.first + other);
                let block = |from: usize| {
                    Matrix3::from_fn(|row, column| inverse.at(index + from + row, other_index + from + column))
                };
                let turns = jerk.by_rotation[place] * block(0) * jerk.by_rotation[other].transpose();
                variance[0] += noise * turns.trace();
                variance[1] += noise * jerk.by_translation[place] * jerk.by_translation[other] * block(3).trace();
            }
        }
        let square = |from: usize| value.iter().skip(from).take(3).map(|value| value * value).sum::<f64>();
        let known = std::array::from_fn(|part| {
            // The weight is λ τ / S, so V τ / S is V times it over λ.
            let unknown = if first { 0.0 } else { variance[part] * weight[part] / (3.0 * noise) };
            3.0 * (1.0 - unknown).clamp(0.0, 1.0)
        });
        Self { t: jerk.t, power: [square(0) * jerk.duration, square(3) * jerk.duration], known }
    }
}

/// Sums over samples, for rotation and centre.
#[derive(Clone, Copy, Default)]
struct Sums {
    power: [f64; 2],
    known: [f64; 2],
}

impl Sums {
    fn of<'a>(samples: impl IntoIterator<Item = &'a Sample>) -> Self {
        samples.into_iter().fold(Self::default(), |mut sums, sample| {
            for part in 0..2 {
                sums.power[part] += sample.power[part];
                sums.known[part] += sample.known[part];
            }
            sums
        })
    }

    /// Returns S; zero if the events do not determine it.
    fn densities(self) -> [f64; 2] {
        std::array::from_fn(|part| if self.known[part] > 0.0 { self.power[part] / self.known[part] } else { 0.0 })
    }
}

/// Returns S at each sample of a trajectory, given the mean `whole` of the recording.
fn densities(samples: &[Sample], whole: [f64; 2]) -> Vec<[f64; 2]> {
    samples
        .par_iter()
        .with_min_len(PIECE)
        .map(|sample| {
            let first = samples.partition_point(|other| other.t < sample.t - NEIGHBOURHOOD);
            let end = samples.partition_point(|other| other.t <= sample.t + NEIGHBOURHOOD);
            let near = Sums::of(samples.get(first..end).unwrap_or_default());
            std::array::from_fn(|part| (near.power[part] + WHOLE * whole[part]) / (near.known[part] + WHOLE))
        })
        .collect()
}

/// Computes the step to the least cost with weighted jerks, and the inverse of the matrix near its diagonal.
fn solved(jerks: &[Jerk], weights: &Stiffness, cost: &Quadratic) -> Option<(Vec<f64>, SymmetricBand)> {
    let (mut matrix, mut step) = (cost.matrix.clone(), cost.right.clone());
    for (jerk, [rotation, translation]) in jerks.iter().zip(weights) {
        for place in 0..4 {
            let index = CONTROL_POINT * (jerk.first + place);
            for axis in 0..3 {
                let turned: f64 = (0..3).map(|row| jerk.by_rotation[place][(row, axis)] * jerk.value[row]).sum();
                *step.get_mut(index + axis)? -= rotation * turned;
                *step.get_mut(index + 3 + axis)? -= translation * jerk.by_translation[place] * jerk.value[3 + axis];
            }
            for other in 0..=place {
                let other_index = CONTROL_POINT * (jerk.first + other);
                let turns = jerk.by_rotation[place].transpose() * jerk.by_rotation[other] * *rotation;
                for row in 0..3 {
                    let last = if place == other { row } else { 2 };
                    for column in 0..=last {
                        matrix.add(index + row, other_index + column, turns[(row, column)]);
                    }
                    let moved = translation * jerk.by_translation[place] * jerk.by_translation[other];
                    matrix.add(index + 3 + row, other_index + 3 + row, moved);
                }
            }
        }
    }
    matrix.factor().ok()?;
    matrix.solve_in_place(&mut step);
    let inverse = matrix.inverse_band();
    Some((step, inverse))
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::trajectory::RotationControl;
    use crate::trajectory::knots::greville;

    const SPAN: f64 = 0.01;

    /// A trajectory with this number of knot spans, whose centre at time t is at `place(t)` and which does not rotate, and events
    /// that support no step.
    fn curve(spans: usize, place: impl Fn(f64) -> f64) -> (Trajectory, Quadratic) {
        let inner = (0..=spans).map(|knot| knot as f64 * SPAN);
        let end = spans as f64 * SPAN;
        let knots: Vec<f64> = [0.0; 3].into_iter().chain(inner).chain([end; 3]).collect();
        let translation: Vec<_> = greville(&knots, 3).iter().map(|&t| Vector3::new(place(t), 0.0, 1.0)).collect();
        let rotation = RotationControl::So3(vec![UnitQuaternion::identity(); translation.len()]);
        let dimension = CONTROL_POINT * translation.len();
        let mut matrix = BandedCholesky::zeros(dimension, 4 * CONTROL_POINT - 1);
        (0..dimension).for_each(|row| matrix.add(row, row, 1e9));
        let trajectory = Trajectory { recording: 0, knots, degree: 3, translation, rotation };
        (trajectory, Quadratic { matrix, right: vec![0.0; dimension] })
    }

    /// Returns the largest weight of the jerks of the centre, for each trajectory.
    fn largest(curves: &[(Trajectory, Quadratic)]) -> Vec<f64> {
        let found = weigh_jerks(curves, 1.0).into_iter().map(Option::unwrap);
        found.map(|(weights, _)| weights.iter().map(|[_, centre]| *centre).fold(0.0, f64::max)).collect()
    }

    /// A tenth of a second without a jerk does not determine the motion of the camera. Alone, its jerks would get
    /// unbounded weights, which would fix its poses, and the camera with them.
    #[test]
    fn a_short_trajectory_is_as_stiff_as_the_motion_around_it() {
        let shaken = || curve(300, |t| 0.05 * (20.0 * t).sin());
        let both = largest(&[shaken(), curve(10, |t| 0.3 * t)]);
        let alone = largest(&[shaken()]);
        assert!((both[0] / alone[0] - 1.0).abs() < 0.2, "{both:?} {alone:?}");
        assert!(both[1] < 1e3 * both[0], "{both:?}");
    }

    #[test]
    fn weights_of_jerks_are_bounded_by_the_calmest_motion() {
        let found = largest(&[curve(10, |t| 0.3 * t)]);
        assert!(found[0] <= SPAN / LEAST_DENSITY * 1.001, "{found:?}");
    }
}
