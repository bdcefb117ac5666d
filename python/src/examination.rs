//! Checks of recordings and calibrations: suitability, repeatability, comparison.

use evcal_calibrate::calibrate::repeat::RepeatSettings;
use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_calibrate::result::same_camera::compare_cameras;
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::board_choice::{BoardChoiceError, choose_board, confirm_board};
use evcal_calibrate::task::{PictureUse, Task};
use evcal_files::remedy::Words;
use evcal_geometry::board::Board;
use evcal_geometry::board::request::{BoardRequest, PrintSize};
use event_recordings::Recording;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use crate::calibration::{Calibration, board_request, model_request, settings_of};
use crate::camera::Camera;
use crate::interrupt::interruptible;
use crate::recording::{ReadOptions, as_path, recording_of};
use crate::{failed, to_python, warn};

/// Returns the given board, or recognises it in a recording.
fn board_in(request: &BoardRequest, recording: &Recording, settings: &Settings) -> PyResult<Board> {
    choose_board(request, &[recording], &settings.detection).map_err(failed)
}

/// Examine samples of a recording within seconds: report whether it is suitable for a calibration, and advise on the
/// next step.
///
/// board: as for calibrate; without it rows and columns are recognised. The other arguments are as for calibrate.
///
/// Returns a dict: the content of info, seen (detections of the board), next (advice, in words), ready (True if the
/// recording can be calibrated, perhaps after the recognised board was measured).
#[pyfunction]
#[pyo3(signature = (events, *, board=None, sensor=None, columns=None, time_unit=None, stream=None, settings=None))]
#[expect(clippy::too_many_arguments, reason = "all but the first are named by the caller")]
pub fn check<'py>(
    py: Python<'py>,
    events: &Bound<'py, PyAny>,
    board: Option<&str>,
    sensor: Option<(u16, u16)>,
    columns: Option<String>,
    time_unit: Option<String>,
    stream: Option<String>,
    settings: Option<PathBuf>,
) -> PyResult<Bound<'py, PyAny>> {
    let recording = recording_of(events, &ReadOptions { sensor, columns, time_unit, stream })?;
    let settings = settings_of(settings)?;
    let request = board.map(board_request).transpose()?;
    let (checked, finding) = interruptible(py, |_| {
        let confirmed = match &request {
            // Without lengths the board is recognised in the check, and its advice names the lengths to measure.
            None | Some(BoardRequest::Recognise(PrintSize::Unknown)) => None,
            Some(request) => {
                let board = board_in(request, &recording, &settings)?;
                match confirm_board(&board, &[&recording], PictureUse::default(), &settings.detection) {
                    // The result of the check describes another board.
                    Err(BoardChoiceError::Other { .. }) => Some(board.into()),
                    confirmed => Some(confirmed.map_err(failed)?),
                }
            }
        };
        let (board, finding) = confirmed.map_or((None, None), |stated| (Some(stated.board), stated.finding));
        let checked = evcal_calibrate::check::check(
            &recording,
            board.as_ref(),
            finding.as_ref(),
            &settings.detection,
            &settings.frames,
        );
        Ok::<_, PyErr>((checked.map_err(failed)?, finding))
    })??;
    if let Some(finding) = finding {
        warn(py, &finding.reason)?;
    }
    let result = to_python(py, serde_json::to_string(&checked))?;
    result.set_item("next", checked.next.worded(&Words::PYTHON))?;
    result.set_item("ready", checked.is_ready())?;
    Ok(result)
}

/// Calibrate random parts of a recording separately, and compare the scatter of the results with their reported uncertainty.
///
/// runs: number of parts, at least 2. seconds: their length. seed: seed of their random positions. The other arguments
/// are as for calibrate.
///
/// Returns a dict: model, runs (one entry per part), parameters (name, mean, scatter: the standard deviation over the
/// parts, stated: the reported standard deviation) and projection (px, root mean square difference from the mean
/// camera).
#[pyfunction]
#[pyo3(signature = (events, *, board, runs=10, seconds=4.0, seed=1, model=None, sensor=None, columns=None, time_unit=None, stream=None, settings=None))]
#[expect(clippy::too_many_arguments, reason = "all but the first are named by the caller")]
pub fn repeat<'py>(
    py: Python<'py>,
    events: &Bound<'py, PyAny>,
    board: &str,
    runs: u16,
    seconds: f64,
    seed: u64,
    model: Option<&str>,
    sensor: Option<(u16, u16)>,
    columns: Option<String>,
    time_unit: Option<String>,
    stream: Option<String>,
    settings: Option<PathBuf>,
) -> PyResult<Bound<'py, PyAny>> {
    if runs < 2 || !(seconds > 0.0 && seconds.is_finite()) {
        return Err(PyValueError::new_err("runs is at least 2, seconds above 0"));
    }
    let options = ReadOptions { sensor, columns, time_unit, stream };
    let recording = recording_of(events, &options)?;
    let (settings, model) = (settings_of(settings)?, model_request(model)?);
    let (request, sensor) = (board_request(board)?, options.options()?.sensor);
    let parts = RepeatSettings { runs: runs.into(), seconds, seed };
    let repetition = interruptible(py, |_: &AtomicBool| {
        let board = board_in(&request, &recording, &settings)?;
        let task = Task { model, sensor, pictures: PictureUse::Ignore, settings: &settings, ..Task::new(&[], &board) };
        evcal_calibrate::calibrate::repeat::repeat(&recording, &task, &parts, |_| {}).map_err(failed)
    })??;
    to_python(py, serde_json::to_string(&repetition))
}

/// Returns the camera of an argument (a Camera, a Calibration, a file or a folder) with its covariance, if known.
pub fn known(value: &Bound<'_, PyAny>) -> PyResult<CalibratedCamera> {
    if let Ok(camera) = value.cast::<Camera>() {
        return Ok(camera.get().known());
    }
    if let Ok(calibration) = value.cast::<Calibration>() {
        return Ok(calibration.get().known());
    }
    CalibratedCamera::read(&value.extract::<PathBuf>()?).map_err(failed)
}

/// Test whether two calibrations are of the same camera, given their uncertainties.
///
/// Both are a Calibration, a file or a folder; a Camera is accepted, but has no covariance. Returns a dict: sameness
/// ("same", "near", "different", "unknown"), sentence, difference_rms, difference_max, expected_rms (px) and stated_rms
/// (px, the reported uncertainty of each, None if unknown).
#[pyfunction]
pub fn compare<'py>(
    py: Python<'py>,
    first: &Bound<'py, PyAny>,
    second: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let cameras = (known(first)?, known(second)?);
    let name = |value, name: &str| as_path(value).unwrap_or_else(|| name.into());
    let names = [name(first, "the first"), name(second, "the second")];
    let compared = py.detach(|| compare_cameras(names, [&cameras.0, &cameras.1])).map_err(failed)?;
    let result = to_python(py, serde_json::to_string(&compared))?;
    result.set_item("sentence", compared.to_string())?;
    Ok(result)
}
