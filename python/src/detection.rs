//! Detection of the board, window by window.

use evcal_detection::detection::search::{FoundContent, SearchFor, search_events, sensor_of};
use evcal_geometry::board::{Board, BoardError};
use numpy::PyArrayDescr;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::calibration::settings_of;
use crate::events::filled;
use crate::failed;
use crate::interrupt::interruptible;
use crate::recording::{ReadOptions, recording_of};

/// Bytes of a circle.
const CIRCLE_BYTES: usize = 40;

/// Find the board in a recording, window by window.
///
/// events: a file, or events in memory. The other options are as for calibrate.
///
/// Returns a structured array of the circles or corners: t (int64, µs as in the file, the middle of the window), x, y
/// (float64, centre in px), radius (float64, px; NaN for corners), frame (uint32, number of the window with the board,
/// from 0) and index (uint32, number of the circle on the board, row by row from 0).
#[pyfunction]
#[pyo3(signature = (events, *, board, sensor=None, columns=None, time_unit=None, stream=None, settings=None))]
#[expect(clippy::too_many_arguments, reason = "all but the first are named by the caller")]
pub fn detect<'py>(
    py: Python<'py>,
    events: &Bound<'py, PyAny>,
    board: &str,
    sensor: Option<(u16, u16)>,
    columns: Option<String>,
    time_unit: Option<String>,
    stream: Option<String>,
    settings: Option<std::path::PathBuf>,
) -> PyResult<Bound<'py, PyAny>> {
    let board: Board = board.parse().map_err(|error: BoardError| PyValueError::new_err(error.to_string()))?;
    let recording = recording_of(events, &ReadOptions { sensor, columns, time_unit, stream })?;
    let settings = settings_of(settings)?;
    let wanted = SearchFor::from(&board);
    let sensor = sensor_of(&recording).map_err(failed)?;
    let found = interruptible(py, |_| search_events(&recording, sensor, wanted, &settings.detection))?;
    let found = found.map_err(failed)?;
    let frames = match &found.content {
        FoundContent::Boards(_, frames) => frames.as_slice(),
        _ => &[],
    };
    let circles = frames
        .iter()
        .enumerate()
        .flat_map(|(number, frame)| frame.circles.iter().map(move |circle| (number as u32, circle)));
    let mut bytes = Vec::new();
    for (number, circle) in circles {
        let t = found.source.time_origin_us + (circle.t * 1e6).round() as i64;
        bytes.extend_from_slice(&t.to_le_bytes());
        for value in [circle.center.x, circle.center.y, circle.radius.unwrap_or(f64::NAN)] {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        bytes.extend_from_slice(&number.to_le_bytes());
        bytes.extend_from_slice(&(circle.index as u32).to_le_bytes());
    }
    let fields = [("t", "<i8"), ("x", "<f8"), ("y", "<f8"), ("radius", "<f8"), ("frame", "<u4"), ("index", "<u4")];
    let dtype = PyArrayDescr::new(py, fields.to_vec())?;
    filled(&dtype, bytes.len() / CIRCLE_BYTES, |output| {
        output.copy_from_slice(&bytes);
        output.len() / CIRCLE_BYTES
    })
}
