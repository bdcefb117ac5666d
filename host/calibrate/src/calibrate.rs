//! The whole calibration: sections 1 to 11 of method.md in their order.

pub mod beginning;
pub mod board_choice;
mod board_solve;
pub mod calibrated;
mod changed;
mod detected;
mod devices;
pub mod error;
mod events;
mod examination;
mod first_model;
mod frames;
mod health;
pub mod inertia;
pub mod input;
pub mod interval_choice;
mod joint_solve;
mod kept_events;
mod model_solve;
pub mod mounted;
mod orientation;
mod other_camera;
pub mod other_intervals;
pub mod parameter_request;
mod picture_solve;
mod pictures;
mod progress;
pub mod repeat;
mod saturated;
pub mod second;
pub mod step;
pub(crate) mod still_views;
mod unseen_rows;
mod unstated_rows;

use std::ops::ControlFlow;
use std::sync::LazyLock;

use evcal_core::sensor::Sensor;
use rayon::ThreadPool;

use self::calibrated::Calibrated;
use self::error::CalibrateError;
use self::parameter_request::ParameterRequests;
use self::progress::Progress;
use self::step::Step;
use self::still_views::AtRest;
use crate::advice::{self, Wording};
use crate::calibrate::input::Input;
use crate::quality::verdict::Grade;
use crate::settings::Settings;
use evcal_detection::detection::still_views::LEAST_TIME;
use evcal_geometry::board::Board;
use evcal_solve::initial::model_choice::{ModelRequest, USUAL};
use evcal_solve::solve::SolveError;

/// Use of the camera's own pictures, if the recordings contain any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PictureUse {
    /// They are calibrated separately, and compared with the events.
    #[default]
    CrossCheck,
    /// They are compared with the events, then pictures and events are solved together.
    Joint,
    /// They are compared with the events, then used as the pictures of a second camera.
    SecondCamera,
    /// The camera is calibrated from pictures alone.
    Only,
    /// They are not used.
    Ignore,
}

/// Input and options of a calibration.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// Recordings of one camera.
    pub inputs: &'a [Input],
    /// The board in front of it.
    pub board: &'a Board,
    /// The camera model wanted.
    pub model: ModelRequest,
    /// Sensor size, for recordings that do not contain it.
    pub sensor: Option<Sensor>,
    /// Use of the camera's own pictures.
    pub pictures: PictureUse,
    /// Parameters of lens and board that are fixed, or estimated in any case. Requests for lens parameters affect only
    /// the joint solve from events.
    pub parameters: ParameterRequests,
    /// Settings of all stages.
    pub settings: &'a Settings,
    /// The command line, for the report; may be empty.
    pub command_line: &'a str,
    /// Wording of the advice in the result.
    pub wording: Wording,
    /// Threads that read the recordings and search for the board; `None` for the threads of the caller.
    pub readers: Option<&'a ThreadPool>,
}

/// The default settings of a [`Task`].
static DEFAULTS: LazyLock<Settings> = LazyLock::new(Settings::default);

impl<'a> Task<'a> {
    /// Creates a task for a camera of the usual model from these inputs with the default settings. Other fields are set as in
    /// `Task { model: ModelRequest::Auto, ..Task::new(&inputs, &board) }`.
    pub fn new(inputs: &'a [Input], board: &'a Board) -> Self {
        Self {
            inputs,
            board,
            model: ModelRequest::default(),
            sensor: None,
            pictures: PictureUse::default(),
            parameters: ParameterRequests::default(),
            settings: &DEFAULTS,
            command_line: "",
            wording: advice::plain,
            readers: None,
        }
    }

    /// Returns the requested model. Requests for parameters of the lens are requests for the usual model, because other models have
    /// other parameters.
    fn model(&self) -> ModelRequest {
        match self.model {
            ModelRequest::Usual if self.parameters.has_intrinsics() => ModelRequest::Given(USUAL),
            model => model,
        }
    }
}

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
