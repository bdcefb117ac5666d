//! Inputs and options of a calibration, its progress and its errors.

pub mod board_choice;
pub mod error;
pub mod input;
pub mod parameter_request;
pub(crate) mod progress;
pub mod step;

use std::sync::LazyLock;

use evcal_core::sensor::Sensor;
use rayon::ThreadPool;

use self::input::Input;
use self::parameter_request::ParameterRequests;
use crate::quality::verdict::Finding;
use crate::settings::Settings;
use evcal_files::remedy::Words;
use evcal_geometry::board::Board;
use evcal_solve::initial::model_choice::{ModelRequest, USUAL};

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
    /// A difference between the stated board and the recordings (see
    /// [`confirm_board`](board_choice::confirm_board)), for the verdict.
    pub board_finding: Option<&'a Finding>,
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
    /// The words in which the result gives advice.
    pub words: &'a Words,
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
            board_finding: None,
            model: ModelRequest::default(),
            sensor: None,
            pictures: PictureUse::default(),
            parameters: ParameterRequests::default(),
            settings: &DEFAULTS,
            command_line: "",
            words: &Words::LIBRARY,
            readers: None,
        }
    }

    /// Returns the requested model. Requests for parameters of the lens are requests for the usual model, because other models have
    /// other parameters.
    pub(crate) fn model(&self) -> ModelRequest {
        match self.model {
            ModelRequest::Usual if self.parameters.has_intrinsics() => ModelRequest::Given(USUAL),
            model => model,
        }
    }
}
