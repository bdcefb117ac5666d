//! How much a trajectory's acceleration may change, from the events themselves.
//!
//! Turning the camera and moving it sideways look nearly alike, and what tells them apart is lost in noise when
//! knots are dense; when they are sparse, the curve cannot follow a jerk. The cost therefore has the term
//! ½ Σ λ τ j² / S over the jerks j of the trajectory (τ their duration; apart for rotation and centre): the curve is
//! that of a smoothing spline, or of a motion whose jerk is white noise with the spectral density S, which is what
//! the motion itself shows near that time. S follows from the jerks in turn (MacKay 1992): with V the
//! variance of a jerk given events and S, and γ = 1 − V τ / S the share of it that the events know, S = Σ j² τ / Σ γ over
//! the neighbourhood. λ is by how much errors of events in common make their information smaller than it seems.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::normal::Block;
use crate::numerics::banded::{BandedCholesky, SymmetricBand};
use crate::trajectory::jerk::{Jerk, jerks};
use crate::trajectory::{CONTROL_POINT_PARAMETERS as CONTROL_POINT, Trajectory};

/// Weights of the squared jerks of a trajectory, rotation and centre, in their order.
pub type Stiffness = Vec<[f64; 2]>;

/// Rounds of the estimate of S.
const ROUNDS: usize = 12;
/// Half the neighbourhood in which the motion is of one kind (s).
const NEIGHBOURHOOD: f64 = 0.06;
/// Jerks that a thread looks at in a go, at least.
const PIECE: usize = 256;
/// Part that the whole trajectory has in every neighbourhood, in jerks.
const WHOLE: f64 = 0.05;

/// The quadratic cost of a step of control points: ½ δᵀAδ − rᵀδ.
pub struct Quadratic {
    /// A, not factored.
    pub matrix: BandedCholesky,
    /// r.
    pub right: Vec<f64>,
}

/// What the jerks of `trajectory` weigh, and the step of its control points to the least cost with them; `cost` is what
/// the events say. `None` when the events do not determine the step.
pub fn stiffness(trajectory: &Trajectory, cost: &Quadratic, noise: f64) -> Option<(Stiffness, Vec<f64>)> {
    let jerks = jerks(trajectory);
    let mut weights: Stiffness = vec![[0.0; 2]; jerks.len()];
    let (mut step, mut inverse) = solved(&jerks, &weights, cost)?;
    let mut first = true;
    for _ in 0..ROUNDS {
        let samples: Vec<Sample> = jerks
            .par_iter()
            .with_min_len(PIECE)
            .zip(&weights)
            .map(|(jerk, weight)| Sample::new(jerk, *weight, &step, &inverse, noise, first))
            .collect();
        first = false;
        let densities = densities(&samples);
        for ((weight, jerk), density) in weights.iter_mut().zip(&jerks).zip(densities) {
            *weight = density.map(|density| noise * jerk.duration / density.max(f64::MIN_POSITIVE));
        }
        (step, inverse) = solved(&jerks, &weights, cost)?;
    }
    Some((weights, step))
}

/// Adds a jerk with the weights of rotation and centre to the normal equations of a segment, of whose control points `order` act
/// together: `blocks` of a control point with itself and those before it, and `gradient`. What it adds to the cost.
pub fn add_jerk(
    (jerk, [rotation, translation]): (&Jerk, [f64; 2]),
    order: usize,
    blocks: &mut [Block],
    gradient: &mut [[f64; CONTROL_POINT]],
) -> f64 {
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

/// What one jerk says of S, for rotation and centre.
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
                let beside = CONTROL_POINT * (jerk.first + other);
                let block = |from: usize| {
                    Matrix3::from_fn(|row, column| inverse.at(index + from + row, beside + from + column))
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

/// S at each sample.
fn densities(samples: &[Sample]) -> Vec<[f64; 2]> {
    let ratio = |power: f64, known: f64| if known > 0.0 { power / known } else { 0.0 };
    let sums = |samples: &[Sample]| {
        samples.iter().fold([[0.0; 2]; 2], |mut sums, sample| {
            for (sums, (power, known)) in sums.iter_mut().zip(sample.power.iter().zip(sample.known)) {
                sums[0] += power;
                sums[1] += known;
            }
            sums
        })
    };
    let whole = sums(samples).map(|[power, known]| ratio(power, known));
    samples
        .par_iter()
        .with_min_len(PIECE)
        .map(|sample| {
            let first = samples.partition_point(|other| other.t < sample.t - NEIGHBOURHOOD);
            let end = samples.partition_point(|other| other.t <= sample.t + NEIGHBOURHOOD);
            let near = sums(samples.get(first..end).unwrap_or_default());
            std::array::from_fn(|part| (near[part][0] + WHOLE * whole[part]) / (near[part][1] + WHOLE))
        })
        .collect()
}

/// The step to the least cost with weighted jerks, and the inverse of the matrix near its diagonal.
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
                let beside = CONTROL_POINT * (jerk.first + other);
                let turns = jerk.by_rotation[place].transpose() * jerk.by_rotation[other] * *rotation;
                for row in 0..3 {
                    let last = if place == other { row } else { 2 };
                    for column in 0..=last {
                        matrix.add(index + row, beside + column, turns[(row, column)]);
                    }
                    let moved = translation * jerk.by_translation[place] * jerk.by_translation[other];
                    matrix.add(index + 3 + row, beside + 3 + row, moved);
                }
            }
        }
    }
    matrix.factor().ok()?;
    matrix.solve_in_place(&mut step);
    let inverse = matrix.inverse_band();
    Some((step, inverse))
}
