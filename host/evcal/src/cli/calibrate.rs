//! `evcal calibrate`.

pub mod fixed;
pub mod work;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use super::settings::read_settings;
use evcal_calibrate::calibrate::inertia::InertialRequest;
use evcal_calibrate::inertial;
use evcal_calibrate::inertial::settings::InertialSettings;
use evcal_calibrate::inertial::units::MessageUnits;
use evcal_calibrate::quality::verdict::Finding;
use evcal_calibrate::second_camera::error::SecondCameraError;
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::PictureUse;
use evcal_calibrate::task::board_choice::{BoardChoiceError, ConfirmedBoard, choose_board, confirm_board};
use evcal_calibrate::task::input::{Input, InputError};
use evcal_calibrate::task::parameter_request::ParameterRequests;
use evcal_core::circle::Extraction;
use evcal_core::sensor::Sensor;
use evcal_detection::circles::file::InputKind;
use evcal_detection::circles::serial::{SerialAddress, SerialError};
use evcal_detection::detection::settings::{DetectionSettings, Grid};
use evcal_files::folder::{FolderError, OutputFolder};
use evcal_files::remedy::{Remedy as _, Words};
use evcal_files::visible;
use evcal_geometry::board::Board;
use evcal_geometry::board::request::BoardRequest;
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;
use evcal_report::output::folder::{FOLDERS, is_result};
use evcal_solve::initial::model_choice::{ModelRequest, USUAL};
use evcal_solve::trajectory::RotationSpline;
use event_recordings::image_folder::{ImageFolder, Stamps};
use event_recordings::images::Images;
use event_recordings::{Recording, RecordingOptions};

use self::fixed::{FixedCamera, FixedCameras};
use self::work::{Other, Work};
use super::output_arguments::OutputArguments;
use super::progress::{Waiting, short_name};
use super::source_arguments::SourceArguments;
use super::{Failure, UsageError, print, value};

/// Heading of the options for experts.
const METHOD: &str = "Method";

/// Progress message while a serial port delivers circles.
pub(super) const LISTENING: &str = "listening to the serial port";

/// Arguments of `evcal calibrate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Recordings of one camera: AEDAT 2, 3 or 4, Prophesee RAW or DAT, ROS bags (ROS 1, MCAP, SQLite), npy or npz, HDF5, CSV or text,
    /// Event Stream, EventCalib binary, .dvraw, pcap (docs/formats.md); or circles without events: a file of circles, or a recorded stream or
    /// the serial port of a microcontroller with the detector, serial:PORT?baud=921600&seconds=10
    #[arg(required = true)]
    recordings: Vec<PathBuf>,
    #[command(flatten)]
    calibration: CalibrationArguments,
    #[command(flatten, next_help_heading = "Input")]
    source: SourceArguments,
    #[command(flatten, next_help_heading = "Other cameras on the same mount")]
    second: SecondCameraArguments,
}

/// Options of `evcal calibrate` for cameras that are rigidly connected to the first one.
#[derive(clap::Args)]
struct SecondCameraArguments {
    /// Recording of another camera, rigidly connected to the first, of the same board at the same time; estimates its pose and clock
    /// offset (docs/second-camera.md). Events, a folder of images with data.csv (EuRoC format), or a bag with images (if it also has
    /// events, name the topic with --with-stream); can be repeated
    #[arg(long, value_name = "RECORDING", conflicts_with = "frames_only")]
    with: Vec<PathBuf>,
    /// Stream or topic of events or images to read from the file of --with [default: as --stream, or the only topic of images]; can
    /// be repeated, in the order of --with
    #[arg(long, value_name = "STREAM", requires = "with")]
    with_stream: Vec<String>,
    /// Sensor size of the camera of --with in pixels, if its file does not contain it [default: as --sensor]; can be repeated, in the
    /// order of --with
    #[arg(long, value_name = "WxH", value_parser = value::sensor, requires = "with")]
    with_sensor: Vec<Sensor>,
    /// Camera model of the camera of --with [default: as --model]; can be repeated, in the order of --with
    #[arg(long, value_name = "MODEL", value_parser = value::model_request(), requires = "with")]
    with_model: Vec<ModelRequest>,
    /// Meaning of the timestamps of the images of --with
    #[arg(
        long,
        requires = "with",
        default_value = Stamps::default().name(),
        value_parser = value::named(Stamps::ALL, Stamps::name, Stamps::description)
    )]
    with_stamps: Stamps,
    /// The camera of --with has a rolling shutter: it exposes the rows of an image one after the other
    #[arg(long, requires = "with")]
    rolling_shutter: bool,
    /// With --imu or --with, fix the first camera's intrinsics at the values in this calibration or camera file [default: estimate
    /// them together with the other parameters]
    #[arg(long, value_name = "FILE|DIR")]
    camera: Option<PathBuf>,
    /// The same for the camera of --with; can be repeated, in the order of --with
    #[arg(long, value_name = "FILE|DIR", requires = "with")]
    with_camera: Vec<PathBuf>,
}

impl SecondCameraArguments {
    /// Rejects an option that is given more often than `--with`. These options belong to the recordings of `--with` in
    /// order.
    fn one_for_each_other(&self) -> Result<(), UsageError> {
        let counts = [
            ("--with-stream", self.with_stream.len()),
            ("--with-sensor", self.with_sensor.len()),
            ("--with-model", self.with_model.len()),
            ("--with-camera", self.with_camera.len()),
        ];
        match counts.into_iter().find(|(_, count)| *count > self.with.len()) {
            Some((name, _)) => Err(UsageError(format!(
                "there are more {name} than --with; give at most one for each, in the same order"
            ))),
            None => Ok(()),
        }
    }

    /// Reads the cameras whose intrinsics are fixed.
    fn fixed_cameras(&self, calibration: &CalibrationArguments) -> Result<FixedCameras, Failure> {
        let together = calibration.imu.is_some() || calibration.with_frames || !self.with.is_empty();
        if self.camera.is_some() && !together {
            let advice = "--camera works only together with --imu, --with or --with-frames: add one of them, or leave out --camera";
            return Err(UsageError(advice.to_owned()).into());
        }
        let first = self.camera.as_deref().map(FixedCamera::read).transpose()?;
        let others = self.with_camera.iter().map(|path| FixedCamera::read(path)).collect::<Result<_, _>>()?;
        Ok(FixedCameras { first, others })
    }
}

/// Options of every subcommand that calibrates.
#[derive(clap::Args)]
pub struct CalibrationArguments {
    #[command(flatten)]
    pub method: MethodArguments,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    #[command(flatten)]
    results: OutputArguments,
    /// Exit with 0 even if the calibration is not good enough
    #[arg(long)]
    accept_any: bool,
    /// Print the calibration as JSON
    #[arg(long)]
    pub json: bool,
    /// Also print all parameters, the figures behind the verdict, all notes, and how many events, circles and frames each stage received and kept
    #[arg(short, long)]
    verbose: bool,
    /// Calibrate from frames only, as ordinary image calibration does: the camera's own, a folder of images, a bag of images, or the
    /// points of a circle track, each frame with its own pose
    #[arg(long, conflicts_with = "joint_frames")]
    frames_only: bool,
    /// Solve for events and the camera's own frames jointly
    #[arg(long)]
    joint_frames: bool,
    /// Cross-check events with the camera's own frames: treat the frames as a second camera, which should get the same pose as the first
    #[arg(long, conflicts_with_all = ["frames_only", "joint_frames"])]
    with_frames: bool,
    /// Also calibrate the IMU, from the samples in the recording, or from a CSV file whose first line contains the
    /// columns with their units: t_us,ax_g,ay_g,az_g,gx_deg_s,gy_deg_s,gz_deg_s (docs/imu.md)
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    imu: Option<Option<PathBuf>>,
    /// Units of the IMU samples in a bag, if its driver does not use m/s² and rad/s: g, deg_s or both, as g,deg_s
    #[arg(long, value_name = "UNITS", requires = "imu")]
    imu_units: Option<MessageUnits>,
    /// Magnitude of gravity at the place of the recording, for --imu
    #[arg(
        long,
        value_name = "M/S²",
        default_value_t = STANDARD_GRAVITY,
        requires = "imu",
        value_parser = value::number(9.7..=9.9, " m/s²")
    )]
    gravity: f64,
    /// Fix a parameter of the lens (k3=0, cx=173.2) or of the board (print-ratio=1.002, bend-x=1.5mm, bend-y=0mm,
    /// radius=17.4mm); can be repeated
    #[arg(long, value_name = "NAME=VALUE", help_heading = METHOD)]
    fix: Vec<String>,
    /// Estimate a parameter of the lens, or print-ratio, bend-x, bend-y or radius of the board, even if the recording hardly determines
    /// it; can be repeated
    #[arg(long, value_name = "NAME", help_heading = METHOD)]
    free: Vec<String>,
}

/// Options for the board, the camera model and the method.
#[derive(clap::Args)]
pub struct MethodArguments {
    /// Board: circles such as acircles:9x4:55mm:r17.5mm (layout, rows x columns, spacing, radius), checkerboard:6x9:25mm (rows x columns of
    /// inner corners), aprilgrid:6x6:35.2mm:0.3, apriltags:3x4:30mm:0.25, charuco:5x7:30mm:22mm:DICT_5X5_100, or a target file of Kalibr;
    /// auto:25mm recognises a board of squares (length of a square or tag), auto:55mm:r17.5mm a grid of circles
    #[arg(long, value_parser = super::board_argument::board_request)]
    pub board: BoardRequest,
    /// Camera model; auto chooses the simplest model that fits held-out points as well as the best one [default: radtan, or another
    /// model if radtan cannot follow the lens]
    #[arg(long, value_parser = super::value::model_request())]
    model: Option<ModelRequest>,
    /// Circle extraction: hard or soft [default: hard]
    #[arg(long, value_parser = extraction, help_heading = METHOD)]
    extraction: Option<Extraction>,
    /// Spline of the rotation: quaternion or so3 [default: quaternion]
    #[arg(long, help_heading = METHOD)]
    rotation: Option<RotationSpline>,
    /// Grid finder: lattice or opencv [default: lattice]
    #[arg(long, help_heading = METHOD)]
    grid: Option<Grid>,
    /// Settings file (TOML); docs/settings.md lists names and defaults
    #[arg(long, value_name = "FILE", help_heading = METHOD)]
    settings: Option<PathBuf>,
}

impl MethodArguments {
    /// Returns the requested model.
    pub fn model(&self) -> ModelRequest {
        self.model.unwrap_or_default()
    }

    /// Returns the settings of the file, with the options that replace some of them.
    pub fn settings(&self) -> Result<Settings, Failure> {
        let mut settings = read_settings(self.settings.as_deref(), self.grid)?;
        settings.detection.extraction = self.extraction.unwrap_or(settings.detection.extraction);
        settings.spline.rotation = self.rotation.unwrap_or(settings.spline.rotation);
        Ok(settings)
    }

    /// Returns the given board, or recognises it in the files that contain events.
    pub fn choose_board(
        &self,
        files: &[PathBuf],
        options: &RecordingOptions,
        pictures: PictureUse,
        settings: &DetectionSettings,
    ) -> Result<ConfirmedBoard, Failure> {
        let board = board_in(&self.board, files, options, settings)?;
        let BoardRequest::Given(board) = self.board else { return Ok(board.into()) };
        let recordings = recordings_in(files, options)?;
        Ok(confirmed(&board, &recordings.iter().collect::<Vec<_>>(), pictures, settings)?)
    }
}

/// Returns the stated board, or the board in view if its tags are only numbered, rotated or bordered in another way; prints the
/// difference.
pub(super) fn confirmed(
    board: &Board,
    recordings: &[&Recording],
    pictures: PictureUse,
    settings: &DetectionSettings,
) -> Result<ConfirmedBoard, BoardChoiceError> {
    let confirmed = confirm_board(board, recordings, pictures, settings)?;
    if let Some(Finding { reason, advice, .. }) = &confirmed.finding {
        print::aside(format!("{reason}: {}", advice.worded(&Words::PROGRAM)));
    }
    Ok(confirmed)
}

/// Opens the files that contain events.
fn recordings_in(files: &[PathBuf], options: &RecordingOptions) -> Result<Vec<Recording>, Failure> {
    let mut recordings = Vec::new();
    for file in files.iter().filter(|file| !SerialAddress::is_address(file)) {
        if InputKind::of(file)? == InputKind::Events {
            recordings.push(Recording::new(file, options.clone())?);
        }
    }
    Ok(recordings)
}

/// Returns the requested board, or recognises it in the files that contain events, and prints it.
pub(super) fn board_in(
    request: &BoardRequest,
    files: &[PathBuf],
    options: &RecordingOptions,
    settings: &DetectionSettings,
) -> Result<Board, Failure> {
    if let BoardRequest::Given(board) = request {
        return Ok(*board);
    }
    let recordings = recordings_in(files, options)?;
    let recordings: Vec<&Recording> = recordings.iter().collect();
    let board = choose_board(request, &recordings, settings)?;
    print::aside(format!("recognised board: {board}"));
    Ok(board)
}

pub(super) fn extraction(text: &str) -> Result<Extraction, &'static str> {
    match text {
        "hard" => Ok(Extraction::Hard),
        "soft" => Ok(Extraction::Soft),
        _ => Err("write hard or soft"),
    }
}

impl CalibrationArguments {
    /// Returns the parameters that are fixed or always estimated.
    pub fn parameters(&self) -> Result<ParameterRequests, UsageError> {
        let model = match self.method.model() {
            ModelRequest::Given(model) => Some(model),
            ModelRequest::Usual => Some(USUAL),
            ModelRequest::Auto => None,
        };
        ParameterRequests::new(model, &self.fix, &self.free).map_err(|error| UsageError(error.advised(&Words::PROGRAM)))
    }

    /// Returns the request for an IMU calibration, if there is one.
    fn inertial_request(&self) -> Option<InertialRequest> {
        let file = self.imu.clone()?;
        Some(InertialRequest {
            file,
            units: self.imu_units,
            settings: InertialSettings { gravity: self.gravity, ..InertialSettings::default() },
        })
    }

    /// Opens the folder for the results; fails if it contains results, unless `--force` is given.
    pub fn open_folder(&self) -> Result<OutputFolder, FolderError> {
        self.results.open_folder(&self.output, is_result, FOLDERS)
    }
}

/// Runs `evcal calibrate`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let outcome = open_and_calibrate(arguments);
    match &outcome {
        Err(failure) if arguments.calibration.json && !failure.is_negative() => failure.print_json()?,
        _ => {}
    }
    outcome
}

fn open_and_calibrate(arguments: &Arguments) -> super::Outcome {
    // Mistakes in the arguments are reported before the work begins.
    arguments.second.one_for_each_other()?;
    arguments.calibration.parameters()?;
    let settings = arguments.calibration.method.settings()?;
    // A file of IMU samples is read here only to report mistakes. It is read again after the calibration of the camera,
    // because it may still grow during a live recording.
    if let Some(Some(samples)) = &arguments.calibration.imu {
        inertial::csv::read(samples)?;
    }
    let folder = arguments.calibration.open_folder()?;
    let others = OtherCameras {
        recordings: &arguments.second.with,
        streams: &arguments.second.with_stream,
        sensors: &arguments.second.with_sensor,
        models: &arguments.second.with_model,
        stamps: arguments.second.with_stamps,
        rolling_shutter: arguments.second.rolling_shutter,
    };
    let fixed = arguments.second.fixed_cameras(&arguments.calibration)?;
    let recordings = CameraRecordings { first: &arguments.recordings, others, fixed };
    let waiting = Waiting::of_stages(arguments.calibration.json);
    calibrate_recordings(recordings, &arguments.source.options(), &arguments.calibration, &settings, &folder, waiting)
}

/// Recordings of one camera, and one recording per other camera on its mount.
pub struct CameraRecordings<'a> {
    pub first: &'a [PathBuf],
    pub others: OtherCameras<'a>,
    pub fixed: FixedCameras,
}

/// One recording per other camera, with its options.
#[derive(Clone, Copy, Default)]
pub struct OtherCameras<'a> {
    pub recordings: &'a [PathBuf],
    /// Streams to read, in the order of `recordings`; may be fewer.
    pub streams: &'a [String],
    /// Sensor sizes, in the order of `recordings`; may be fewer.
    pub sensors: &'a [Sensor],
    /// Camera models, in the order of `recordings`; may be fewer.
    pub models: &'a [ModelRequest],
    /// Meaning of the timestamps of images.
    pub stamps: Stamps,
    /// `true` if the cameras have a rolling shutter.
    pub rolling_shutter: bool,
}

impl<'a> OtherCameras<'a> {
    /// Returns the recordings, each with its stream if one is given.
    fn with_streams(self) -> impl Iterator<Item = (&'a PathBuf, Option<&'a str>)> {
        let streams = self.streams.iter().map(|stream| Some(stream.as_str())).chain(std::iter::repeat(None));
        self.recordings.iter().zip(streams)
    }
}

impl<'a> CameraRecordings<'a> {
    /// Returns the recordings of a camera without others.
    pub fn alone(first: &'a [PathBuf]) -> Self {
        Self { first, others: OtherCameras::default(), fixed: FixedCameras::default() }
    }
}

/// Calibrates from `recordings` and writes the results.
pub fn calibrate_recordings(
    CameraRecordings { first: recordings, others, fixed }: CameraRecordings,
    options: &RecordingOptions,
    arguments: &CalibrationArguments,
    settings: &Settings,
    folder: &OutputFolder,
    mut waiting: Waiting,
) -> super::Outcome {
    check_others(recordings, others, options)?;
    let mut with_events = recordings.to_vec();
    if arguments.frames_only {
        let of_images = |path: &PathBuf| Images::open_views(path, options.stream.as_deref(), options.damage);
        with_events.retain(|path| !matches!(of_images(path), Ok(Some(_))));
    }
    let pictures = if arguments.frames_only { PictureUse::Only } else { PictureUse::default() };
    let confirmed = arguments.method.choose_board(&with_events, options, pictures, &settings.detection)?;
    let inputs = recordings
        .iter()
        .map(|path| match arguments.frames_only && !SerialAddress::is_address(path) {
            true => Ok(Input::open_views(path, options, &confirmed.board)?),
            false => open_input(path, options, &confirmed.board, folder.path(), |message| {
                waiting.part(LISTENING, message, None);
            }),
        })
        .collect::<Result<Vec<Input>, _>>()?;
    let inputs = Input::join(inputs);
    for input in &inputs {
        if let Input::Events(recording) = input
            && let [first, .., last] = recording.files()[..]
        {
            let (count, first, last) = (recording.files().len(), short_name(first), short_name(last));
            print::aside(format!("{count} consecutive files, {first} to {last}, are read as one recording"));
        }
    }
    let parameters = arguments.parameters()?;
    let rolling_shutter = others.rolling_shutter;
    let open = |(index, (path, stream)): (usize, (&PathBuf, _))| {
        let sensor = others.sensors.get(index).copied().or(options.sensor);
        let model = others.models.get(index).copied().unwrap_or(arguments.method.model());
        let options = RecordingOptions { sensor, ..options.clone() };
        let input = Input::open_other(path, stream, others.stamps, &options, &confirmed.board)?;
        Ok(Other { input, sensor, model })
    };
    let others = others.with_streams().enumerate().map(open).collect::<Result<_, InputError>>()?;
    let work = Work {
        inputs,
        others,
        rolling_shutter,
        fixed,
        confirmed,
        sensor: options.sensor,
        parameters,
        arguments,
        settings,
        readers: None,
    };
    let attempt = work.calibrate(|step| {
        waiting.stage(step.text, step.done);
        ControlFlow::Continue(())
    });
    work.finish(attempt, waiting, folder)
}

/// Refuses wrong recordings of other cameras before they are opened.
fn check_others(recordings: &[PathBuf], others: OtherCameras, options: &RecordingOptions) -> Result<(), Failure> {
    if !others.recordings.is_empty() && recordings.len() > 1 {
        return Err(SecondCameraError::SeveralRecordings.into());
    }
    let own = options.stream.as_deref();
    let place = |path: &PathBuf| path.canonicalize().unwrap_or_else(|_| path.clone());
    let mut known: Vec<(PathBuf, Option<&str>)> = recordings.iter().map(|path| (place(path), own)).collect();
    for (other, stream) in others.with_streams() {
        if stream.is_some() && other.is_dir() && ImageFolder::has_table(other) {
            let folder = visible::path(other);
            return Err(UsageError(format!("{folder} is a folder of images and has no streams: leave out --with-stream, or put the folder after the other files of --with")).into());
        }
        let this = (place(other), stream.or(own));
        if known.contains(&this) {
            return Err(SecondCameraError::SameRecording { file: visible::path(other) }.into());
        }
        known.push(this);
    }
    Ok(())
}

/// Opens a recording, or reads from a serial port. Data from a port are saved to `folder` unless its address contains a file, so that a
/// failed calibration can be repeated.
fn open_input(
    path: &Path,
    options: &RecordingOptions,
    board: &Board,
    folder: &Path,
    progress: impl FnMut(&str),
) -> Result<Input, Failure> {
    if !SerialAddress::is_address(path) {
        return Ok(Input::open(path, options, board)?);
    }
    let mut address = serial_address(path)?;
    address.save_into(folder);
    Ok(Input::listen(&address, board, progress)?)
}

/// Parses the address of a serial port.
pub(super) fn serial_address(path: &Path) -> Result<SerialAddress, UsageError> {
    path.to_string_lossy().parse().map_err(|error: SerialError| UsageError(error.to_string()))
}
