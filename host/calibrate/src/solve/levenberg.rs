//! Levenberg-Marquardt over all parameters.

use std::ops::ControlFlow;

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::bearing_table::BearingTable;
use super::lens_step::{ObservedPixel, observed_pixels, stepped};
use super::normal::RangeEquations;
use super::observation_range::{ObservationRange, RANGES_TOGETHER, linearise, observation_ranges};
use super::smoothness::{Acceleration, accelerations};
use super::system::System;
use super::{BOARD_INDEX, GLOBAL_COUNT, Problem, SolveError, SolveReport, State, bias_index};
use crate::solve::event_bias::CLASS_COUNT;
use crate::solve::event_bias::bias::Bias;
use crate::trajectory::jerk::jerks;
use evcal_geometry::board::shape::BoardShape;

/// Damping of the first step of a solve that starts far from its minimum.
pub const FIRST_DAMPING: f64 = 1e-6;
const SMALLEST_DAMPING: f64 = 1e-10;
const LARGEST_DAMPING: f64 = 1e8;
/// Iterations end when the cost falls by less than this share.
const TOLERANCE: f64 = 1e-5;
/// A step that is predicted to lower the cost by less than this share is accepted without evaluating the cost: so near the
/// minimum the prediction is reliable.
pub const TRUSTED: f64 = 8.0 * TOLERANCE;
/// Cost of an observation that leaves the camera model's domain, in units of the mean cost of an observation, so that the loss of
/// observations does not make a step look good.
const COST_OUTSIDE_DOMAIN: f64 = 10.0;

/// Damping at the start of a solve, and the condition for its end.
#[derive(Clone, Copy)]
pub struct Limits {
    /// Damping of the first step.
    pub damping: f64,
    /// A step that is predicted to lower the cost by less than this share is the last, and the cost after it is not evaluated.
    pub trusted: f64,
}

/// A solved problem.
pub struct Solved {
    /// The solution.
    pub state: State,
    /// Statistics of the solve.
    pub report: SolveReport,
    /// Damping of a further step.
    pub damping: f64,
}

/// Minimises the cost of `problem`, starting at `state`.
///
/// # Errors
/// [`SolveError`] if there are no observations, or if they do not determine the parameters.
pub fn solve(problem: &Problem, state: State) -> Result<Solved, SolveError> {
    let limits = Limits { damping: FIRST_DAMPING, trusted: TRUSTED };
    solve_with_progress(problem, state, limits, &mut |_| ControlFlow::Continue(()))
}

/// Does the same as [`solve`], with other limits and a progress callback. After each iteration but the last,
/// `on_progress` gets the progress from 0 to 1 and may end the solve; the result is then the state reached so far.
///
/// # Errors
/// As [`solve`].
pub fn solve_with_progress(
    problem: &Problem,
    mut state: State,
    limits: Limits,
    on_progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Solved, SolveError> {
    let ranges = observation_ranges(&problem.segments);
    let free = problem.free.mask();
    let observed = observed_pixels(&problem.segments, problem.sensor);
    let mut system = assemble(problem, &state, &ranges);
    if system.loss.count == 0 {
        return Err(SolveError::NoObservations);
    }
    let mut report = SolveReport {
        observations: system.loss.count,
        initial_cost: system.cost,
        final_cost: system.cost,
        ..SolveReport::default()
    };
    let mut damping = limits.damping;
    let mut done = 0.0_f64;
    let mut was_rejected = false;
    for _ in 0..problem.iterations {
        if report.iterations > 0 {
            done = done.max(report.iterations as f64 / problem.iterations as f64);
            if on_progress(done).is_break() {
                break;
            }
        }
        report.iterations += 1;
        let (cost, count) = (system.cost, system.loss.count);
        let step = match system.step(damping, &free) {
            Ok(step) => step,
            Err(_) if damping < LARGEST_DAMPING => {
                damping *= 100.0;
                continue;
            }
            Err(_) => return Err(SolveError::Singular),
        };
        let Some(trial) = moved(&state, &step.segments, &step.globals, &observed) else {
            damping *= 10.0;
            continue;
        };
        if step.predicted < limits.trusted * cost {
            if !was_rejected {
                (state, report.final_cost) = (trial, cost - step.predicted);
            }
            break;
        }
        let next = assemble(problem, &trial, &ranges);
        let cost_outside = COST_OUTSIDE_DOMAIN * cost / count as f64 * count.saturating_sub(next.loss.count) as f64;
        if next.cost + cost_outside >= cost {
            report.rejected += 1;
            was_rejected = true;
            if damping > LARGEST_DAMPING {
                break;
            }
            damping = (damping * 30.0).max(1e-4);
            continue;
        }
        let decrease = (cost - next.cost) / cost;
        (state, system, was_rejected) = (trial, next, false);
        report.final_cost = system.cost;
        damping = (damping * 0.1).max(SMALLEST_DAMPING);
        if decrease < TOLERANCE {
            break;
        }
        done = done.max(settled(decrease, TOLERANCE));
    }
    Ok(Solved { state, report, damping })
}

/// Returns the progress of a solve, 0 to 1, when an iteration lowered the cost by the share `decrease`. The decreases get smaller
/// from iteration to iteration, and the first one below `tolerance` is the last.
fn settled(decrease: f64, tolerance: f64) -> f64 {
    let share = decrease.ln() / tolerance.ln();
    if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 }
}

/// Expands `matrix`, which has rows and columns only for estimated global parameters, to the first `count` global parameters; rows
/// and columns of fixed parameters are zero. `matrix` needs no rows for parameters after these.
pub fn intrinsics_of(matrix: &DMatrix<f64>, free: &[bool; GLOBAL_COUNT], count: usize) -> DMatrix<f64> {
    let mut part = DMatrix::zeros(count, count);
    let places = || (0..GLOBAL_COUNT).filter(|&global| free[global]).enumerate().filter(|(_, global)| *global < count);
    for (row, to_row) in places() {
        for (column, to_column) in places() {
            part[(to_row, to_column)] = matrix[(row, column)];
        }
    }
    part
}

/// Returns the normal equations of all observations of `problem` at `state` and of the trajectory priors; `ranges` are the
/// intervals into which the observations are divided.
pub fn assemble(problem: &Problem, state: &State, ranges: &[ObservationRange]) -> System {
    let control_points: Vec<usize> = state.trajectories.iter().map(|t| t.control_point_count()).collect();
    let bearings = BearingTable::new(&state.camera, problem.sensor);
    let mut system = System::new(&control_points);
    for group in ranges.chunks(RANGES_TOGETHER) {
        system.add(&linearised(problem, state, &bearings, group));
    }
    system.close();
    let smoothness: Vec<Vec<Acceleration>> = state.trajectories.iter().map(accelerations).collect();
    system.add_smoothness(&smoothness);
    for (segment, (trajectory, weights)) in state.trajectories.iter().zip(&problem.stiffness).enumerate() {
        system.add_jerks(segment, &jerks(trajectory), weights);
    }
    system
}

/// Returns the normal equations of each of `ranges` at `state`; `bearings` belong to the state's camera.
pub fn linearised(
    problem: &Problem,
    state: &State,
    bearings: &BearingTable,
    ranges: &[ObservationRange],
) -> Vec<(ObservationRange, RangeEquations)> {
    ranges.par_iter().map(|range| (range.clone(), linearise(problem, state, bearings, range))).collect()
}

/// Returns `state` moved by a step; `observed` are the pixels whose bearings the step of the intrinsics changes linearly. Returns `None`
/// if the camera model rejects the parameters.
pub fn moved(state: &State, segments: &[Vec<f64>], globals: &[f64], observed: &[ObservedPixel]) -> Option<State> {
    let camera = stepped(&state.camera, globals, observed)?;
    let mut board = state.board.parameters();
    board.iter_mut().zip(globals.get(BOARD_INDEX..)?).for_each(|(parameter, step)| *parameter += step);
    let board = BoardShape::from_parameters(board);
    (board.print_ratio > 0.0 && board.radius > 0.0).then_some(())?;
    let mut bias = state.bias;
    for (class, bias) in bias.iter_mut().enumerate().take(CLASS_COUNT) {
        for which in Bias::ALL {
            bias.biases[which] += globals.get(bias_index(class, which))?;
        }
    }
    let mut trajectories = state.trajectories.clone();
    for (trajectory, step) in trajectories.iter_mut().zip(segments) {
        trajectory.update(step);
    }
    Some(State { camera, board, bias, trajectories })
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::{Camera, MAX_PARAMETERS};

    use super::*;
    use crate::solve::BOARD_PARAMETERS;
    use crate::solve::observation_range::tests::example;

    /// A problem whose focal lengths are estimated, and a state with wrong focal lengths.
    fn displaced() -> (Problem, State) {
        let (mut problem, state) = example();
        problem.free.intrinsics = std::array::from_fn::<_, MAX_PARAMETERS, _>(|index| index < 2);
        problem.free.board = [false; BOARD_PARAMETERS];
        let mut parameters = state.camera.parameters().to_vec();
        (parameters[0], parameters[1]) = (parameters[0] + 6.0, parameters[1] - 4.0);
        let camera = Camera::from_parameters(state.camera.kind(), &parameters).unwrap();
        (problem, State { camera, ..state })
    }

    #[test]
    fn a_solve_reports_its_progress_and_can_be_cancelled() {
        let (problem, state) = displaced();
        let mut reported = Vec::new();
        let limits = Limits { damping: FIRST_DAMPING, trusted: TRUSTED };
        let whole = solve_with_progress(&problem, state.clone(), limits, &mut |done| {
            reported.push(done);
            ControlFlow::Continue(())
        });
        let whole = whole.unwrap().report;
        assert!(whole.final_cost < 0.9 * whole.initial_cost, "{whole:?}");
        assert_eq!(reported.len() + 1, whole.iterations);
        assert!(
            reported.len() > 1 && reported.is_sorted() && reported[0] > 0.0 && reported[reported.len() - 1] <= 1.0,
            "{reported:?}"
        );
        let ended = solve_with_progress(&problem, state, limits, &mut |_| ControlFlow::Break(())).unwrap().report;
        assert!(ended.iterations == 1 && ended.final_cost > whole.final_cost, "{ended:?}");
    }

    #[test]
    fn progress_is_complete_once_the_decrease_reaches_the_tolerance() {
        assert_eq!(settled(1e-5, 1e-5), 1.0);
        assert!((settled(1e-2, 1e-4) - 0.5).abs() < 1e-12);
        assert!(settled(0.5, 1e-5) < 0.1);
        for tolerance in [0.0, 1.0] {
            assert_eq!(settled(0.5, tolerance), 0.0);
        }
    }
}
