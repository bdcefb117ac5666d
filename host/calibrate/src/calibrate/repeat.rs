//! Repeatability of a calibration: random parts of a recording, each calibrated separately.

use std::ops::ControlFlow;

use evcal_core::camera::Camera;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::calibrate::calibrate;
use crate::calibrate::calibrated::Calibrated;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::input::Input;
use evcal_files::remedies;
use evcal_geometry::lens::projection_difference::projection_difference;
use evcal_geometry::numerics::random::uniform_in;
use evcal_solve::initial::model_choice::ModelRequest;
use event_recordings::given_sensor::{OtherSensor, check_outside, check_stated};
use event_recordings::{Recording, RecordingError};

/// Shortest recording, in parts. In shorter ones all parts are nearly the same.
const LEAST_PARTS: f64 = 1.25;

/// Number, length and random seed of the parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RepeatSettings {
    /// Number of parts.
    pub runs: usize,
    /// Length of a part in seconds.
    pub seconds: f64,
    /// Seed of the random starts.
    pub seed: u64,
}

/// One part of the recording and its camera.
#[derive(Debug, Serialize)]
pub struct Run {
    /// Start of the part in seconds since the first event.
    pub start: f64,
    /// End of the part.
    pub end: f64,
    /// Parameters in the order of the camera model, or the reason why the calibration failed.
    pub outcome: Result<RunCamera, CalibrateError>,
}

/// The camera of one part.
#[derive(Clone, Debug, Serialize)]
pub struct RunCamera {
    /// Its parameters, in the order of the model.
    pub parameters: Vec<f64>,
    /// Their reported standard deviations.
    pub sigma: Vec<f64>,
    /// Root mean square difference of its projection from the projection of the mean of all parts (px).
    pub difference: f64,
    /// 95 % bound of that difference by its reported uncertainty (px).
    pub stated: f64,
}

/// One parameter over all runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterScatter {
    /// Name of the parameter.
    pub name: &'static str,
    /// Mean over the runs.
    pub mean: f64,
    /// Standard deviation over the runs.
    pub scatter: f64,
    /// Root mean square of the reported standard deviations.
    pub stated: f64,
}

/// Result of the repetition.
#[derive(Debug, Serialize)]
pub struct Repetition {
    /// The camera model.
    pub model: &'static str,
    /// Every run.
    pub runs: Vec<Run>,
    /// Every parameter; empty with fewer than two cameras.
    pub parameters: Vec<ParameterScatter>,
    /// Root mean square over the runs of the projection difference from the mean camera (px).
    pub projection: f64,
}

/// Reasons why the parts of a recording cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum RepeatError {
    /// It cannot be read.
    #[error("{0}")]
    Source(#[from] RecordingError),
    /// The requested sensor differs from the sensor of the recording.
    #[error("{0}")]
    OtherSensor(#[from] OtherSensor),
    /// Fewer than two parts could be calibrated.
    #[error(
        "{calibrated} of {runs} parts could be calibrated, and two are needed to compare{}: try longer parts",
        first.as_ref().map_or_else(String::new, |first| format!(" (the first that failed: {first})"))
    )]
    TooFew {
        /// Number of parts with a camera.
        calibrated: usize,
        /// Number of all parts.
        runs: usize,
        /// Reason why the first part without a camera failed.
        first: Option<String>,
    },
    /// It is hardly longer than a part.
    #[error("the recording is {duration:.1} s long: different parts of {seconds} s cannot be taken from it; {}",
        shorter_parts(*.duration).map_or_else(|| "record longer".to_owned(), |seconds| format!("try parts of {seconds:.1} s")))]
    TooShort {
        /// Its length (s).
        duration: f64,
        /// Requested length (s).
        seconds: f64,
    },
}

remedies! { RepeatError, say;
    Self::Source(error) => error.remedy(say);
    Self::OtherSensor(error) => error.remedy(say);
    Self::TooFew { .. } => "try longer parts with {}", say.seconds?;
    Self::TooShort { duration, .. } => "try {}", say.seconds?.with_seconds(shorter_parts(*duration)?);
}

/// Returns a length of parts (s) that suits a recording of this length (s); `None` if the recording is too short for any.
pub fn shorter_parts(duration: f64) -> Option<f64> {
    Some((5.0 * duration).floor() / 10.0).filter(|seconds| *seconds > 0.0)
}

/// Calibrates `settings.runs` random parts of `recording`, as `task` describes except for its inputs. If the camera model is
/// chosen automatically, the model of the first part is used for all.
///
/// # Errors
/// [`RepeatError`] if the recording cannot be read or is hardly longer than a part, or if fewer than two parts can be calibrated. A
/// part that cannot be calibrated is a [`Run`] with its reason.
pub fn repeat(
    recording: &Recording,
    task: &Task,
    settings: &RepeatSettings,
    mut progress: impl FnMut(usize),
) -> Result<Repetition, RepeatError> {
    check_stated(recording)?;
    let pass = event_recordings::pass::read_recording(recording, &mut |_| {})?;
    check_outside(recording, &pass.report)?;
    let duration = (pass.last - pass.first) as f64 * 1e-6;
    if duration < LEAST_PARTS * settings.seconds {
        return Err(RepeatError::TooShort { duration, seconds: settings.seconds });
    }
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut runs = Vec::new();
    let mut cameras: Vec<(usize, Calibrated)> = Vec::new();
    let mut model = task.model;
    for index in 0..settings.runs {
        progress(index);
        let start = uniform_in(&mut rng, 0.0, duration - settings.seconds);
        let end = start + settings.seconds;
        let span = pass.first + (start * 1e6) as i64..pass.first + (end * 1e6) as i64;
        let inputs = [Input::Events(recording.section(span))];
        let task = Task { inputs: &inputs, model, ..*task };
        let outcome: Result<Calibrated, CalibrateError> = calibrate(&task, |_| ControlFlow::Continue(()));
        let outcome = match outcome {
            Ok(calibrated) => {
                let camera = *calibrated.camera();
                model = ModelRequest::Given(camera.kind());
                let stated = calibrated.quality.projection.rms_95;
                let sigma = calibrated.quality.uncertainty.sigma();
                cameras.push((index, calibrated));
                Ok(RunCamera { parameters: camera.parameters().to_vec(), sigma, difference: 0.0, stated })
            }
            Err(error) => Err(error),
        };
        runs.push(Run { start, end, outcome });
    }
    if cameras.len() < 2 {
        let first = runs.iter().find_map(|run| run.outcome.as_ref().err()).map(ToString::to_string);
        return Err(RepeatError::TooFew { calibrated: cameras.len(), runs: runs.len(), first });
    }
    let summary = Summary::of(&cameras);
    for (index, calibrated) in &cameras {
        let (Some(mean), Some(run)) = (&summary.mean, runs.get_mut(*index)) else { continue };
        let difference = projection_difference(mean, calibrated.camera(), calibrated.sensor);
        if let (Ok(camera), Ok(difference)) = (&mut run.outcome, difference) {
            camera.difference = difference.rms;
        }
    }
    let squares = runs.iter().filter_map(|run| run.outcome.as_ref().ok()).map(|run| run.difference * run.difference);
    let projection = (squares.sum::<f64>() / cameras.len().max(1) as f64).sqrt();
    Ok(Repetition { model: model.name(), runs, parameters: summary.parameters, projection })
}

struct Summary {
    mean: Option<Camera<f64>>,
    parameters: Vec<ParameterScatter>,
}

impl Summary {
    fn of(cameras: &[(usize, Calibrated)]) -> Self {
        let Some((_, first)) = cameras.first().filter(|_| cameras.len() >= 2) else {
            return Self { mean: None, parameters: Vec::new() };
        };
        let kind = first.camera().kind();
        let names = kind.parameter_names();
        let columns: Vec<DVector<f64>> = cameras
            .iter()
            .map(|(_, calibrated)| {
                let parameters = calibrated.camera().parameters();
                DVector::from_column_slice(&parameters)
            })
            .collect();
        let values = DMatrix::from_columns(&columns);
        let mean = values.column_mean();
        let parameters = names
            .iter()
            .zip(values.row_iter())
            .enumerate()
            .map(|(index, (name, row))| {
                let squares: f64 = row.iter().map(|value| (value - mean[index]) * (value - mean[index])).sum();
                let stated: f64 = cameras
                    .iter()
                    .filter_map(|(_, calibrated)| calibrated.quality.uncertainty.sigma().get(index).copied())
                    .map(|sigma| sigma * sigma)
                    .sum();
                ParameterScatter {
                    name,
                    mean: mean[index],
                    scatter: (squares / (cameras.len() - 1) as f64).sqrt(),
                    stated: (stated / cameras.len() as f64).sqrt(),
                }
            })
            .collect();
        Self { mean: Camera::from_parameters(kind, mean.as_slice()), parameters }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_advice_never_names_parts_of_zero_length() {
        let message = |duration| RepeatError::TooShort { duration, seconds: 6.0 }.to_string();
        assert!(message(3.0).ends_with("try parts of 1.5 s"), "{}", message(3.0));
        for duration in [0.0, 0.004, 0.19] {
            assert!(message(duration).ends_with("record longer"), "{}", message(duration));
        }
    }
}
