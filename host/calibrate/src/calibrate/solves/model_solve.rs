//! The joint solve, repeated with another camera model if the events require one.

use super::board_solve::{BoardSolve, solve_with_board};
use crate::quality::better_model;
use crate::quality::misfit::refitted;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::progress::Progress;
use evcal_solve::initial::model_choice::{ModelChoice, ModelRequest};
use evcal_solve::solve::State;
use evcal_solve::solve::refinement::RefinementInput;

/// Solves from `state` on. If the user named no model and the events require another one, solves again with that model. `choice` is
/// the choice of the model from the points, if there was one.
///
/// # Errors
/// [`CalibrateError`].
pub(in crate::calibrate) fn solve_with_model(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    choice: Option<ModelChoice>,
    progress: &Progress,
) -> Result<(BoardSolve, Option<ModelChoice>), CalibrateError> {
    let board = state.board;
    let solved = solve_with_board(task, input, state, progress)?;
    if matches!(task.model(), ModelRequest::Given(_)) {
        return Ok((solved, choice));
    }
    let better = better_model(&solved.refined, solved.certainty.intrinsics.inflation);
    let camera = better.and_then(|kind| refitted(kind, &solved.refined.state.camera, input.sensor));
    let Some((kind, camera)) = better.zip(camera) else { return Ok((solved, choice)) };
    progress.report(format!("joint solve with {kind}"))?;
    let state = State { camera, board, ..solved.refined.into_state() };
    let solved = solve_with_board(task, input, state, progress)?;
    Ok((solved, Some(choice.unwrap_or_else(ModelChoice::usual).instead(kind))))
}
