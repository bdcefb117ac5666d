//! Levenberg-Marquardt over all parameters.

use std::ops::ControlFlow;

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::BOARD_INDEX;
use super::GLOBAL_COUNT;
use super::ITERATIONS;
use super::Problem;
use super::SolveError;
use super::SolveReport;
use super::State;
use super::bias_index;
use super::lens_step::{ObservedPixel, observed_pixels, stepped};
use super::observation_range::{ObservationRange, RANGES_TOGETHER, linearise, observation_ranges};
use crate::solve::equations::border::Columns;
use crate::solve::equations::normal::Equations;
use crate::solve::equations::system::{Step, System};
use crate::solve::rows::bearing_table::BearingTable;
use crate::solve::rows::event_bias::CLASS_COUNT;
use crate::solve::rows::event_bias::bias::Bias;
use evcal_geometry::board::shape::BoardShape;

/// Cost of an observation that leaves a camera model's domain or the trajectories, in units of the mean cost of an observation, so
/// that the loss of observations does not make a step look good.
const COST_OUTSIDE_DOMAIN: f64 = 10.0;

/// The dampings and the end of a minimisation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// Damping of the first step.
    pub first: f64,
    /// Smallest damping.
    pub smallest: f64,
    /// Largest damping.
    pub largest: f64,
    /// Smallest damping after a step that raised the cost.
    pub after_rejection: f64,
    /// The end is reached when the cost falls by less than this share.
    pub share: f64,
    /// A step that is predicted to lower the cost by less than this share is the last, and the cost after it is not evaluated: so near
    /// the minimum the prediction is reliable.
    pub trusted: f64,
    /// The end is also reached when the cost falls, or is predicted to fall, by less than this.
    pub least: f64,
    /// Largest number of iterations.
    pub iterations: usize,
}

/// Schedule of a camera, which starts far from its minimum.
pub const OF_CAMERA: Schedule = Schedule {
    first: 1e-6,
    smallest: 1e-10,
    largest: 1e8,
    after_rejection: 1e-4,
    share: 1e-5,
    trusted: 8e-5,
    least: 0.0,
    iterations: ITERATIONS,
};

/// Schedule of what is mounted to a calibrated camera, which starts near its minimum. A decrease of the cost of 0.02 is a step of 0.2 σ
/// of independent observations.
pub const OF_MOUNTED: Schedule = Schedule {
    first: 1e-9,
    smallest: 1e-9,
    largest: 1e4,
    after_rejection: 1e-5,
    share: 0.0,
    trusted: 0.0,
    least: 0.02,
    iterations: 15,
};

/// The minimum of a cost.
pub struct Solved<E> {
    /// The parameters there.
    pub estimate: E,
    /// The equations, before the last step if its cost was not evaluated.
    pub system: System,
    /// Statistics.
    pub report: SolveReport,
    /// Damping of a further step.
    pub damping: f64,
}

/// Minimises a cost by Levenberg-Marquardt, from an `estimate` and its equations `system`. `moved` returns the estimate after a step; `None` if
/// the step is impossible. `linearised` gets the number of the iteration, an estimate, the equations before it and the step that led
/// there; it returns the equations at the estimate. After each iteration but the last, `on_progress` gets the progress from 0 to 1 and
/// may end the minimisation; the result is then the estimate reached so far.
///
/// # Errors
/// Errors of `linearised`, and [`SolveError::Singular`] if the equations do not determine a step.
pub fn minimise<E>(
    schedule: &Schedule,
    mut estimate: E,
    mut system: System,
    moved: impl Fn(&E, &Step) -> Option<E>,
    mut linearised: impl FnMut(usize, &E, (&System, &Step)) -> Result<System, SolveError>,
    on_progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Solved<E>, SolveError> {
    let mut report = SolveReport {
        observations: system.loss.count,
        initial_cost: system.cost,
        final_cost: system.cost,
        ..SolveReport::default()
    };
    let mut damping = schedule.first;
    let mut done = 0.0_f64;
    let mut was_rejected = false;
    for iteration in 0..schedule.iterations {
        if iteration > 0 {
            done = done.max(iteration as f64 / schedule.iterations as f64);
            if on_progress(done).is_break() {
                break;
            }
        }
        report.iterations += 1;
        let (cost, count) = (system.cost, system.loss.count);
        let step = match system.step(damping) {
            Ok(step) => step,
            Err(_) if damping < schedule.largest => {
                damping *= 100.0;
                continue;
            }
            Err(error) => return Err(error),
        };
        let Some(trial) = moved(&estimate, &step) else {
            damping *= 10.0;
            continue;
        };
        if step.predicted < schedule.trusted * cost {
            if !was_rejected {
                (estimate, report.final_cost) = (trial, cost - step.predicted);
            }
            break;
        }
        if step.predicted < schedule.least {
            break;
        }
        let next = linearised(iteration, &trial, (&system, &step))?;
        let lost = count.saturating_sub(next.loss.count);
        let cost_outside = COST_OUTSIDE_DOMAIN * cost / count.max(1) as f64 * lost as f64;
        if next.cost + cost_outside >= cost {
            report.rejected += 1;
            was_rejected = true;
            if damping > schedule.largest {
                break;
            }
            damping = (damping * 30.0).max(schedule.after_rejection);
            continue;
        }
        let decrease = cost - next.cost;
        report.final_cost = next.cost;
        (estimate, system, was_rejected) = (trial, next, false);
        damping = (damping * 0.1).max(schedule.smallest);
        if decrease / cost < schedule.share || decrease < schedule.least {
            break;
        }
        done = done.max(settled(decrease / cost, schedule.share));
    }
    Ok(Solved { estimate, system, report, damping })
}

/// Minimises the cost of `problem`, starting at `state`.
///
/// # Errors
/// [`SolveError`] if there are no observations, or if they do not determine the parameters.
pub fn solve(problem: &Problem, state: State) -> Result<Solved<State>, SolveError> {
    solve_with_progress(problem, state, OF_CAMERA, &mut |_| ControlFlow::Continue(()))
}

/// Does the same as [`solve`], with another schedule, whose number of iterations is the problem's, and with the progress callback of
/// [`minimise`].
///
/// # Errors
/// As [`solve`].
pub fn solve_with_progress(
    problem: &Problem,
    state: State,
    schedule: Schedule,
    on_progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Solved<State>, SolveError> {
    let schedule = Schedule { iterations: problem.iterations, ..schedule };
    let ranges = observation_ranges(&problem.segments);
    let columns = Columns::new(&problem.free.mask());
    let observed = observed_pixels(&problem.segments, problem.sensor);
    let system = assemble(problem, &state, &ranges, &columns)?;
    if system.loss.count == 0 {
        return Err(SolveError::NoObservations);
    }
    let stepped = |state: &State, step: &Step| moved(state, &step.segments, &columns.globals(&step.globals), &observed);
    let linearised = |_, state: &State, _: (&System, &Step)| assemble(problem, state, &ranges, &columns);
    minimise(&schedule, state, system, stepped, linearised, on_progress)
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

/// Returns the normal equations of all observations of `problem` at `state` and of the trajectory priors, with a border of
/// `columns`; `ranges` are the intervals into which the observations are divided.
///
/// # Errors
/// [`SolveError::OutOfBand`] if observations and trajectories do not fit together.
pub fn assemble(
    problem: &Problem,
    state: &State,
    ranges: &[ObservationRange],
    columns: &Columns,
) -> Result<System, SolveError> {
    let control_points: Vec<usize> = state.trajectories.iter().map(|t| t.control_point_count()).collect();
    let bearings = BearingTable::new(&state.camera, problem.sensor);
    let mut system = System::new(&control_points, columns.width());
    for group in ranges.chunks(RANGES_TOGETHER) {
        system.add(&linearised(problem, state, &bearings, group, columns)?)?;
    }
    system.close(&state.trajectories, &problem.stiffness);
    Ok(system)
}

/// Returns the normal equations of each of `ranges` at `state`; `bearings` belong to the state's camera.
///
/// # Errors
/// [`SolveError::OutOfBand`] if observations and trajectories do not fit together.
pub fn linearised(
    problem: &Problem,
    state: &State,
    bearings: &BearingTable,
    ranges: &[ObservationRange],
    columns: &Columns,
) -> Result<Vec<Equations>, SolveError> {
    ranges.par_iter().map(|range| linearise(problem, state, bearings, range, columns)).collect()
}

/// Linearises all events of `problem` at `state`, piece by piece.
///
/// # Errors
/// [`SolveError::OutOfBand`] if observations and trajectories do not fit together.
pub fn pieces(problem: &Problem, state: &State, columns: &Columns) -> Result<Vec<Equations>, SolveError> {
    let bearings = BearingTable::new(&state.camera, problem.sensor);
    linearised(problem, state, &bearings, &observation_ranges(&problem.segments), columns)
}

/// Returns `state`, whose estimated parameters have `columns`, after a `step`; `None` if the camera model rejects the parameters.
pub fn after(problem: &Problem, state: &State, columns: &Columns, step: &Step) -> Option<State> {
    let observed = observed_pixels(&problem.segments, problem.sensor);
    moved(state, &step.segments, &columns.globals(&step.globals), &observed)
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
        let whole = solve_with_progress(&problem, state.clone(), OF_CAMERA, &mut |done| {
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
        let ended = solve_with_progress(&problem, state, OF_CAMERA, &mut |_| ControlFlow::Break(())).unwrap().report;
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
