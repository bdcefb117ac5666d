//! The whole calibration: stages 1 to 11 in their order.

mod detected;
pub mod error;
mod frames;
pub mod input;
pub mod repeat;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use serde::Serialize;

use self::detected::{Detected, detect_all};
use self::error::CalibrateError;
use crate::board::Board;
use crate::calibrate::input::{Input, read_events};
use crate::circles::reference_frame::ReferenceFrame;
use crate::detection::DetectionReport;
use crate::initial::model_choice::{CANDIDATES, ModelChoice, ModelRequest, choose_model};
use crate::initial::{InitialModel, InitialReport, initial_model};
use crate::picture_calibration::joint::{JointPoints, JointReport};
use crate::recording::RecordingError;
use crate::recording::pass::RecordingReport;
use crate::settings::Settings;
use crate::solve::State;
use crate::solve::event_bias::unknown;
use crate::solve::refinement::{Refined, RefinementInput, RoundReport, StageSettings, refine};
use crate::trajectory::first::{FirstTrajectories, first_trajectories};
use crate::trajectory::segment::SegmentReport;
use crate::trust::uncertainty::uncertainty;
use crate::trust::verdict::{Verdict, verdict};
use crate::trust::witness::FrameOutcome;
use crate::trust::{Trust, examine};

pub use self::frames::calibrate_from_frames;

/// What the camera's own frames are for, where the recordings have them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrameUse {
    /// They are calibrated apart, and compared with the events.
    #[default]
    Witness,
    /// They are compared, then frames and events are solved together.
    Joint,
    /// Nothing.
    Ignore,
}

/// What is calibrated, from what.
pub struct Task<'a> {
    /// Recordings of one camera.
    pub inputs: &'a [Input],
    /// The board in front of it.
    pub board: &'a Board,
    /// The camera model wanted.
    pub model: ModelRequest,
    /// Sensor size where the recordings do not tell it.
    pub sensor: Option<Sensor>,
    /// What frames are for.
    pub frames: FrameUse,
    /// Thresholds.
    pub settings: &'a Settings,
    /// The command line, for the report; may be empty.
    pub command_line: &'a str,
}

/// A calibrated camera and how it came about.
pub struct Calibrated {
    /// Sensor size in pixels.
    pub sensor: Sensor,
    /// Camera, event biases and trajectories.
    pub refined: Refined,
    /// The model that the joint solve started from.
    pub initial: InitialModel,
    /// All reference frames found, also those that fell away later.
    pub frames: Vec<ReferenceFrame>,
    /// For each input the time of its first event or circle in the file (s).
    pub starts: Vec<f64>,
    /// What the camera's own frames say of it; `None` where the recordings have none.
    pub witness: Option<FrameOutcome>,
    /// How frames and events were solved together, if they were.
    pub joint: Option<JointReport>,
    /// Stage reports.
    pub reports: StageReports,
    /// How sure the result is, and what speaks for it.
    pub trust: Trust,
    /// Whether it is good.
    pub verdict: Verdict,
}

/// What every stage took in and gave out.
#[derive(Clone, Debug, Serialize)]
pub struct StageReports {
    /// What each recording held.
    pub recordings: Vec<RecordingReport>,
    /// Stages 2 to 5.
    pub detection: DetectionReport,
    /// Stages 6 and 7.
    pub initial: InitialReport,
    /// How the camera model was chosen, where that was left to the program.
    pub model_choice: Option<ModelChoice>,
    /// Stage 8.
    pub segments: SegmentReport,
    /// Segments whose spline could not be fitted.
    pub segments_without_spline: usize,
    /// Stages 10 and 11, one entry a round.
    pub rounds: Vec<RoundReport>,
}

/// Calibrates a camera. `progress` is told what is going on, in words.
///
/// # Errors
/// [`CalibrateError`] says which stage found nothing to go on with, and what to do.
pub fn calibrate(task: &Task, mut progress: impl FnMut(&str)) -> Result<Calibrated, CalibrateError> {
    let settings = task.settings;
    let Detected { sensor, frames, starts, recordings, detection, events } = detect_all(task, &mut progress)?;
    progress(&format!("initial model from {} reference frames", frames.len()));
    let (initial, model_choice) = match task.model {
        ModelRequest::Given(model) => (initial_model(&frames, task.board, sensor, model, &settings.initial)?, None),
        ModelRequest::Auto => {
            let (stage, choice) = (&settings.initial, &settings.model_choice);
            let told = |model| progress(&format!("initial model {model} from {} reference frames", frames.len()));
            let (initial, choice) = choose_model(&frames, task.board, sensor, &CANDIDATES, stage, choice, told)?;
            (initial, Some(choice))
        }
    };

    let from_frames = match task.frames {
        FrameUse::Ignore => None,
        FrameUse::Witness | FrameUse::Joint => {
            let seen = frames::see_frames(task, Some(&starts), &mut progress)?;
            frames::frame_calibration(task, seen, sensor, initial.camera.kind(), &mut progress)
        }
    };
    let to_join = match task.frames {
        FrameUse::Joint => Some(frames::needed(task, from_frames.as_ref())?),
        FrameUse::Ignore | FrameUse::Witness => None,
    };

    progress("trajectory");
    let FirstTrajectories { trajectories, points, segments, without_spline } =
        first_trajectories(&initial, &frames, settings)?;

    let read = |index: usize, visit: &mut dyn FnMut(&[Event])| read_events(task.inputs, index, visit).map(|_| ());
    let input = RefinementInput {
        board: task.board,
        sensor,
        recordings: task.inputs.len(),
        events,
        read: &read,
        points,
        point_sigma: initial.report.rms.max(0.02),
    };
    let stage =
        StageSettings { refinement: &settings.refinement, association: &settings.association, solve: &settings.solve };
    let solved = |input: &RefinementInput<RecordingError>, state: State, progress: &mut dyn FnMut(&str)| {
        refine(input, state, stage, |round| progress(&format!("joint solve, round {}", round + 1)))
    };
    let state = State { camera: initial.camera, bias: unknown(settings.refinement.first_sigma), trajectories };
    let mut refined = solved(&input, state, &mut progress)?;

    let certainty = |refined: &Refined| {
        uncertainty(&refined.problem, &refined.state, &settings.uncertainty).map_err(CalibrateError::Solve)
    };
    let mut uncertainty = certainty(&refined)?;
    let witness = from_frames
        .as_ref()
        .map(|calibration| frames::outcome(task, &refined.state.camera, &uncertainty, sensor, calibration));
    let mut joint = None;
    if let Some(calibration) = to_join {
        let JointPoints { points, report } = frames::observations(task, &refined, &uncertainty, calibration)?;
        let input = RefinementInput { points, point_sigma: report.sigma, ..input };
        refined = solved(&input, refined.state, &mut progress)?;
        uncertainty = certainty(&refined)?;
        joint = Some(report);
    }
    progress("examination");
    let trust = examine(&refined, uncertainty, task.board, settings).map_err(CalibrateError::Solve)?;
    let reports = StageReports {
        recordings,
        detection,
        initial: initial.report.clone(),
        model_choice,
        segments,
        segments_without_spline: without_spline,
        rounds: refined.rounds.clone(),
    };
    let findings = witness.as_ref().and_then(FrameOutcome::finding).into_iter().collect();
    let verdict = verdict(&refined.state.camera, &trust, task.board, sensor, findings, &settings.verdict);
    Ok(Calibrated { sensor, refined, initial, frames, starts, witness, joint, reports, trust, verdict })
}
