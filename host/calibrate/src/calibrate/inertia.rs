//! Calibration of the IMU, after the camera.

use std::convert::Infallible;
use std::path::PathBuf;

use evcal_core::camera::MAX_PARAMETERS;
use evcal_core::sensor::Sensor;

use super::calibrated::{Calibrated, Evidence};
use super::events::first_state;
use crate::calibrate::solves::joint_solve::{stage_settings, trajectory_settings};
use crate::inertial::calibration::InertialCalibration;
use crate::inertial::error::InertialError;
use crate::inertial::settings::InertialSettings;
use crate::inertial::stream::ReadSamples;
use crate::inertial::units::MessageUnits;
use crate::inertial::{RecordedSamples, calibrate_unit, csv, stream};
use crate::picture_calibration::calibration::PictureCalibration;
use crate::task::Task;
use crate::task::input::Input;
use evcal_solve::initial::InitialModel;
use evcal_solve::solve::BOARD_PARAMETERS;
use evcal_solve::solve::fixed_intrinsics::FixedIntrinsics;
use evcal_solve::solve::refinement::{Refined, RefinementError, RefinementInput, SMALLEST_POINT_SIGMA, refine};
use evcal_solve::trajectory::first::first_trajectories;
use event_recordings::{Files, Recording, ros};

/// Request for the calibration of an IMU, with prior knowledge.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InertialRequest {
    /// A file of samples; `None` for the samples in the recordings.
    pub file: Option<PathBuf>,
    /// Units of the samples in recordings of messages, if they are not those of the message.
    pub units: Option<MessageUnits>,
    /// Prior knowledge and options.
    pub settings: InertialSettings,
}

/// Calibrates the IMU of the inputs of `task`, from which `calibrated` was made. The camera's intrinsics are estimated too, unless
/// they are fixed (`fixed`).
///
/// # Errors
/// [`InertialError`] names the problem and the remedy; the calibration of the camera is not affected.
pub fn calibrate_inertial(
    task: &Task,
    calibrated: &Calibrated,
    request: &InertialRequest,
    fixed: Option<&FixedIntrinsics>,
) -> Result<InertialCalibration, InertialError> {
    let source_files = Files::new(request.file.clone());
    let recorded = recorded_samples(task.inputs, &calibrated.starts, request)?;
    let of_pictures;
    let refined = match &calibrated.evidence {
        Evidence::Events(events) => &events.refined,
        Evidence::Pictures(pictures) => {
            of_pictures = along_pictures(task, pictures, calibrated.sensor)?;
            &of_pictures
        }
    };
    let found = calibrate_unit(recorded, refined, &calibrated.quality.uncertainty, fixed, &request.settings);
    let found = found.map(|found| InertialCalibration { source_files, ..found });
    found.map_err(|error| if request.file.is_none() { error.of_recording() } else { error })
}

/// Solves the trajectories through the poses of `pictures` from the points in them.
fn along_pictures(task: &Task, pictures: &PictureCalibration, sensor: Sensor) -> Result<Refined, InertialError> {
    let settings = task.settings;
    let initial = InitialModel::of_frames(pictures.camera, pictures.posed.clone());
    let first = first_trajectories(&initial, &pictures.frames, trajectory_settings(settings))?;
    let input = RefinementInput::<Infallible> {
        board: task.board,
        sensor,
        events: None,
        points: first.points,
        point_sigma: pictures.spread.max(SMALLEST_POINT_SIGMA),
        anchors: &[],
        left_out: &[],
        free_board: [false; BOARD_PARAMETERS],
        fixed: [false; MAX_PARAMETERS],
    };
    let state = first_state(task, pictures.camera, first.trajectories);
    match refine(&input, state, stage_settings(settings), |_, _| Ok(())) {
        Ok(refined) => Ok(refined),
        Err(RefinementError::Solve(error)) => Err(error.into()),
        Err(RefinementError::Read(never)) => match never {},
    }
}

/// Returns `true` for recordings of ROS messages, whose drivers choose the units of IMU samples.
fn has_messages(recording: &Recording) -> bool {
    let formats = [&ros::BAG_FORMAT, &ros::DB3_FORMAT, &ros::FOLDER_FORMAT, &ros::MCAP_FORMAT];
    formats.iter().any(|format| format.name == recording.format().name)
}

fn recorded_samples(
    inputs: &[Input],
    starts: &[f64],
    request: &InertialRequest,
) -> Result<Vec<RecordedSamples>, InertialError> {
    let start = |recording: usize| starts.get(recording).copied().unwrap_or(0.0);
    if let Some(file) = &request.file {
        if inputs.len() > 1 {
            return Err(InertialError::SeveralRecordings);
        }
        return Ok(vec![RecordedSamples {
            recording: 0,
            samples: csv::read(file)?,
            start: start(0),
            lost: Vec::new(),
        }]);
    }
    let (mut recorded, mut damages) = (Vec::new(), Vec::new());
    for (recording, input) in inputs.iter().enumerate() {
        let ReadSamples { mut samples, lost } = match input {
            Input::Events(file) => stream::read(file)?,
            Input::Images(_) | Input::Circles { .. } => ReadSamples::default(),
        };
        if let (Some(units), Input::Events(file)) = (&request.units, input) {
            if !has_messages(file) {
                return Err(InertialError::UnitsOfFormat { file: input.name() });
            }
            units.correct(&mut samples);
        }
        if samples.is_empty() {
            damages.extend(lost);
        } else {
            recorded.push(RecordedSamples { recording, samples, start: start(recording), lost });
        }
    }
    if recorded.is_empty() && !damages.is_empty() {
        return Err(InertialError::Lost { damages });
    }
    if recorded.is_empty() {
        let file = inputs.iter().map(Input::name).collect::<Vec<_>>().join(", ");
        return Err(InertialError::NoSamples { file });
    }
    Ok(recorded)
}
