//! Calibrations.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::calibrate::inertia::{InertialRequest, calibrate_inertial};
use evcal_calibrate::calibrate::second::{calibrate_against_first, calibrate_lens_separately, picture_use_of_second};
use evcal_calibrate::inertial::settings::InertialSettings;
use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_calibrate::result::calibration_file::CalibrationFile;
use evcal_calibrate::result::device_verdicts::{DeviceVerdict, device_verdicts, worst_grade};
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::board_choice::{BoardChoiceError, ConfirmedBoard, choose_board, confirm_board};
use evcal_calibrate::task::input::Input;
use evcal_calibrate::task::step::Step;
use evcal_calibrate::task::{PictureUse, Task};
use evcal_core::pattern::{Layout, Pattern};
use evcal_core::sensor::Sensor;
use evcal_files::folder::OutputFolder;
use evcal_files::remedy::{Remedy as _, Words};
use evcal_geometry::board::request::BoardRequest;
use evcal_geometry::board::{Board, BoardError, CircleBoard};
use evcal_geometry::timed_pose::TimedPose;
use evcal_report::output::folder::{is_result, poses, write_folder};
use evcal_solve::initial::model_choice::ModelRequest;
use event_recordings::Recording;
use event_recordings::image_folder::Stamps;
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyArrayDescr};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict, PyList, PyTuple};

use crate::camera::Camera;
use crate::events::viewed;
use crate::interrupt::interruptible;
use crate::recording::{ReadOptions, as_path, of_array};
use crate::{failed, to_python, warn};

/// The inputs and settings of a calibration, kept for the files of its result.
struct CalibrationJob {
    inputs: Vec<Input>,
    /// The recordings of other cameras on the mount.
    others: Vec<Input>,
    rolling_shutter: bool,
    inertial: Option<InertialRequest>,
    confirmed: ConfirmedBoard,
    model: ModelRequest,
    sensor: Option<Sensor>,
    pictures: PictureUse,
    settings: Settings,
}

impl CalibrationJob {
    fn task(&self) -> Task<'_> {
        let Self { inputs, confirmed, model, sensor, settings, .. } = self;
        // If another camera's pictures are in a file of the first camera, the pictures in that file do not belong to
        // the first.
        let taken =
            |other: &Input| matches!(other, Input::Images(_)) && inputs.iter().any(|input| input.is_of_file_of(other));
        let pictures = if self.others.iter().any(taken) { PictureUse::Ignore } else { self.pictures };
        Task {
            board_finding: confirmed.finding.as_ref(),
            model: *model,
            sensor: *sensor,
            pictures,
            settings,
            words: &Words::PYTHON,
            ..Task::new(inputs, &confirmed.board)
        }
    }

    /// Calibrates the camera, and the IMU and other cameras if requested. Also returns the names of the devices that
    /// could not be calibrated, each with the reason.
    fn calibrate(
        &self,
        mut on_progress: impl FnMut(Step) -> ControlFlow<()> + Send,
    ) -> PyResult<(Calibrated, Vec<(String, String)>)> {
        let task = self.task();
        let mut first = evcal_calibrate::calibrate::calibrate(&task, &mut on_progress).map_err(failed)?;
        let mut failures = Vec::new();
        if let Some(request) = &self.inertial {
            let _ = on_progress(Step { text: "IMU", done: None });
            let found = calibrate_inertial(&task, &first, request, None);
            failures.extend(
                first.add_inertial(found).err().map(|error| ("the IMU".to_owned(), error.advised(&Words::PYTHON))),
            );
        }
        for other in &self.others {
            if let Err(reason) = self.add_second(&mut first, other, &task, &mut on_progress) {
                failures.push((other.name(), reason));
            }
        }
        Ok((first, failures))
    }

    /// Calibrates another camera against the `first` and adds it; returns the reason if this is impossible.
    fn add_second(
        &self,
        first: &mut Calibrated,
        other: &Input,
        task: &Task,
        on_progress: &mut (impl FnMut(Step) -> ControlFlow<()> + Send),
    ) -> Result<(), String> {
        let pictures = picture_use_of_second(&self.inputs, other);
        let separate = Task { inputs: std::slice::from_ref(other), pictures, ..*task };
        let second =
            calibrate_lens_separately(&separate, &mut *on_progress).map_err(|error| error.advised(&Words::PYTHON))?;
        let _ = on_progress(Step { text: "both cameras", done: None });
        let found =
            calibrate_against_first(first, &second, other, self.rolling_shutter, &self.confirmed.board, [None, None]);
        first.add_second(found).map_err(|error| error.advised(&Words::PYTHON))
    }
}

/// A calibrated camera with its uncertainty and verdict.
#[pyclass(frozen, module = "evcal")]
pub struct Calibration {
    job: CalibrationJob,
    calibrated: Calibrated,
    /// Results that are missing, with the reason.
    failures: Vec<(String, String)>,
}

impl Calibration {
    pub fn lens(&self) -> (evcal_core::camera::Camera<f64>, Sensor) {
        (*self.calibrated.camera(), self.calibrated.sensor)
    }

    pub fn file(&self) -> CalibrationFile {
        CalibrationFile::new(&self.calibrated, &self.job.confirmed.board, &Words::PYTHON)
    }

    /// Returns the camera as `compare` and `export` need it.
    pub fn known(&self) -> CalibratedCamera {
        CalibratedCamera::new(&self.calibrated, &self.job.confirmed.board)
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

    /// Covariance of the parameters of the camera (K x K, in the order of camera.parameters; px² for the first four).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let covariance = &self.calibrated.quality.uncertainty.covariance;
        Array2::from_shape_fn(covariance.shape(), |place| covariance[place]).into_pyarray(py)
    }

    /// Poses of the camera relative to the board (T_world_camera): a structured array with the fields recording
    /// (number, from 0), t (s, on the clock of the recording), position (3, m, centre of the camera in the coordinates
    /// of the board), rotation (4, quaternion x, y, z, w, from camera coordinates to board coordinates), position_sigma
    /// (3, m) and rotation_sigma (3, rad, about the axes of the camera), NaN if unknown, and sure (True if the pose is
    /// well determined; trajectory.txt contains only these poses).
    #[getter]
    fn trajectory<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let settings = &self.job.settings.poses;
        let mut bytes = Vec::new();
        for (recording, start) in self.calibrated.starts.iter().enumerate() {
            for pose in poses(&self.calibrated, recording, *start, settings) {
                let TimedPose { t, pose: place } = pose.pose;
                let sigma = pose.sigma.map_or([f64::NAN; 6], |sigma| {
                    let ([x, y, z], [a, b, c]) = (sigma.position, sigma.rotation);
                    [x, y, z, a, b, c]
                });
                let numbers = place.translation.vector.iter().chain(place.rotation.coords.iter()).chain(&sigma);
                for number in std::iter::once(&t).chain(numbers) {
                    bytes.extend_from_slice(&number.to_le_bytes());
                }
                bytes.extend_from_slice(&(recording as u32).to_le_bytes());
                bytes.push(u8::from(pose.is_determined() || self.calibrated.events().is_none()));
            }
        }
        let fields = [
            ("t", "<f8"),
            ("position", "(3,)<f8"),
            ("rotation", "(4,)<f8"),
            ("position_sigma", "(3,)<f8"),
            ("rotation_sigma", "(3,)<f8"),
            ("recording", "<u4"),
            ("sure", "?"),
        ];
        viewed(&PyArrayDescr::new(py, fields.to_vec())?, bytes)
    }

    /// "good", "usable" or "not-good": the worst grade of the camera, the IMU and the other cameras.
    #[getter]
    fn grade<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, serde_json::to_string(&worst_grade(&self.calibrated)))
    }

    /// The verdict in words, with its reasons and advice; then the verdicts on the IMU and on other cameras, or the
    /// reasons why they were not calibrated.
    #[getter]
    fn verdict(&self) -> String {
        let others = device_verdicts(&self.calibrated).into_iter();
        let others = others.map(|DeviceVerdict { about, sentence, .. }| format!("\n{about}: {sentence}"));
        let failures = self.failures.iter().map(|(what, reason)| format!("\n{what} was not calibrated: {reason}"));
        std::iter::once(self.calibrated.verdict.worded(&Words::PYTHON).to_string())
            .chain(others)
            .chain(failures)
            .collect()
    }

    /// Requested results that are missing: pairs of a name (the IMU, or the file of another camera) and the reason.
    #[getter]
    fn not_calibrated(&self) -> Vec<(String, String)> {
        self.failures.clone()
    }

    /// The report as an HTML page.
    #[getter]
    fn report(&self, py: Python<'_>) -> String {
        py.detach(|| evcal_report::report::report(&self.calibrated, &self.job.task(), &[], &mut |_| {}))
    }

    /// The content of calibration.json as a dict.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, serde_json::to_string(&self.file()))
    }

    /// Write the same files as the program into a folder: report.html, calibration.json, camera.yaml, exports and more.
    ///
    /// force: replace the results that are in the folder. Returns the path of report.html.
    #[pyo3(signature = (folder, force=false))]
    fn write(&self, py: Python<'_>, folder: PathBuf, force: bool) -> PyResult<PathBuf> {
        py.detach(|| {
            let opened = match force {
                true => OutputFolder::open(&folder),
                false => OutputFolder::open_new(&folder, is_result),
            };
            write_folder(&opened.map_err(failed)?, &self.calibrated, &self.job.task(), &mut |_| {}).map_err(failed)?;
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

/// A single argument or a list of them.
fn several<'py>(given: &Bound<'py, PyAny>) -> Vec<Bound<'py, PyAny>> {
    let several = given.cast::<PyList>().map(|list| list.iter().collect::<Vec<_>>());
    let several = several.or_else(|_| given.cast::<PyTuple>().map(|tuple| tuple.iter().collect()));
    several.unwrap_or_else(|_| vec![given.clone()])
}

/// Returns the inputs from a path, an array, or a list of them, for this use of their pictures.
fn inputs_of(
    given: &Bound<'_, PyAny>,
    options: &ReadOptions,
    board: &Board,
    pictures: PictureUse,
) -> PyResult<Vec<Input>> {
    let open = if pictures == PictureUse::Only { Input::open_views } else { Input::open };
    several(given)
        .iter()
        .map(|one| match as_path(one) {
            Some(path) => {
                let options = options.clone().options()?;
                given.py().detach(|| open(&path, &options, board)).map_err(failed)
            }
            None => Ok(of_array(one, options)?.into()),
        })
        .collect()
}

/// Returns the recording of another camera: a path (events or images), or events in memory.
fn other_input(given: &Bound<'_, PyAny>, options: &ReadOptions, board: &Board) -> PyResult<Input> {
    match as_path(given) {
        Some(path) => {
            let (options, stream) = (options.clone().options()?, options.stream.as_deref());
            given.py().detach(|| Input::open_other(&path, stream, Stamps::default(), &options, board)).map_err(failed)
        }
        None => Ok(of_array(given, options)?.into()),
    }
}

/// Returns the requested source of IMU samples: True for the samples in the recordings, or a file.
fn inertial_request(imu: &Bound<'_, PyAny>, gravity: Option<f64>) -> PyResult<Option<InertialRequest>> {
    let file = match imu.extract::<bool>() {
        Ok(false) => return Ok(None),
        Ok(true) => None,
        Err(_) => Some(imu.extract::<PathBuf>().map_err(|_| {
            PyTypeError::new_err("imu is True for the samples in the recording, or the path of a CSV file of samples")
        })?),
    };
    let settings = InertialSettings::default();
    let gravity = gravity.unwrap_or(settings.gravity);
    if !(9.7..=9.9).contains(&gravity) {
        return Err(PyValueError::new_err("gravity is from 9.7 to 9.9 m/s²"));
    }
    Ok(Some(InertialRequest { file, units: None, settings: InertialSettings { gravity, ..settings } }))
}

/// Returns the inputs, and the board, which is given or recognised in them.
fn inputs_and_board(
    given: &Bound<'_, PyAny>,
    options: &ReadOptions,
    request: &BoardRequest,
    pictures: PictureUse,
    settings: &Settings,
) -> PyResult<(Vec<Input>, ConfirmedBoard)> {
    if let BoardRequest::Given(stated) = request {
        let inputs = inputs_of(given, options, stated, pictures)?;
        let recordings = inputs.iter().filter_map(|input| match input {
            Input::Events(recording) => Some(recording),
            Input::Images(_) | Input::Circles { .. } => None,
        });
        let recordings: Vec<&Recording> = recordings.collect();
        let confirmed = given.py().detach(|| confirm_board(stated, &recordings, pictures, &settings.detection));
        let confirmed = confirmed.map_err(failed)?;
        if let Some(finding) = &confirmed.finding {
            warn(given.py(), &finding.reason)?;
        }
        // Files of circles depend on the board.
        let inputs = match confirmed.board == *stated {
            true => inputs,
            false => inputs_of(given, options, &confirmed.board, pictures)?,
        };
        return Ok((inputs, confirmed));
    }
    // No board is known yet, so the inputs are opened with an arbitrary one. Recordings of events do not depend on it.
    // Files of circles do, but no board can be recognised in them anyway.
    let any =
        CircleBoard { pattern: Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 }, spacing: 1.0, radius: 0.3 }
            .into();
    let inputs = inputs_of(given, options, &any, pictures)?;
    let recordings = inputs.iter().map(|input| match input {
        Input::Events(recording) => Ok(recording),
        Input::Images(_) | Input::Circles { .. } => Err(failed(BoardChoiceError::NoEvents)),
    });
    let recordings = recordings.collect::<PyResult<Vec<&Recording>>>()?;
    let board = given.py().detach(|| choose_board(request, &recordings, &settings.detection)).map_err(failed)?;
    Ok((inputs, board.into()))
}

/// Reads the settings in `file`; without a file, returns the default ones.
pub fn settings_of(file: Option<PathBuf>) -> PyResult<Settings> {
    Ok(file.map(|path| Settings::read(&path)).transpose().map_err(failed)?.unwrap_or_default())
}

/// Parses the description of a board.
pub fn board_request(board: &str) -> PyResult<BoardRequest> {
    board.parse().map_err(|error: BoardError| PyValueError::new_err(error.to_string()))
}

/// Parses the name of a camera model, or "auto"; without a name, returns the usual model.
pub fn model_request(model: Option<&str>) -> PyResult<ModelRequest> {
    let Some(model) = model else { return Ok(ModelRequest::default()) };
    model.parse().map_err(|error| PyValueError::new_err(format!("{error} auto: not {model:?}")))
}

fn picture_use(name: &str) -> PyResult<PictureUse> {
    match name {
        "cross-check" => Ok(PictureUse::CrossCheck),
        "joint" => Ok(PictureUse::Joint),
        "only" => Ok(PictureUse::Only),
        "ignore" => Ok(PictureUse::Ignore),
        _ => Err(PyValueError::new_err("frames is \"cross-check\", \"joint\", \"only\" or \"ignore\"")),
    }
}

/// Calibrate a camera from recordings of a board.
///
/// events: a file, events in memory, or a list of them, all of one camera. In memory they are a structured array, an array of N x 4 numbers, or a dict or
/// data frame of the columns t, x, y and p.
/// board: such as "acircles:9x4:55mm:r17.5mm": layout, rows x columns, spacing (acircles: half the distance in a row),
/// radius. "auto:55mm:r17.5mm" recognises layout, rows and columns.
/// model: the camera model, or "auto"; without it, "radtan", or another model if radtan cannot follow the lens.
/// sensor: (width, height) in pixels; needed for arrays, and for files that do not contain it.
/// columns, time_unit, stream: as for read.
/// settings: a settings file (TOML).
/// frames: use of the camera's own frames, if a file contains them: "cross-check" compares them with the events,
/// "joint" estimates the camera from frames and events together, "only" uses the frames alone (also of a folder or bag of images),
/// "ignore" does not read them.
/// imu: also calibrate the IMU: True for the samples in the recording, or the path of a CSV file of samples. gravity:
/// magnitude of gravity at the site of the recording, 9.7 to 9.9 m/s².
/// with_: the recording of another camera on the same mount, or a list of them: a path (events, a folder of images, a bag) or events in
/// memory. with_sensor, with_stream: sensor and stream of these cameras. rolling_shutter: rows of their images are exposed one after the other.
/// progress: called with a line of text when a stage begins. An exception that it raises ends the calibration.
///
/// Returns a Calibration. If the IMU or another camera cannot be calibrated, a warning and not_calibrated of the result
/// contain the reason. Raises Error if the camera cannot be calibrated, and ValueError or TypeError for wrong
/// arguments.
#[pyfunction]
#[pyo3(signature = (events, *, board, model=None, sensor=None, columns=None, time_unit=None, stream=None, settings=None, frames="cross-check", imu=None, gravity=None, with_=None, with_sensor=None, with_stream=None, rolling_shutter=false, progress=None))]
#[expect(clippy::too_many_arguments, reason = "all but the first are named by the caller")]
pub fn calibrate(
    py: Python<'_>,
    events: &Bound<'_, PyAny>,
    board: &str,
    model: Option<&str>,
    sensor: Option<(u16, u16)>,
    columns: Option<String>,
    time_unit: Option<String>,
    stream: Option<String>,
    settings: Option<PathBuf>,
    frames: &str,
    imu: Option<&Bound<'_, PyAny>>,
    gravity: Option<f64>,
    with_: Option<&Bound<'_, PyAny>>,
    with_sensor: Option<(u16, u16)>,
    with_stream: Option<String>,
    rolling_shutter: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Calibration> {
    let request = board_request(board)?;
    let options = ReadOptions { sensor, columns, time_unit, stream };
    let options_of_others = ReadOptions { sensor: with_sensor.or(sensor), stream: with_stream, ..options.clone() };
    let settings = settings_of(settings)?;
    let pictures = picture_use(frames)?;
    let (inputs, confirmed) = inputs_and_board(events, &options, &request, pictures, &settings)?;
    let others = with_.map_or_else(
        || Ok(Vec::new()),
        |given| several(given).iter().map(|one| other_input(one, &options_of_others, &confirmed.board)).collect(),
    )?;
    let job = CalibrationJob {
        inputs: Input::join(inputs),
        others,
        rolling_shutter,
        inertial: imu.map_or(Ok(None), |imu| inertial_request(imu, gravity))?,
        confirmed,
        model: model_request(model)?,
        sensor: options.options()?.sensor,
        pictures,
        settings,
    };
    let mut raised = None;
    let calibrated = interruptible(py, |stop| {
        let mut last = String::new();
        job.calibrate(|Step { text, .. }| {
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
    if let Some(error) = raised {
        return Err(error);
    }
    let (calibrated, failures) = calibrated?;
    for (what, reason) in &failures {
        warn(py, &format!("{what} was not calibrated: {reason}"))?;
    }
    Ok(Calibration { job, calibrated, failures })
}
