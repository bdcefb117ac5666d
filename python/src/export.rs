//! Export of cameras and recordings in other formats.

use std::path::{Path, PathBuf};

use evcal_calibrate::export::content::ExportFormat;
use evcal_calibrate::export::{FORMATS, from_name, read_rig_files, rig_files};
use evcal_calibrate::result::calibrated_camera::{CalibratedCamera, plain};
use evcal_files::folder::OutputFolder;
use evcal_files::output::{Existing, check_outputs};
use evcal_geometry::lens::camera_file::camera_path;
use event_recordings::convert::{TimeOrigin, output_of};
use event_recordings::encode::OutputFormat;
use event_recordings::write::NoOutputFormat;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyString};

use crate::calibration::Calibration;
use crate::examination::known;
use crate::interrupt::interruptible;
use crate::recording::{ReadOptions, as_path, recording_of};
use crate::{Error, exception, failed, to_python, warn};

/// Name that selects all formats.
const ALL: &str = "all";

fn may_write<'a>(paths: impl IntoIterator<Item = &'a Path>, inputs: &[&Path], force: bool) -> PyResult<()> {
    let existing = if force { Existing::Replace } else { Existing::Keep };
    check_outputs(paths, inputs, existing).map_err(failed)
}

/// Returns the files of a camera together with the IMU or other cameras of its calibration; empty for a camera alone.
fn rig_files_of(value: &Bound<'_, PyAny>, camera: &CalibratedCamera) -> PyResult<Vec<(String, String)>> {
    if let Ok(calibration) = value.cast::<Calibration>() {
        return rig_files(camera, &calibration.get().file()).map_err(exception);
    }
    as_path(value).map_or(Ok(Vec::new()), |path| read_rig_files(camera, &path).map_err(failed))
}

/// Write a camera for other programs.
///
/// calibration: a Calibration, a Camera, a file or a folder. format: "opencv-yaml", "ros", "kalibr" …, or "all"; an unknown name
/// raises an error with the list. output: the file, or for "all" the folder. force: replace existing files. camera_name: its name in the file.
///
/// Returns the list of the written paths, or without output the text of the file.
#[pyfunction]
#[pyo3(signature = (calibration, format, output=None, *, force=false, camera_name=None))]
pub fn export<'py>(
    py: Python<'py>,
    calibration: &Bound<'py, PyAny>,
    format: &str,
    output: Option<PathBuf>,
    force: bool,
    camera_name: Option<&str>,
) -> PyResult<Bound<'py, PyAny>> {
    let known = known(calibration)?;
    let known = CalibratedCamera { name: plain(camera_name).unwrap_or(known.name), ..known };
    // The folder is created when it is opened, and removed if it is empty when it is closed.
    let mut opened = None;
    let files: Vec<(PathBuf, String)> = match (from_name(format), output) {
        (Some(format), None) => return Ok(PyString::new(py, &text_of(py, format, &known)?).into_any()),
        (Some(format), Some(output)) => vec![(output, text_of(py, format, &known)?)],
        (None, Some(folder)) if format == ALL => {
            let folder = opened.insert(OutputFolder::open(&folder).map_err(failed)?);
            let mut files = Vec::new();
            for format in FORMATS {
                match format.export(&known) {
                    Ok(exported) => files.push((format.file.to_owned(), exported.text)),
                    // The format supports no camera near this one. The other files are written nevertheless.
                    Err(error) => warn(py, &format!("not written: {error}"))?,
                }
            }
            files.extend(rig_files_of(calibration, &known)?);
            files.into_iter().map(|(name, text)| (folder.path().join(name), text)).collect()
        }
        (None, None) if format == ALL => {
            return Err(PyValueError::new_err("format=\"all\" takes a folder: give output="));
        }
        (None, _) => {
            let names: Vec<&str> = FORMATS.iter().map(|format| format.name).chain([ALL]).collect();
            return Err(PyValueError::new_err(format!("format is one of {}, not {format:?}", names.join(", "))));
        }
    };
    let input = as_path(calibration).map(|path| camera_path(&path));
    may_write(
        files.iter().map(|(path, _)| path.as_path()),
        &input.iter().map(PathBuf::as_path).collect::<Vec<_>>(),
        force,
    )?;
    for (path, text) in &files {
        evcal_files::write(path, text.as_bytes()).map_err(failed)?;
    }
    Ok(PyList::new(py, files.into_iter().map(|(path, _)| path))?.into_any())
}

/// Returns the file of `format`. If another camera model is fitted, a warning reports the difference.
fn text_of(py: Python<'_>, format: &ExportFormat, camera: &CalibratedCamera) -> PyResult<String> {
    let exported = format.export(camera).map_err(failed)?;
    if let Some(note) = &exported.note {
        warn(py, note)?;
    }
    Ok(exported.text)
}

/// Write a recording in another format.
///
/// events: a file, or events in memory. output: the file to write. to: its format [default: by its extension]. unix_time: count times from
/// 1970, if the recording contains its start time. force: replace existing files. The other arguments are as for read.
///
/// Returns a dict: events, frames, inertial_samples, lost (content that the format does not support), notes, report.
#[pyfunction]
#[pyo3(signature = (events, output, *, to=None, unix_time=false, force=false, sensor=None, columns=None, time_unit=None, stream=None))]
#[expect(clippy::too_many_arguments, reason = "all but the first two are named by the caller")]
pub fn convert<'py>(
    py: Python<'py>,
    events: &Bound<'py, PyAny>,
    output: PathBuf,
    to: Option<&str>,
    unix_time: bool,
    force: bool,
    sensor: Option<(u16, u16)>,
    columns: Option<String>,
    time_unit: Option<String>,
    stream: Option<String>,
) -> PyResult<Bound<'py, PyAny>> {
    let named = to.map(|name| {
        name.parse::<OutputFormat>()
            .map_err(|error: NoOutputFormat| PyValueError::new_err(format!("to: {error}, not {name:?}")))
    });
    let target = named.transpose()?.map_or_else(|| output_of(&output).map_err(failed), Ok)?;
    let origin = if unix_time { TimeOrigin::Unix } else { TimeOrigin::Kept };
    let input = as_path(events);
    may_write([output.as_path()], &input.iter().map(PathBuf::as_path).collect::<Vec<_>>(), force)?;
    let recording = recording_of(events, &ReadOptions { sensor, columns, time_unit, stream })?;
    let report =
        interruptible(py, |_| event_recordings::convert::convert(&recording, &output, target, origin, |_| {}))?;
    let report = report.map_err(failed)?;
    match &report.error {
        Some(error) => Err(Error::new_err(format!("{error}; what came before is in {}", output.display()))),
        None => to_python(py, serde_json::to_string(&report)),
    }
}
