//! The whole calibration: sections 1 to 11 of method.md in their order.

pub mod beginning;
pub mod calibrated;
mod detected;
mod devices;
mod events;
mod findings;
mod first_model;
mod frames;
pub mod inertia;
pub mod interval_choice;
mod kept_events;
pub mod mounted;
pub mod other_intervals;
mod pictures;
pub mod repeat;
mod saturated;
pub mod second;
mod solves;
pub(crate) mod still_views;

use std::ops::ControlFlow;

use self::calibrated::Calibrated;
use self::still_views::AtRest;
use crate::quality::verdict::Grade;
use crate::task::error::CalibrateError;
use crate::task::input::Input;
use crate::task::progress::Progress;
use crate::task::step::Step;
use crate::task::{PictureUse, Task};
use evcal_detection::detection::still_views::LEAST_TIME;
use evcal_solve::solve::SolveError;

/// Calibrates a camera. `progress` is called with the current step and its progress, and many times with the same step
/// while events are read. If `progress` returns `Break`, the calibration ends as soon as it can: after some tens of
/// thousands of events, or between two iterations of a solve.
///
/// # Errors
/// [`CalibrateError`] names the stage that failed and the remedy.
pub fn calibrate(
    task: &Task,
    mut progress: impl FnMut(Step) -> ControlFlow<()> + Send,
) -> Result<Calibrated, CalibrateError> {
    let progress = Progress::new(task.inputs, &mut progress);
    let calibrated = match task.pictures {
        PictureUse::Only => pictures::calibrate(task, &progress),
        _ if task.inputs.iter().all(Input::has_only_views) => {
            pictures::calibrate(&Task { pictures: PictureUse::Only, ..*task }, &progress)
        }
        _ => calibrate_moved_or_blinking(task, &progress),
    };
    let fixed = task.parameters.fixed_intrinsics.iter().any(Option::is_some);
    calibrated.map_err(|error| match error {
        CalibrateError::Solve(SolveError::NoObservations) if fixed => CalibrateError::FixedFarOff,
        error => error,
    })
}

/// Calibrates from a board that moved, or from one that blinks in front of a camera at rest, depending on the events.
fn calibrate_moved_or_blinking(task: &Task, progress: &Progress) -> Result<Calibrated, CalibrateError> {
    let mut at_rest = None;
    if still_views::begins_at_rest(task) {
        match still_views::calibrate(task, LEAST_TIME, progress)? {
            AtRest::Calibrated(calibrated) => return Ok(*calibrated),
            other => at_rest = Some(other),
        }
    }
    let moved = events::calibrate(task, progress);
    let may_have_blinked = match &moved {
        Ok(calibrated) => calibrated.verdict.grade == Grade::NotGood,
        Err(error) => error.is_explained_by_content(),
    };
    if !may_have_blinked {
        return moved;
    }
    // The recording may contain views of a blinking board although it does not begin with one, because the camera was
    // carried before the first view and between views.
    let at_rest = match at_rest {
        Some(at_rest @ AtRest::WithoutBoard(_)) => Ok(at_rest),
        _ => still_views::calibrate(task, 0.0, progress),
    };
    match (at_rest, moved) {
        (Ok(AtRest::Calibrated(calibrated)), _) => Ok(*calibrated),
        (Err(error @ (CalibrateError::Stopped | CalibrateError::BlinkingWithFrames { .. })), _) => Err(error),
        (Err(error), Err(_)) => Err(error),
        (Ok(AtRest::WithoutBoard(views)), Err(CalibrateError::NoPattern(error))) => {
            Err(CalibrateError::NoPattern(error.at_rest(views)))
        }
        (_, moved) => moved,
    }
}
