//! The first camera, or the reason why it could not be estimated.

use evcal_core::sensor::Sensor;

use super::Task;
use super::board_choice::larger_board;
use super::error::CalibrateError;
use super::progress::Progress;
use crate::circles::reference_frame::ReferenceFrame;
use crate::detection::radius::other_radius;
use crate::initial::model_choice::{CANDIDATES, ModelChoice, ModelRequest, choose_model};
use crate::initial::{InitialModel, initial_model};

/// The first camera, with the poses of the frames.
pub(super) struct FirstModel {
    pub(super) initial: InitialModel,
    /// Statistics of the choice of its model, if it was automatic.
    pub(super) choice: Option<ModelChoice>,
}

/// Computes the first camera, of the requested model or of the one that suits the recording best.
///
/// # Errors
/// [`CalibrateError`] with a more specific cause if the frames show one; [`CalibrateError::Stopped`] if the caller
/// cancelled.
pub(super) fn first_model(
    task: &Task,
    frames: &[ReferenceFrame],
    sensor: Sensor,
    progress: &Progress,
) -> Result<FirstModel, CalibrateError> {
    of_model(task, frames, sensor, progress).map_err(|error| explained(error, task, frames))
}

fn of_model(
    task: &Task,
    frames: &[ReferenceFrame],
    sensor: Sensor,
    progress: &Progress,
) -> Result<FirstModel, CalibrateError> {
    let settings = task.settings;
    progress.report(format!("initial model from {} reference frames", frames.len()))?;
    match task.model {
        ModelRequest::Given(model) => {
            let initial = initial_model(frames, task.board, sensor, model, &settings.initial)?;
            Ok(FirstModel { initial, choice: None })
        }
        ModelRequest::Auto => {
            // The choice of the model cannot be cancelled. A request to cancel takes effect after it.
            let on_progress = |model| {
                let _ = progress.report(format!("initial model {model} from {} reference frames", frames.len()));
            };
            let (initial, choice) =
                choose_model(frames, task.board, sensor, &CANDIDATES, &settings.initial, on_progress)?;
            progress.go_on()?;
            Ok(FirstModel { initial, choice: Some(choice) })
        }
    }
}

/// Returns a more specific reason than `error`, if the frames show one.
fn explained(error: CalibrateError, task: &Task, frames: &[ReferenceFrame]) -> CalibrateError {
    if !matches!(error, CalibrateError::Initial(_)) {
        return error;
    }
    let Some(board) = task.board.circles() else { return error };
    // A wrong radius prevents the confirmation of circles, whatever other cause there is.
    match other_radius(frames, board) {
        Some(other) => CalibrateError::OtherRadius(other),
        None => larger_board(task.inputs, board, &task.settings.detection)
            .map_or(error, |larger| CalibrateError::LargerBoard(Box::new(larger))),
    }
}
