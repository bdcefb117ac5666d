//! The whole calibration: sections 1 to 11 of method.md in their order.

pub mod beginning;
pub mod board_choice;
mod board_solve;
pub mod calibrated;
mod detected;
pub mod error;
mod events;
mod examination;
mod first_model;
mod frames;
mod health;
pub mod inertia;
pub mod input;
mod joint_solve;
mod kept_events;
mod model_solve;
pub mod mounted;
mod other_camera;
pub mod other_stretches;
pub mod parameter_request;
mod picture_solve;
mod pictures;
mod progress;
pub mod repeat;
mod saturated;
pub mod second;
pub mod step;
pub(crate) mod still_views;
pub mod stretch_choice;
mod unseen_rows;
mod unstated_rows;

use std::ops::ControlFlow;
use std::sync::LazyLock;

use evcal_core::camera::ModelKind;
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
use crate::initial::model_choice::ModelRequest;
use crate::settings::Settings;
use crate::solve::SolveError;
use evcal_geometry::board::Board;

/// What the camera's own pictures are for, where the recordings have them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PictureUse {
    /// They are calibrated apart, and compared with the events.
    #[default]
    Witness,
    /// They are compared, then pictures and events are solved together.
    Joint,
    /// They are compared, then taken for those of a second camera.
    SecondCamera,
    /// The camera is calibrated from them alone.
    Only,
    /// Nothing.
    Ignore,
}

/// What is calibrated, from what.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// Recordings of one camera.
    pub inputs: &'a [Input],
    /// The board in front of it.
    pub board: &'a Board,
    /// The camera model wanted.
    pub model: ModelRequest,
    /// Sensor size where the recordings do not tell it.
    pub sensor: Option<Sensor>,
    /// What pictures are for.
    pub pictures: PictureUse,
    /// Parameters of lens and board that are held, or free in any case. Those of the lens count for the joint solve from events.
    pub parameters: ParameterRequests,
    /// Thresholds.
    pub settings: &'a Settings,
    /// The command line, for the report; may be empty.
    pub command_line: &'a str,
    /// How advice is worded in what is written of the calibration.
    pub wording: Wording,
    /// Who reads the recordings and looks for the board; `None`: the workers of whoever calls.
    pub readers: Option<&'a ThreadPool>,
}

/// The settings of a [`Task`] that says nothing of them.
static DEFAULTS: LazyLock<Settings> = LazyLock::new(Settings::default);

impl<'a> Task<'a> {
    /// A radtan camera from these inputs with the default settings; the fields are for all else:
    /// `Task { model: ModelRequest::Auto, ..Task::new(&inputs, &board) }`.
    pub fn new(inputs: &'a [Input], board: &'a Board) -> Self {
        Self {
            inputs,
            board,
            model: ModelRequest::Given(ModelKind::Radtan),
            sensor: None,
            pictures: PictureUse::default(),
            parameters: ParameterRequests::default(),
            settings: &DEFAULTS,
            command_line: "",
            wording: advice::plain,
            readers: None,
        }
    }
}

/// Calibrates a camera. `progress` is told what is going on: the same words many times while events are read, with how
/// far that is. When it breaks, the calibration ends as soon as it can, which is within the reading of a few ten thousand events or else
/// between two iterations of a solve.
///
/// # Errors
/// [`CalibrateError`] says which stage found nothing to go on with, and what to do.
pub fn calibrate(
    task: &Task,
    mut progress: impl FnMut(Step) -> ControlFlow<()> + Send,
) -> Result<Calibrated, CalibrateError> {
    let progress = Progress::new(task.inputs, &mut progress);
    let calibrated = match task.pictures {
        PictureUse::Witness | PictureUse::Ignore => calibrate_moved_or_blinking(task, &progress),
        PictureUse::Joint | PictureUse::SecondCamera => events::calibrate(task, &progress),
        PictureUse::Only => pictures::calibrate(task, &progress),
    };
    let held = task.parameters.fixed_intrinsics.iter().any(Option::is_some);
    calibrated.map_err(|error| match error {
        CalibrateError::Solve(SolveError::NoObservations) if held => CalibrateError::HeldFarOff,
        error => error,
    })
}

/// Calibrates from a board that moved, or from one that blinks before a camera at rest, whichever the events show.
fn calibrate_moved_or_blinking(task: &Task, progress: &Progress) -> Result<Calibrated, CalibrateError> {
    let mut at_rest = None;
    if still_views::begins_at_rest(task) {
        match still_views::calibrate(task, progress)? {
            AtRest::Calibrated(calibrated) => return Ok(*calibrated),
            other => at_rest = Some(other),
        }
    }
    events::calibrate(task, progress).or_else(|error| {
        if !error.is_of_what_was_seen() {
            return Err(error);
        }
        // The camera may have been carried about before it was put down.
        let at_rest = at_rest.map_or_else(|| still_views::calibrate(task, progress), Ok)?;
        match (at_rest, error) {
            (AtRest::Calibrated(calibrated), _) => Ok(*calibrated),
            (AtRest::WithoutBoard(views), CalibrateError::NoPattern(error)) => {
                Err(CalibrateError::NoPattern(error.at_rest(views)))
            }
            (_, error) => Err(error),
        }
    })
}
