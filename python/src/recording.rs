//! Recordings: files and arrays.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use evcal_detection::circles::file::{EventsError, open_events};
use evcal_detection::diagnosis::information::gather;
use event_recordings::{OptionError, Recording, RecordingOptions};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::events::{EVENT_BYTES, EventArray, append, sensor as to_sensor, to_array};
use crate::interrupt::interruptible;
use crate::{failed, memory, to_python};

/// Options for reading a recording.
#[derive(Clone, Default)]
pub struct ReadOptions {
    pub sensor: Option<(u16, u16)>,
    pub columns: Option<String>,
    pub time_unit: Option<String>,
    pub stream: Option<String>,
}

impl ReadOptions {
    pub fn options(self) -> PyResult<RecordingOptions> {
        let wrong = |error: OptionError| PyValueError::new_err(error.to_string());
        Ok(RecordingOptions {
            sensor: self.sensor.map(to_sensor).transpose()?,
            columns: self.columns.map(|text| text.parse()).transpose().map_err(wrong)?,
            time_unit: self.time_unit.map(|text| text.parse()).transpose().map_err(wrong)?,
            stream: self.stream,
            ..RecordingOptions::default()
        })
    }
}

/// Creates a recording from the events in an array, which are copied once.
pub fn of_array(array: &Bound<'_, PyAny>, options: &ReadOptions) -> PyResult<Recording> {
    let array = EventArray::new(array, options.columns.as_deref(), options.time_unit.as_deref())?;
    let records = array.records()?;
    memory::check((array.len() * EVENT_BYTES) as u64)?;
    let events = array.dtype().py().detach(|| records.to_events()).map_err(PyValueError::new_err)?;
    Ok(Recording::from_events("array", events, options.clone().options()?))
}

/// Returns the recording from an argument: a path, or an array.
pub fn recording_of(events: &Bound<'_, PyAny>, options: &ReadOptions) -> PyResult<Recording> {
    match as_path(events) {
        Some(path) => open_events(&path, options.clone().options()?).map_err(failed),
        None => of_array(events, options),
    }
}

/// Returns the argument as a path; `None` if it is anything else.
pub fn as_path(value: &Bound<'_, PyAny>) -> Option<PathBuf> {
    value.extract().ok()
}

/// Read all events of a recording, in any format that evcal supports.
///
/// Returns a structured array with the fields t (int64, µs as in the file), x, y (uint16, (0, 0) is the top-left pixel)
/// and p (uint8, 1 for ON). Times never decrease; events outside the sensor are left out.
///
/// sensor: (width, height) in pixels, instead of the size in the file. columns ("x,y,p,t") and time_unit ("s", "ms", "us",
/// "ns") are for text, stream (name or number) for files with several streams.
#[pyfunction]
#[pyo3(signature = (file, *, sensor=None, columns=None, time_unit=None, stream=None))]
pub fn read<'py>(
    py: Python<'py>,
    file: PathBuf,
    sensor: Option<(u16, u16)>,
    columns: Option<String>,
    time_unit: Option<String>,
    stream: Option<String>,
) -> PyResult<Bound<'py, PyAny>> {
    let options = ReadOptions { sensor, columns, time_unit, stream }.options()?;
    let bytes: PyResult<Vec<u8>> = interruptible(py, |stop| {
        let recording = open_events(&file, options).map_err(failed)?;
        let mut reader = recording.open().map_err(failed)?;
        let (mut bytes, mut batch) = (Vec::new(), Vec::new());
        while !stop.load(Ordering::Relaxed) && reader.next_batch(&mut batch).map_err(failed)? {
            // The array has to grow. Check first that there is memory for the rest of the events, as estimated from
            // those read so far.
            if bytes.capacity() - bytes.len() < batch.len() * EVENT_BYTES {
                let read = (bytes.len() + (batch.len() + reader.waiting()) * EVENT_BYTES) as f64;
                let all = reader.done().map_or(2.0 * read, |done| read / done.max(1e-3));
                let rest = all - bytes.len() as f64;
                memory::check(rest as u64)?;
            }
            append(&mut bytes, &batch);
        }
        Ok(bytes)
    })?;
    to_array(py, bytes?)
}

/// Describe the content of a recording as a dict: format, camera, sensor, duration, rates, hot pixels.
///
/// The options are as for read.
#[pyfunction]
#[pyo3(signature = (file, *, sensor=None, columns=None, time_unit=None, stream=None))]
pub fn info<'py>(
    py: Python<'py>,
    file: PathBuf,
    sensor: Option<(u16, u16)>,
    columns: Option<String>,
    time_unit: Option<String>,
    stream: Option<String>,
) -> PyResult<Bound<'py, PyAny>> {
    let options = ReadOptions { sensor, columns, time_unit, stream }.options()?;
    let information = interruptible(py, |_| {
        let recording = open_events(&file, options)?;
        Ok(gather(&recording)?)
    })?;
    to_python(py, serde_json::to_string(&information.map_err(|error: EventsError| failed(error))?))
}
