//! The first camera, or the reason why it could not be estimated.

use std::fmt::Display;

use evcal_core::sensor::Sensor;

use crate::task::Task;
use crate::task::board_choice::larger_board;
use crate::task::error::CalibrateError;
use crate::task::progress::Progress;
use evcal_core::camera::ModelKind;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::detection::recognition::radius::other_radius;
use evcal_geometry::lens::folds::folds;
use evcal_solve::initial::model_choice::{
    CANDIDATES, ModelChoice, ModelRequest, USUAL, USUAL_CANDIDATES, choose_model,
};
use evcal_solve::initial::{InitialError, InitialModel, initial_model};

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
    model_of(task, frames, sensor, "reference frames", progress).map_err(|error| explained(error, task, frames))
}

/// Computes the first camera from `frames`, which are called `what` in progress messages.
///
/// # Errors
/// [`CalibrateError::Initial`]; [`CalibrateError::Stopped`] if the caller cancelled.
pub(super) fn model_of(
    task: &Task,
    frames: &[ReferenceFrame],
    sensor: Sensor,
    what: impl Copy + Display,
    progress: &Progress,
) -> Result<FirstModel, CalibrateError> {
    progress.report(format!("initial model from {} {what}", frames.len()))?;
    let of = |model: ModelKind| initial_model(frames, task.board, sensor, model, &task.settings.initial);
    match task.model() {
        ModelRequest::Given(model) => Ok(FirstModel { initial: of(model)?, choice: None }),
        ModelRequest::Auto => chosen(task, &CANDIDATES, frames, sensor, what, progress),
        ModelRequest::Usual => match of(USUAL) {
            Ok(initial) if folds(&initial.camera, sensor) => {
                let chosen = chosen(task, &USUAL_CANDIDATES, frames, sensor, what, progress).ok();
                let suits = |chosen: &FirstModel| chosen.choice.as_ref().is_some_and(|choice| !choice.prefers(USUAL));
                Ok(chosen.filter(suits).unwrap_or(FirstModel { initial, choice: None }))
            }
            Err(error) if may_be_wide(&error, frames.len(), of) => {
                chosen(task, &USUAL_CANDIDATES, frames, sensor, what, progress).map_err(|_| error.into())
            }
            usual => Ok(FirstModel { initial: usual?, choice: None }),
        },
    }
}

/// Tries `models` on `frames`, which are called `what` in progress messages.
///
/// # Errors
/// The error of the first candidate, if none has an initial model.
fn chosen(
    task: &Task,
    models: &[ModelKind],
    frames: &[ReferenceFrame],
    sensor: Sensor,
    what: impl Display,
    progress: &Progress,
) -> Result<FirstModel, CalibrateError> {
    // The choice of the model cannot be cancelled. A request to cancel takes effect after it.
    let on_progress = |model| {
        let _ = progress.report(format!("initial model {model} from {} {what}", frames.len()));
    };
    let stage = &task.settings.initial;
    let (initial, choice) = choose_model(frames, task.board, sensor, models, stage, on_progress)?;
    progress.go_on()?;
    Ok(FirstModel { initial, choice: Some(choice) })
}

/// Returns `true` if the usual model may have failed with this `error` because the lens is a fisheye: a model of fisheyes explains
/// most of the frames.
fn may_be_wide(
    error: &InitialError,
    frames: usize,
    of: impl Fn(ModelKind) -> Result<InitialModel, InitialError>,
) -> bool {
    matches!(error, InitialError::TooFewFrames { .. } | InitialError::NoCamera { .. })
        && of(ModelKind::KannalaBrandt).is_ok_and(|initial| 2 * initial.frames.len() > frames)
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
