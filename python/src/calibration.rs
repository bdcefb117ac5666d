//! Calibrations.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use evcal_calibrate::calibrate::board_choice::{BoardChoiceError, choose_board};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::calibrate::error::CalibrateError;
use evcal_calibrate::calibrate::input::Input;
use evcal_calibrate::calibrate::step::Step;
use evcal_calibrate::calibrate::{PictureUse, Task};
use evcal_calibrate::initial::model_choice::ModelRequest;
use evcal_calibrate::result::calibration_file::CalibrationFile;
use evcal_calibrate::settings::Settings;
use evcal_core::pattern::{Layout, Pattern};
use evcal_core::sensor::Sensor;
use evcal_files::folder::OutputFolder;
use evcal_geometry::board::request::BoardRequest;
use evcal_geometry::board::{Board, CircleBoard};
use evcal_report::output::folder::{is_result, write_folder};
use event_recordings::Recording;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict, PyList, PyTuple};

use crate::advice::worded;
use crate::camera::Camera;
use crate::interrupt::interruptible;
use crate::recording::{Said, as_path, of_array};
use crate::{failed, to_python};

/// What is calibrated, kept for the files that tell of it.
struct Asked {
    inputs: Vec<Input>,
    board: Board,
    model: ModelRequest,
    sensor: Option<Sensor>,
    pictures: PictureUse,
    settings: Settings,
}

impl Asked {
    fn task(&self) -> Task<'_> {
        let Self { inputs, board, model, sensor, pictures, settings } = self;
        Task {
            model: *model,
            sensor: *sensor,
            pictures: *pictures,
            settings,
            wording: worded,
            ..Task::new(inputs, board)
        }
    }
}

/// A calibrated camera, how sure it is, and whether it is good.
#[pyclass(frozen, module = "evcal")]
pub struct Calibration {
    asked: Asked,
    calibrated: Calibrated,
}

impl Calibration {
    pub fn lens(&self) -> (evcal_core::camera::Camera<f64>, Sensor) {
        (*self.calibrated.camera(), self.calibrated.sensor)
    }

    fn file(&self) -> CalibrationFile {
        CalibrationFile::new(&self.calibrated, &self.asked.board, worded)
    }
}

#[pymethods]
impl Calibration {
    /// The camera.
    #[getter]
    fn camera(&self) -> Camera {
        let (camera, sensor) = self.lens();
        Camera::of(camera, sensor, Some(self.calibrated.sigma()))
    }

    /// Standard deviation of each parameter of the camera, by name.
    #[getter]
    fn sigma<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let sigma = PyDict::new(py);
        let names = self.calibrated.camera().kind().parameter_names();
        for (name, value) in names.iter().zip(self.calibrated.sigma()) {
            sigma.set_item(name, value)?;
        }
        Ok(sigma)
    }

    /// "good", "usable" or "not-good".
    #[getter]
    fn grade<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, serde_json::to_string(&self.calibrated.verdict.grade))
    }

    /// Whether it is good, in words: why, and what to do.
    #[getter]
    fn verdict(&self) -> String {
        self.calibrated.verdict.worded(worded).to_string()
    }

    /// The report as one page of HTML.
    #[getter]
    fn report(&self, py: Python<'_>) -> String {
        py.detach(|| evcal_report::report::report(&self.calibrated, &self.asked.task(), &[], &mut |_| {}))
    }

    /// All that calibration.json holds.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, serde_json::to_string(&self.file()))
    }

    /// Write all that the program writes into a folder: report.html, calibration.json, camera.yaml, exports and more.
    ///
    /// force: replace the results that are in the folder. Returns the path of report.html.
    #[pyo3(signature = (folder, force=false))]
    fn write(&self, py: Python<'_>, folder: PathBuf, force: bool) -> PyResult<PathBuf> {
        py.detach(|| {
            let opened = match force {
                true => OutputFolder::open(&folder),
                false => OutputFolder::open_new(&folder, is_result),
            };
            write_folder(&opened.map_err(failed)?, &self.calibrated, &self.asked.task(), &mut |_| {})
                .map_err(failed)?;
            Ok(folder.join("report.html"))
        })
    }

    fn __repr__(&self) -> String {
        format!(
            "<Calibration {} on {} pixels: {}>",
            self.calibrated.camera().kind(),
            self.calibrated.sensor,
            self.calibrated.verdict.sentence
        )
    }
}

/// The inputs that a caller gives: a path, an array, or several of them.
fn inputs_of(given: &Bound<'_, PyAny>, said: &Said, board: &Board) -> PyResult<Vec<Input>> {
    let several = given.cast::<PyList>().map(|list| list.iter().collect::<Vec<_>>());
    let several = several.or_else(|_| given.cast::<PyTuple>().map(|tuple| tuple.iter().collect()));
    let several = several.unwrap_or_else(|_| vec![given.clone()]);
    several
        .iter()
        .map(|one| match as_path(one) {
            Some(path) => {
                let options = said.clone().options()?;
                given.py().detach(|| Input::open(&path, &options, board)).map_err(failed)
            }
            None => Ok(of_array(one, said.clone().options()?)?.into()),
        })
        .collect()
}

/// The inputs, and the board that was named or is recognised in them.
fn inputs_and_board(
    given: &Bound<'_, PyAny>,
    said: &Said,
    request: &BoardRequest,
    settings: &Settings,
) -> PyResult<(Vec<Input>, Board)> {
    if let BoardRequest::Given(board) = request {
        return Ok((inputs_of(given, said, board)?, *board));
    }
    // Of events the board does not matter; circles are put in its order, and nothing is recognised in them.
    let any =
        CircleBoard { pattern: Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 }, spacing: 1.0, radius: 0.3 }
            .into();
    let inputs = inputs_of(given, said, &any)?;
    let recordings = inputs.iter().map(|input| match input {
        Input::Events(recording) => Ok(recording),
        Input::Images(_) | Input::Circles { .. } => Err(failed(BoardChoiceError::NoEvents)),
    });
    let recordings = recordings.collect::<PyResult<Vec<&Recording>>>()?;
    let board = given.py().detach(|| choose_board(request, &recordings, &settings.detection)).map_err(failed)?;
    Ok((inputs, board))
}

fn picture_use(name: &str) -> PyResult<PictureUse> {
    match name {
        "witness" => Ok(PictureUse::Witness),
        "joint" => Ok(PictureUse::Joint),
        "only" => Ok(PictureUse::Only),
        "ignore" => Ok(PictureUse::Ignore),
        _ => Err(PyValueError::new_err("frames is \"witness\", \"joint\", \"only\" or \"ignore\"")),
    }
}

/// Calibrate a camera from recordings of a moving board.
///
/// events: a file, a structured array of events, or a list of them, all of one camera.
/// board: such as "acircles:9x4:55mm:r17.5mm": layout, rows x columns, spacing (acircles: half the distance in a row),
/// radius. "auto:55mm:r17.5mm" recognises layout, rows and columns.
/// model: the lens model, or "auto".
/// sensor: (width, height) in pixels; needed for arrays, and for files that do not say it.
/// columns, time_unit, stream: as read has them.
/// settings: a settings file (TOML).
/// frames: what the camera's own frames are for, where a file has them: "witness", "joint", "only", "ignore".
/// progress: called with a line of text whenever another stage begins; what it raises ends the calibration.
#[pyfunction]
#[pyo3(signature = (events, *, board, model="radtan", sensor=None, columns=None, time_unit=None, stream=None, settings=None, frames="witness", progress=None))]
#[expect(clippy::too_many_arguments, reason = "all but the first are named by the caller")]
pub fn calibrate(
    py: Python<'_>,
    events: &Bound<'_, PyAny>,
    board: &str,
    model: &str,
    sensor: Option<(u16, u16)>,
    columns: Option<String>,
    time_unit: Option<String>,
    stream: Option<String>,
    settings: Option<PathBuf>,
    frames: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Calibration> {
    let request: BoardRequest =
        board.parse().map_err(|error: evcal_geometry::board::BoardError| PyValueError::new_err(error.to_string()))?;
    let said = Said { sensor, columns, time_unit, stream };
    let settings = settings.map(|path| Settings::read(&path)).transpose().map_err(failed)?.unwrap_or_default();
    let (inputs, board) = inputs_and_board(events, &said, &request, &settings)?;
    let asked = Asked {
        inputs,
        board,
        model: model.parse().map_err(|error| PyValueError::new_err(format!("{error} auto: not {model:?}")))?,
        sensor: said.options()?.sensor,
        pictures: picture_use(frames)?,
        settings,
    };
    let mut raised = None;
    let calibrated = interruptible(py, |stop| {
        let mut last = String::new();
        evcal_calibrate::calibrate::calibrate(&asked.task(), |Step { text, .. }| {
            if stop.load(Ordering::Relaxed) {
                return ControlFlow::Break(());
            }
            let Some(progress) = progress.as_ref().filter(|_| text != last) else { return ControlFlow::Continue(()) };
            text.clone_into(&mut last);
            match Python::attach(|py| progress.call1(py, (text,))) {
                Ok(_) => ControlFlow::Continue(()),
                Err(error) => {
                    raised = Some(error);
                    ControlFlow::Break(())
                }
            }
        })
    })?;
    match (calibrated, raised) {
        (Ok(calibrated), _) => Ok(Calibration { asked, calibrated }),
        (Err(CalibrateError::Stopped), Some(error)) => Err(error),
        (Err(error), _) => Err(failed(error)),
    }
}
