//! The joint solve with the nominal board, then with the board's estimated shape, and then with those coefficients of the lens
//! fixed that the observations do not determine.

use evcal_core::camera::Camera;
use nalgebra::DVector;

use super::fixed_values::contradicted;
use super::joint_solve::{certainty, refined as refined_from, solve, with};
use crate::quality::board_evidence::{BoardEstimate, BoardEvidence};
use crate::quality::misfit::lens_explains_more;
use crate::quality::residual_map::residual_map;
use crate::quality::uncertainty::SolveUncertainty;
use crate::quality::uncertainty::projection::projection_uncertainty;
use crate::quality::verdict::Finding;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::progress::Progress;
use evcal_geometry::board::shape::{BoardShape, PARAMETERS};
use evcal_geometry::lens::distortion_prior::distortion_prior;
use evcal_geometry::lens::fixed::with_fixed;
use evcal_solve::solve::State;
use evcal_solve::solve::refinement::{Refined, RefinementInput};

/// Largest number of solves in which parameters of the board are added or removed.
const MOST_CHANGES: usize = 3;

/// A radial distortion coefficient is fixed at its expected value if it agrees with that value and its σ is more than this share
/// of the variation between lenses.
const UNDETERMINED: f64 = 0.25;

/// Number of σ below which a coefficient does not differ significantly from its expected value.
const SIGNIFICANT: f64 = 2.0;

/// Coefficients are fixed only if the residuals grow by less than this factor.
const WORSE: f64 = 1.001;

/// A joint solve with the board in it.
pub(in crate::calibrate) struct BoardSolve {
    pub(in crate::calibrate) refined: Refined,
    pub(in crate::calibrate) certainty: SolveUncertainty,
    pub(in crate::calibrate) board: BoardEstimate,
    /// Result with the nominal board, if the board differs.
    pub(in crate::calibrate) with_nominal_board: Option<(Camera<f64>, SolveUncertainty)>,
    /// Indices of the coefficients that the observations do not determine and that were fixed at their expected values.
    pub(in crate::calibrate) undetermined: Vec<usize>,
    /// Findings on values that the user fixed.
    pub(in crate::calibrate) fixed_values: Vec<Finding>,
}

/// Solves from `state` on, with the parameters fixed or estimated as the task requires. Parameters of the board are estimated if
/// the observations require it.
///
/// # Errors
/// [`CalibrateError`].
pub(in crate::calibrate) fn solve_with_board(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    progress: &Progress,
) -> Result<BoardSolve, CalibrateError> {
    let requests = &task.parameters;
    let nominal = shape_with(&BoardShape::nominal(task.board).parameters(), &requests.fixed_board);
    let camera = with_fixed(&state.camera, &requests.fixed_intrinsics, input.sensor)
        .filter(|_| nominal.is_possible(task.board))
        .ok_or(CalibrateError::ImpossibleValues)?;
    let fixed = requests.fixed_intrinsics.map(|value| value.is_some());
    let mut free = requests.free_board;
    let state = State { camera, board: nominal, ..state };
    let (mut refined, mut certainty) = solve(task, &with(input, free, fixed), state, progress)?;
    let mut with_nominal_board = None;
    for _ in 0..MOST_CHANGES {
        let Some(evidence) = certainty.board else { break };
        let estimated = parameters_to_estimate(task, &nominal, &evidence);
        let shape = shape_of(&nominal, &evidence, estimated);
        if estimated == free || !shape.is_possible(task.board) {
            break;
        }
        if free == [false; PARAMETERS] && lens_is_to_blame(&refined, &certainty, shape, estimated) {
            break;
        }
        progress.report("joint solve with the board's shape")?;
        let before = refined.state.camera;
        let state = State { board: shape, ..refined.into_state() };
        let (with_shape, certainty_with_shape) = solve(task, &with(input, estimated, fixed), state, progress)?;
        with_nominal_board = with_nominal_board.or(Some((before, certainty)));
        (refined, certainty, free) = (with_shape, certainty_with_shape, estimated);
    }
    let mut undetermined = undetermined(task, &refined, &certainty);
    if !undetermined.is_empty() {
        let with_fixed = hold(task, with(input, free, fixed), &refined, &undetermined, progress)?;
        // If the residuals grew, the coefficients were determined after all, in combination.
        if with_fixed.0.residuals.rms < WORSE * refined.residuals.rms {
            (refined, certainty) = with_fixed;
        } else {
            undetermined.clear();
        }
    }
    let bound = projection_uncertainty(&refined.state.camera, &certainty.intrinsics.covariance, input.sensor)
        .map_or(0.0, |projection| projection.rms_95);
    let fixed_values = contradicted(task, &with(input, free, fixed), refined.state.clone(), bound, progress)?;
    let camera = with_nominal_board.as_ref().map(|(camera, _)| *camera);
    let board = BoardEstimate::new(&refined, certainty.board_sigma, certainty.board, camera);
    Ok(BoardSolve { refined, certainty, board, with_nominal_board, undetermined, fixed_values })
}

/// Returns the parameters of the board that are to be estimated: those that the user requests, and those that the observations
/// require, without those that the user fixed.
fn parameters_to_estimate(task: &Task, nominal: &BoardShape, evidence: &BoardEvidence) -> [bool; PARAMETERS] {
    let by_evidence = evidence.supported_parameters(nominal, task.board);
    let requests = &task.parameters;
    std::array::from_fn(|index| {
        let may_be_estimated = task.settings.board.estimate && requests.fixed_board[index].is_none();
        requests.free_board[index] || (may_be_estimated && by_evidence[index])
    })
}

/// Returns the shape with these parameters, replaced by those `values` that are given.
fn shape_with(parameters: &[f64; PARAMETERS], values: &[Option<f64>; PARAMETERS]) -> BoardShape {
    BoardShape::from_parameters(std::array::from_fn(|index| values[index].unwrap_or(parameters[index])))
}

/// Returns the nominal shape, with the `estimated` parameters replaced by the values of the evidence.
fn shape_of(nominal: &BoardShape, evidence: &BoardEvidence, estimated: [bool; PARAMETERS]) -> BoardShape {
    let values = std::array::from_fn(|index| estimated[index].then_some(evidence.values[index]));
    shape_with(&nominal.parameters(), &values)
}

/// Returns `true` if the residuals are systematic over the image because the lens model cannot follow the lens, rather than
/// because of the board. The board would have this `shape` with the `estimated` parameters part of the solve.
fn lens_is_to_blame(
    refined: &Refined,
    certainty: &SolveUncertainty,
    shape: BoardShape,
    estimated: [bool; PARAMETERS],
) -> bool {
    let (problem, state) = (&refined.problem, &refined.state);
    let pattern = residual_map(problem, state, &refined.events).pattern;
    pattern.is_suspicious() && lens_explains_more(problem, state, shape, estimated, certainty.intrinsics.inflation)
}

/// Returns the coefficients whose σ is more than [`UNDETERMINED`] times the variation between lenses and that do not differ
/// significantly from their expected values, one after the other: with one of them fixed, the others are better determined, and
/// some no longer need to be fixed.
fn undetermined(task: &Task, refined: &Refined, certainty: &SolveUncertainty) -> Vec<usize> {
    let camera = &refined.state.camera;
    let prior = distortion_prior(camera, refined.problem.sensor);
    let mut values = DVector::from_vec(camera.parameters().to_vec());
    let mut covariance = certainty.intrinsics.covariance.clone();
    let mut undetermined = Vec::new();
    loop {
        let distance = |index: usize| {
            let sigma = covariance[(index, index)].max(0.0).sqrt();
            let is_open = prior.sigma(index).is_some_and(|expected| sigma > UNDETERMINED * expected);
            let distance = (values[index] - prior.expected[index]).abs() / sigma;
            (is_open && distance < SIGNIFICANT).then_some((index, distance))
        };
        let is_free = |index: &usize| {
            refined.problem.free.intrinsics[*index]
                && !task.parameters.free_intrinsics[*index]
                && !undetermined.contains(index)
        };
        let nearest = (4..values.len()).filter(is_free).filter_map(distance).min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((index, _)) = nearest else { return undetermined };
        // The values of the others if this one has its expected value.
        let follows = covariance.column(index) / covariance[(index, index)];
        values.axpy(prior.expected[index] - values[index], &follows, 1.0);
        let row = covariance.row(index).clone_owned();
        covariance -= follows * row;
        undetermined.push(index);
    }
}

/// Solves again with the `undetermined` coefficients fixed at their expected values. The reported uncertainty still comes from
/// the solve in which they were estimated.
fn hold(
    task: &Task,
    mut input: RefinementInput<CalibrateError>,
    refined: &Refined,
    undetermined: &[usize],
    progress: &Progress,
) -> Result<(Refined, SolveUncertainty), CalibrateError> {
    let state = refined.state.clone();
    let expected = distortion_prior(&state.camera, input.sensor).expected;
    let mut values = task.parameters.fixed_intrinsics;
    for &index in undetermined {
        values[index] = Some(expected[index]);
        input.fixed[index] = true;
    }
    let camera = with_fixed(&state.camera, &values, input.sensor).ok_or(CalibrateError::ImpossibleValues)?;
    progress.report("joint solve with undetermined parameters fixed")?;
    let mut refined = refined_from(task, &input, State { camera, ..state }, progress)?;
    progress.report("uncertainty")?;
    for &index in undetermined {
        refined.problem.free.intrinsics[index] = true;
    }
    let certainty = certainty(&refined)?;
    Ok((refined, certainty))
}
