//! The joint solve with the board as it is stated, then as the observations say it is; and with those coefficients of the lens held
//! that they do not determine.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use nalgebra::DVector;

use super::Task;
use super::error::CalibrateError;
use super::joint_solve::{certainty, refined as refined_from, solve};
use super::progress::Progress;
use crate::solve::State;
use crate::solve::refinement::{EventInput, Refined, RefinementInput};
use crate::trust::board_evidence::{BoardEstimate, BoardEvidence};
use crate::trust::misfit::lens_explains_more;
use crate::trust::residual_map::residual_map;
use crate::trust::uncertainty::SolveUncertainty;
use evcal_geometry::board::shape::{BoardShape, PARAMETERS};
use evcal_geometry::lens::distortion_prior::distortion_prior;
use evcal_geometry::lens::held::with_held;

/// Most solves in which parameters of the board join or leave.
const MOST_CHANGES: usize = 3;

/// A radial distortion coefficient is held at its expected value if it agrees with that value and its σ is more than this share of
/// how much lenses of all kinds differ.
const UNDETERMINED: f64 = 0.25;

/// A coefficient nearer to what is expected of it than this many of its σ cannot be told from that.
const TOLD_FROM_EXPECTED: f64 = 2.0;

/// Coefficients are held only if the residuals do not become so many times as large by it.
const WORSE: f64 = 1.001;

/// A joint solve, and the board in it.
pub(super) struct BoardSolve {
    pub(super) refined: Refined,
    pub(super) certainty: SolveUncertainty,
    pub(super) board: BoardEstimate,
    /// What came out with the board as it is stated, where it is not.
    pub(super) as_stated: Option<(Camera<f64>, SolveUncertainty)>,
    /// Coefficients that the observations do not determine and that were held at what is expected of them, by their index.
    pub(super) undetermined: Vec<usize>,
}

/// Solves from `state` on, with what the task asks to be held or free; what the observations ask of the board is estimated.
///
/// # Errors
/// [`CalibrateError`].
pub(super) fn solve_with_board(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    progress: &Progress,
) -> Result<BoardSolve, CalibrateError> {
    let requests = &task.parameters;
    let stated = shape_with(&BoardShape::stated(task.board).parameters(), &requests.fixed_board);
    let camera = with_held(&state.camera, &requests.fixed_intrinsics, input.sensor)
        .filter(|_| stated.is_possible(task.board))
        .ok_or(CalibrateError::ImpossibleValues)?;
    let held = requests.fixed_intrinsics.map(|value| value.is_some());
    let mut free = requests.free_board;
    let state = State { camera, board: stated, ..state };
    let (mut refined, mut certainty) = solve(task, &with(input, free, held), state, progress)?;
    let mut as_stated = None;
    for _ in 0..MOST_CHANGES {
        let Some(evidence) = certainty.board else { break };
        let asked = asked(task, &stated, &evidence);
        let shape = shape_of(&stated, &evidence, asked);
        if asked == free || !shape.is_possible(task.board) {
            break;
        }
        if free == [false; PARAMETERS] && lens_is_to_blame(&refined, &certainty, shape, asked) {
            break;
        }
        progress.tell("joint solve with the board's shape")?;
        let before = refined.state.camera;
        let state = State { board: shape, ..refined.state };
        let (with_shape, certainty_with_shape) = solve(task, &with(input, asked, held), state, progress)?;
        as_stated = as_stated.or(Some((before, certainty)));
        (refined, certainty, free) = (with_shape, certainty_with_shape, asked);
    }
    let mut undetermined = undetermined(task, &refined, &certainty);
    if !undetermined.is_empty() {
        let with_held = hold(task, with(input, free, held), &refined, &undetermined, progress)?;
        // If it is worse they were determined after all, together.
        if with_held.0.residuals.rms < WORSE * refined.residuals.rms {
            (refined, certainty) = with_held;
        } else {
            undetermined.clear();
        }
    }
    let camera = as_stated.as_ref().map(|(camera, _)| *camera);
    let board = BoardEstimate::new(&refined, certainty.board_sigma, certainty.board, camera);
    Ok(BoardSolve { refined, certainty, board, as_stated, undetermined })
}

/// `input` with these parameters of the board free and these intrinsics held.
fn with<'a>(
    input: &RefinementInput<'a, CalibrateError>,
    free_board: [bool; PARAMETERS],
    held: [bool; MAX_PARAMETERS],
) -> RefinementInput<'a, CalibrateError> {
    let events = input.events.as_ref().map(|events| EventInput { ..*events });
    RefinementInput { free_board, held, points: input.points.clone(), events, ..*input }
}

/// The parameters of the board that are to be estimated: those that the user wants, and those that the observations ask for, but
/// for those that the user holds.
fn asked(task: &Task, stated: &BoardShape, evidence: &BoardEvidence) -> [bool; PARAMETERS] {
    let by_evidence = evidence.asks_for(stated, task.board);
    let requests = &task.parameters;
    std::array::from_fn(|index| {
        let estimated = task.settings.board.estimate && requests.fixed_board[index].is_none();
        requests.free_board[index] || (estimated && by_evidence[index])
    })
}

/// The shape with these parameters, but for those that have another value.
fn shape_with(parameters: &[f64; PARAMETERS], values: &[Option<f64>; PARAMETERS]) -> BoardShape {
    BoardShape::from_parameters(std::array::from_fn(|index| values[index].unwrap_or(parameters[index])))
}

/// The stated shape with those parameters of the evidence that are `asked` for.
fn shape_of(stated: &BoardShape, evidence: &BoardEvidence, asked: [bool; PARAMETERS]) -> BoardShape {
    let values = std::array::from_fn(|index| asked[index].then_some(evidence.values[index]));
    shape_with(&stated.parameters(), &values)
}

/// Whether the residuals stay in the same places of the image because the lens model cannot follow the lens, rather than because
/// of the board, which would have this `shape` with the `asked` parameters free.
fn lens_is_to_blame(
    refined: &Refined,
    certainty: &SolveUncertainty,
    shape: BoardShape,
    asked: [bool; PARAMETERS],
) -> bool {
    let (problem, state) = (&refined.problem, &refined.state);
    let pattern = residual_map(problem, state, &refined.events).pattern;
    pattern.is_suspicious() && lens_explains_more(problem, state, shape, asked, certainty.intrinsics.inflation)
}

/// Coefficients whose σ leaves open what is expected of any lens, and that cannot be told from that, one after the other: with one
/// of them held, the others are known better, and are not left open any more where they only stood in for it.
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
            (is_open && distance < TOLD_FROM_EXPECTED).then_some((index, distance))
        };
        let is_free = |index: &usize| {
            refined.problem.free.intrinsics[*index]
                && !task.parameters.free_intrinsics[*index]
                && !undetermined.contains(index)
        };
        let nearest = (4..values.len()).filter(is_free).filter_map(distance).min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((index, _)) = nearest else { return undetermined };
        // What the others are when this one is as expected.
        let follows = covariance.column(index) / covariance[(index, index)];
        values.axpy(prior.expected[index] - values[index], &follows, 1.0);
        let row = covariance.row(index).clone_owned();
        covariance -= follows * row;
        undetermined.push(index);
    }
}

/// Solves again with the `undetermined` coefficients at what is expected of them. They count as free in what is stated of the
/// uncertainty: what they leave open stays open.
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
        input.held[index] = true;
    }
    let camera = with_held(&state.camera, &values, input.sensor).ok_or(CalibrateError::ImpossibleValues)?;
    progress.tell("joint solve without what is not determined")?;
    let (mut refined, system) = refined_from(task, &input, State { camera, ..state }, progress)?;
    progress.tell("uncertainty")?;
    for &index in undetermined {
        refined.problem.free.intrinsics[index] = true;
    }
    let certainty = certainty(&refined, system)?;
    Ok((refined, certainty))
}
