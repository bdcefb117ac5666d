//! The Python package of evcal, with arrays as input and output; `docs/python.md` describes it.

mod calibration;
mod camera;
mod detection;
mod evaluation;
mod events;
mod examination;
mod export;
mod interrupt;
mod memory;
mod recording;
mod simulation;

use evcal_files::remedy::{Remedy, Words};
use pyo3::exceptions::{PyRuntimeError, PyUserWarning};
use pyo3::prelude::*;
use pyo3::types::PyAny;

pyo3::create_exception!(
    evcal,
    Error,
    PyRuntimeError,
    "evcal cannot do what was asked; the text says why, and what to do."
);

/// Converts an error of evcal to a Python exception, with its remedy in terms of this package.
fn failed(error: impl Remedy) -> PyErr {
    exception(error.advised(&Words::PYTHON))
}

/// Creates a Python exception with this text.
fn exception(error: impl ToString) -> PyErr {
    Error::new_err(error.to_string())
}

fn warn(py: Python<'_>, what: &str) -> PyResult<()> {
    let text = std::ffi::CString::new(what)?;
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
}

/// Converts JSON from the library to Python objects.
fn to_python<'py>(py: Python<'py>, value: Result<String, serde_json::Error>) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.map_err(exception)?,))
}

/// Calibrates an event camera from the events of a printed board.
#[pymodule]
mod _evcal {
    #[pymodule_export]
    use super::Error;
    #[pymodule_export]
    use super::calibration::{Calibration, calibrate};
    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::detection::detect;
    #[pymodule_export]
    use super::evaluation::evaluate;
    #[pymodule_export]
    use super::events::{columns_of, polarities_of};
    #[pymodule_export]
    use super::examination::{check, compare, repeat};
    #[pymodule_export]
    use super::export::{convert, export};
    #[pymodule_export]
    use super::recording::{info, read};
    #[pymodule_export]
    use super::simulation::simulate;

    /// Version of evcal.
    #[expect(non_upper_case_globals, reason = "Python's name for it")]
    #[pymodule_export]
    const __version__: &str = evcal_calibrate::VERSION;
}
