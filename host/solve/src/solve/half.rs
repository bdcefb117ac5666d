//! A half of the observations, with its control points eliminated.
//!
//! A half consists of slices of time that alternate with slices of the other half. The trajectory along a slice therefore depends
//! only on the events of that slice, and the control points of each slice are eliminated separately.

use nalgebra::{DMatrix, DVector};

use super::GLOBAL_COUNT;
use crate::solve::equations::border::Columns;
use crate::solve::equations::control_band::mean_diagonal;
use crate::solve::equations::normal::Equations;
use crate::solve::equations::smoothness::Acceleration;
use crate::solve::equations::stiffness::add_jerk;
use crate::solve::equations::system::TrajectoryPriors;
use crate::solve::rows::loss::Loss;
use crate::trajectory::jerk::Jerk;

/// Damping, relative to the diagonal: it keeps a parameter that the half does not determine where it is.
const DAMPING: f64 = 1e-6;

/// The normal equations of the estimated global parameters.
pub struct Half {
    /// Their columns in the equations of the slices.
    columns: Vec<usize>,
    /// Their indices among all global parameters.
    globals: Vec<usize>,
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
    /// Creates an empty half; `free` are its estimated global parameters, a part of those that have `columns` in the equations.
    pub fn new(columns: &Columns, free: &[bool; GLOBAL_COUNT]) -> Self {
        let of_half = columns.among(free);
        let count = of_half.len();
        Self {
            columns: of_half,
            globals: super::places(free),
            information: DMatrix::zeros(count, count),
            right: DVector::zeros(count),
            loss: Loss::default(),
        }
    }

    /// Adds a slice: the equations of all its intervals, which belong to one segment; `priors` belong to its trajectory.
    /// Returns `None` if they do not determine the trajectory.
    pub fn add_slice(&mut self, slice: &[Equations], priors: &TrajectoryPriors) -> Option<()> {
        let width = slice.first().map_or(0, |one| one.columns.end);
        let Some(mut band) = Equations::sum_of_bands(&slice.iter().collect::<Vec<_>>(), width).ok()? else {
            return Some(());
        };
        let scale = mean_diagonal(&band.blocks, band.order);
        // Priors that concern only the control points of the slice.
        let (first, end) = (band.first, band.first + band.count());
        let (blocks, gradient) = (&mut band.blocks, &mut band.gradient);
        for acceleration in priors.accelerations.iter().filter(|one| one.first >= first && one.first + 3 <= end) {
            Acceleration { first: acceleration.first - first, ..*acceleration }.add_to(band.order, blocks, gradient);
        }
        if band.order > 3 {
            let jerks = priors.jerks.iter().zip(priors.stiffness);
            for (jerk, weights) in jerks.filter(|(jerk, _)| jerk.first >= first && jerk.first + 4 <= end) {
                add_jerk(&Jerk { first: jerk.first - first, ..*jerk }, *weights, band.order, blocks, gradient);
            }
        }
        band.border = band.border.selected(&self.columns);
        let (schur, right) = band.into_eliminated(DAMPING, scale).ok()?.schur();
        self.information -= schur;
        self.right -= right;
        for equations in slice {
            for (row, &column) in self.columns.iter().enumerate() {
                for (place, &other) in self.columns.iter().enumerate() {
                    self.information[(row, place)] += equations.corner.matrix[(column.max(other), column.min(other))];
                }
                self.right[row] -= equations.corner.gradient[column];
            }
            self.loss.add(&equations.loss);
        }
        Some(())
    }

    /// Solves the half; `None` if its observations do not determine the parameters.
    pub fn solved(&self) -> Option<SolvedHalf> {
        let mut damped = self.information.clone();
        for place in 0..self.columns.len() {
            damped[(place, place)] *= 1.0 + DAMPING;
        }
        let step = damped.cholesky()?.solve(&self.right) * self.loss.lengthening();
        let formal = self.information.clone().cholesky()?.inverse();
        let mut globals = [0.0; GLOBAL_COUNT];
        self.globals.iter().zip(step.iter()).for_each(|(&global, value)| globals[global] = *value);
        Some(SolvedHalf { globals, formal, decrease: 0.5 * step.dot(&self.right) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::BOARD_PARAMETERS;
    use crate::solve::levenberg::{assemble, linearised};
    use crate::solve::observation_range::tests::example;
    use crate::solve::observation_range::{ObservationRange, observation_ranges};
    use crate::solve::rows::bearing_table::BearingTable;
    use crate::trajectory::jerk::jerks;

    /// A half with all observations equals the whole, however they are cut into intervals.
    #[test]
    fn a_half_with_all_observations_has_step_and_covariance_of_the_whole() {
        let (mut problem, state) = example();
        problem.free.intrinsics = std::array::from_fn(|index| index < 2);
        problem.free.board = [false; BOARD_PARAMETERS];
        problem.stiffness = vec![vec![[1e-3, 1e-2]; jerks(&state.trajectories[0]).len()]];
        let free = problem.free.mask();
        let columns = Columns::new(&free);
        let system = assemble(&problem, &state, &observation_ranges(&problem.segments), &columns).unwrap();
        let step = columns.globals(&system.step(DAMPING).unwrap().globals);
        let formal = system.reduced(DAMPING).unwrap().covariance(&columns.among(&free)).unwrap();

        let bins = problem.segments[0].bins.len();
        let cut: Vec<ObservationRange> =
            [0..2, 2..5, 5..bins].map(|bins| ObservationRange { segment: 0, bins, points: 0..0 }).into();
        let bearings = BearingTable::new(&state.camera, problem.sensor);
        let priors = TrajectoryPriors::new(&state.trajectories[0], &problem.stiffness[0]);
        let mut half = Half::new(&columns, &free);
        half.add_slice(&linearised(&problem, &state, &bearings, &cut, &columns).unwrap(), &priors).unwrap();
        let solved = half.solved().unwrap();
        for (global, value) in step.iter().enumerate() {
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
