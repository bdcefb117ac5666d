//! Differences between two calibrations.

use std::path::PathBuf;

use evcal_core::sensor::Sensor;
use evcal_geometry::lens::projection_difference::projection_difference;
use pyo3::prelude::*;
use pyo3::types::PyAny;

use crate::calibration::Calibration;
use crate::camera::Camera;
use crate::{Error, exception, failed, to_python};

/// Returns the camera of an argument: a Camera, a Calibration, a file or a folder.
fn camera_of(value: &Bound<'_, PyAny>) -> PyResult<(evcal_core::camera::Camera<f64>, Sensor)> {
    if let Ok(camera) = value.cast::<Camera>() {
        return Ok((*camera.get().lens(), camera.get().size()));
    }
    if let Ok(calibration) = value.cast::<Calibration>() {
        return Ok(calibration.get().lens());
    }
    let path: PathBuf = value.extract()?;
    evcal_geometry::lens::camera_file::read(&path).map_err(failed)
}

/// Compare a calibration with the truth or with another one: the differences between the projections of the same
/// directions, over a grid of pixels, after the best rotation of one of the cameras.
///
/// Both are a Camera, a Calibration, a file or a folder. Returns a dict: rms and max of the differences (px), max_at
/// (the pixel of the largest), rotation (from bearings of the truth to bearings of the calibration, rotation vector,
/// rad), columns and rows of the grid, grid (row by row, each pixel with its difference in px or None) and uncovered
/// (number of grid pixels that one of the lens models does not cover). Raises Error if the sensors differ.
#[pyfunction]
pub fn evaluate<'py>(
    py: Python<'py>,
    calibration: &Bound<'py, PyAny>,
    truth: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let ((camera, sensor), (true_camera, true_sensor)) = (camera_of(calibration)?, camera_of(truth)?);
    if sensor != true_sensor {
        let what = format!("one is for a sensor of {sensor} pixels, the other for one of {true_sensor}");
        return Err(Error::new_err(what));
    }
    let difference = py.detach(|| projection_difference(&true_camera, &camera, sensor)).map_err(exception)?;
    to_python(py, serde_json::to_string(&difference))
}
