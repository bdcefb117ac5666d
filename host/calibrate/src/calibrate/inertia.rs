//! Calibration of the IMU, after the camera.

use std::path::PathBuf;

use super::calibrated::{Calibrated, Evidence};
use crate::inertial::calibration::InertialCalibration;
use crate::inertial::error::InertialError;
use crate::inertial::settings::InertialSettings;
use crate::inertial::stream::ReadSamples;
use crate::inertial::units::MessageUnits;
use crate::inertial::{RecordedSamples, calibrate_unit, csv, stream};
use crate::task::input::Input;
use evcal_solve::solve::fixed_intrinsics::FixedIntrinsics;
use event_recordings::{Recording, ros};

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

/// Calibrates the IMU of `inputs`, from which `calibrated` was made. The camera's intrinsics are estimated too, unless they are
/// fixed (`fixed`).
///
/// # Errors
/// [`InertialError`] names the problem and the remedy; the calibration of the camera is not affected.
pub fn calibrate_inertial(
    calibrated: &Calibrated,
    inputs: &[Input],
    request: &InertialRequest,
    fixed: Option<&FixedIntrinsics>,
) -> Result<InertialCalibration, InertialError> {
    let Evidence::Events(events) = &calibrated.evidence else { return Err(InertialError::NoTrajectory) };
    let recorded = recorded_samples(inputs, &calibrated.starts, request)?;
    let found = calibrate_unit(recorded, &events.refined, &calibrated.quality.uncertainty, fixed, &request.settings);
    found.map_err(|error| if request.file.is_none() { error.of_recording() } else { error })
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
