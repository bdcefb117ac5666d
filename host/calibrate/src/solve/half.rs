//! A half of the observations, with its control points eliminated.
//!
//! A half consists of slices of time that alternate with slices of the other half. The trajectory along a slice therefore depends
//! only on the events of that slice, and the control points of each slice are eliminated separately.

use nalgebra::{DMatrix, DVector};

use super::GLOBAL_COUNT;
use super::loss::Loss;
use super::normal::RangeEquations;
use super::observation_range::ObservationRange;
use super::places;
use super::system::{SegmentSystem, TrajectoryPriors};

/// Damping, relative to the diagonal: it keeps a parameter that the half does not determine where it is.
const DAMPING: f64 = 1e-6;

/// The normal equations of the estimated global parameters.
pub struct Half {
    free: Vec<usize>,
    information: DMatrix<f64>,
    right: DVector<f64>,
    /// Loss of the observations.
    pub loss: Loss,
}

/// Step of the estimated global parameters of a half, from their values in the whole.
pub struct SolvedHalf {
    /// Step of all global parameters, zero for fixed ones.
    pub globals: [f64; GLOBAL_COUNT],
    /// Covariance of the estimated parameters, if observations were independent.
    pub formal: DMatrix<f64>,
    /// Decrease of the cost by the step.
    pub decrease: f64,
}

impl Half {
    /// Creates an empty half; `free` are its estimated global parameters.
    pub fn new(free: &[bool; GLOBAL_COUNT]) -> Self {
        let free = places(free);
        let count = free.len();
        Self { free, information: DMatrix::zeros(count, count), right: DVector::zeros(count), loss: Loss::default() }
    }

    /// Adds a slice: the equations of all its intervals, which belong to one segment; `priors` belong to its trajectory.
    /// Returns `None` if they do not determine the trajectory.
    pub fn add_slice(&mut self, slice: &[(ObservationRange, RangeEquations)], priors: &TrajectoryPriors) -> Option<()> {
        let Some(segment) = SegmentSystem::of_ranges(slice, priors) else { return Some(()) };
        let (schur, right) = segment.eliminated(DAMPING, &self.free).ok()?.schur();
        self.information -= schur;
        self.right -= right;
        for (_, equations) in slice {
            for (row, &global) in self.free.iter().enumerate() {
                for (column, &other) in self.free.iter().enumerate() {
                    self.information[(row, column)] += equations.corner[(global.max(other), global.min(other))];
                }
                self.right[row] -= equations.corner_gradient[global];
            }
            self.loss.add(&equations.loss);
        }
        Some(())
    }

    /// Solves the half; `None` if its observations do not determine the parameters.
    pub fn solved(&self) -> Option<SolvedHalf> {
        let mut damped = self.information.clone();
        for place in 0..self.free.len() {
            damped[(place, place)] *= 1.0 + DAMPING;
        }
        let step = damped.cholesky()?.solve(&self.right) * self.loss.lengthening();
        let formal = self.information.clone().cholesky()?.inverse();
        let mut globals = [0.0; GLOBAL_COUNT];
        self.free.iter().zip(step.iter()).for_each(|(&global, value)| globals[global] = *value);
        Some(SolvedHalf { globals, formal, decrease: 0.5 * step.dot(&self.right) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::BOARD_PARAMETERS;
    use crate::solve::bearing_table::BearingTable;
    use crate::solve::levenberg::{assemble, linearised};
    use crate::solve::observation_range::observation_ranges;
    use crate::solve::observation_range::tests::example;
    use crate::trajectory::jerk::jerks;

    /// A half with all observations equals the whole, however they are cut into intervals.
    #[test]
    fn a_half_with_all_observations_has_step_and_covariance_of_the_whole() {
        let (mut problem, state) = example();
        problem.free.intrinsics = std::array::from_fn(|index| index < 2);
        problem.free.board = [false; BOARD_PARAMETERS];
        problem.stiffness = vec![vec![[1e-3, 1e-2]; jerks(&state.trajectories[0]).len()]];
        let free = problem.free.mask();
        let system = assemble(&problem, &state, &observation_ranges(&problem.segments));
        let step = system.step(DAMPING, &free).unwrap();
        let reduced = system.reduced(DAMPING, &free).unwrap();
        let formal = reduced.covariance(&reduced.places(&free)).unwrap();

        let bins = problem.segments[0].bins.len();
        let cut: Vec<ObservationRange> =
            [0..2, 2..5, 5..bins].map(|bins| ObservationRange { segment: 0, bins, points: 0..0 }).into();
        let bearings = BearingTable::new(&state.camera, problem.sensor);
        let priors = TrajectoryPriors::new(&state.trajectories[0], &problem.stiffness[0]);
        let mut half = Half::new(&free);
        half.add_slice(&linearised(&problem, &state, &bearings, &cut), &priors).unwrap();
        let solved = half.solved().unwrap();
        for (global, value) in step.globals.iter().enumerate() {
            let sigma = (0..GLOBAL_COUNT).filter(|&other| free[other]).position(|other| other == global);
            let sigma = sigma.map_or(1.0, |place| formal[(place, place)].sqrt());
            assert!(
                (solved.globals[global] - value).abs() < 1e-3 * sigma,
                "{global}: {} {value}",
                solved.globals[global]
            );
        }
        assert!((&solved.formal - &formal).norm() < 1e-3 * formal.norm());
        assert_eq!(half.loss.count, system.loss.count);
        assert!(solved.decrease > 0.0 && solved.decrease < half.loss.cost);
    }
}
