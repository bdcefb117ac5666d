//! `evcal simulate`.

use std::path::PathBuf;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use evcal_files::{text, visible};
use evcal_geometry::board::shape::BoardShape;
use evcal_geometry::board::{Board, any_length};
use evcal_geometry::lens::camera_file;
use evcal_simulator::davis::DavisSettings;
use evcal_simulator::dots::Dots;
use evcal_simulator::effects::Effect;
use evcal_simulator::folder::{SimulatedRecording, WrittenFolder, folders, is_result, write_folder};
use evcal_simulator::inertia::InertialSettings;
use evcal_simulator::lens::{self, usual_lens};
use evcal_simulator::motion_capture::MotionCaptureSettings;
use evcal_simulator::presets::{LightPreset, MotionPreset, SensorPreset};
use evcal_simulator::rays::Rays;
use evcal_simulator::recording::{DAVIS346_SENSOR, RecordingFormat};
use evcal_simulator::scene::SceneSettings;
use evcal_simulator::second_camera::{SecondCamera, SecondCameraSettings};
use evcal_simulator::{Simulation, SimulationSettings};
use serde::de::DeserializeOwned;

use super::output_arguments::OutputArguments;
use super::progress::Waiting;
use super::value::Numbers;
use super::{Failure, UsageError, print, value};

/// Arguments of `evcal simulate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder for events.aedat4 (or .dvraw, .csv, .bin, .raw), truth.json, trajectory.txt, and with
    /// --frames frames.csv, with --imu imu.csv, with --motion-capture motion_capture.txt, with --second-camera second.aedat4,
    /// with --second-frames the folder second
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    results: OutputArguments,
    /// Camera model [default: a radtan lens with a horizontal field of view of about 60 degrees]
    #[arg(long, value_name = "NAME", requires = "parameters", value_parser = value::model())]
    model: Option<ModelKind>,
    /// Parameters of the model: fx,fy,cx,cy in pixels, then the distortion coefficients
    #[arg(long, value_name = "NUMBERS", requires = "model", allow_hyphen_values = true)]
    parameters: Option<Numbers>,
    /// Use the lens and sensor size of this calibration.json or truth.json, or of a folder with one of them
    #[arg(long, value_name = "FILE|DIR", conflicts_with_all = ["model", "parameters", "sensor"])]
    camera: Option<PathBuf>,
    /// Size of the sensor in pixels, or the name of a sensor: dvs128, davis240, davis346, dvxplorer, gen31, genx320, imx636. A name
    /// also sets thresholds, delays and readout of the sensor, and scales the speed of --motion with its width [default: 346x260]
    #[arg(long, value_name = "WIDTHxHEIGHT|NAME", value_parser = sensor)]
    sensor: Option<SensorChoice>,
    /// The board: layout, rows x columns, spacing (asymmetric: half the distance in a row), radius; or checkerboard:6x9:25mm (inner
    /// corners), aprilgrid:6x6:35.2mm:0.3, apriltags:3x4:30mm:0.25, charuco:5x7:30mm:22mm:DICT_5X5_100
    #[arg(long, default_value = "acircles:9x4:55mm:r17.5mm", value_parser = super::board_argument::board)]
    board: Board,
    /// Motion of the camera
    #[arg(
        long,
        default_value = MotionPreset::Slow.name(),
        value_parser = value::named(MotionPreset::ALL, MotionPreset::name, MotionPreset::description)
    )]
    motion: MotionPreset,
    /// Quality of the light and the pixels
    #[arg(
        long,
        default_value = LightPreset::Default.name(),
        value_parser = value::named(LightPreset::ALL, LightPreset::name, LightPreset::description)
    )]
    light: LightPreset,
    /// Length of the recording
    #[arg(long, value_name = "TIME", default_value = "6s", value_parser = value::seconds)]
    duration: f64,
    /// Seed of the random numbers; the same seed gives the same files
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Format of the recording
    #[arg(
        long,
        default_value = RecordingFormat::Aedat4.name(),
        value_parser = value::named(RecordingFormat::ALL, RecordingFormat::name, RecordingFormat::description)
    )]
    format: RecordingFormat,
    /// Disturbances, separated by commas: flicker:100Hz:20% (of lamps), background (textured, moving), hand (over part of the
    /// board), glare, smudges (on the lens), vignetting:60% (less light in the corners), defocus:2px, hot-pixels:300,
    /// dead-columns:5
    #[arg(long, value_name = "EFFECTS", value_delimiter = ',')]
    effects: Vec<Effect>,
    /// Shapes printed instead of the dots of a board of circles
    #[arg(
        long,
        default_value = Dots::Circles.name(),
        value_parser = value::named(Dots::ALL, Dots::name, Dots::description)
    )]
    dots: Dots,
    /// Scale of the print along x (a row) divided by its scale along y, for example 1.003
    #[arg(long, value_name = "RATIO", value_parser = value::number(0.5..=2.0, ""))]
    print_ratio: Option<f64>,
    /// Bend of the board along x and along y: distance of its centre behind its edges; negative towards the camera
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, value_parser = bend)]
    bend: Option<[f64; 2]>,
    /// Radius of the printed circles, or half the width of a printed dark square or module, if it differs from --board
    #[arg(long, value_name = "LENGTH", value_parser = printed_radius)]
    printed_radius: Option<f64>,
    /// Also simulate frames with a global shutter, at this rate per second [default: 25] (aedat4 and dvraw)
    #[arg(long, value_name = "RATE", num_args = 0..=1, default_missing_value = "25", value_parser = value::number(0.1..=1000.0, " per second"))]
    frames: Option<f64>,
    /// Give the frames another lens (parameters of the same model), to test that a calibration detects it
    #[arg(long, value_name = "NUMBERS", requires = "frames", allow_hyphen_values = true)]
    frame_lens: Option<Numbers>,
    /// Also simulate IMU samples, 1000 per second (aedat4 and dvraw): perfect, at the camera's position; davis346, next to the
    /// camera with filters, scale and misalignment; or a JSON file (the part "imu" of "davis.settings" in a truth.json)
    #[arg(long, value_name = "UNIT", num_args = 0..=1, default_missing_value = "perfect")]
    imu: Option<String>,
    /// Also simulate motion capture: poses of a marker body on the camera (TUM), 120 per second with 0.3 mm and 0.2 degrees of
    /// noise; or a JSON file (the part "motion_capture.settings" of a truth.json)
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "")]
    motion_capture: Option<String>,
    /// Also simulate a second event camera, 100 mm next to the first and rotated by some degrees, with its own lens, noise and
    /// clock (second.aedat4); or a JSON file (the part "second_camera.settings" of a truth.json)
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "")]
    second_camera: Option<String>,
    /// The second camera takes frames instead of events, 30 per second with 640x512 pixels, written to the folder second with
    /// data.csv and images (EuRoC format); for other frames, set "frames" in the file of --second-camera
    #[arg(long)]
    second_frames: bool,
    /// Print the truth as JSON
    #[arg(long)]
    json: bool,
    /// Print all settings of the simulation
    #[arg(short, long)]
    verbose: bool,
}

/// Value of `--sensor`.
#[derive(Clone, Copy, Debug)]
enum SensorChoice {
    /// Size of a sensor with the pixels of a DAVIS346.
    Size(Sensor),
    /// A sensor with its own pixels.
    Preset(SensorPreset),
}

impl SensorChoice {
    const fn size(self) -> Sensor {
        match self {
            Self::Size(size) => size,
            Self::Preset(preset) => preset.size(),
        }
    }
}

fn sensor(text: &str) -> Result<SensorChoice, String> {
    let all = SensorPreset::ALL;
    if let Some(preset) = all.iter().find(|preset| preset.name() == text) {
        return Ok(SensorChoice::Preset(*preset));
    }
    let names: Vec<&str> = all.iter().map(|preset| preset.name()).collect();
    value::sensor(text).map(SensorChoice::Size).map_err(|error| format!("{error}, or one of {}", names.join(", ")))
}

/// Runs `evcal simulate`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let (camera, sensor) = lens(arguments)?;
    let (pixels, motion) = (arguments.light.sensor(), arguments.motion.settings(arguments.duration));
    let (pixels, motion) = match arguments.sensor {
        Some(SensorChoice::Preset(preset)) => (preset.pixels(pixels), preset.motion(motion)),
        Some(SensorChoice::Size(_)) | None => (pixels, motion),
    };
    let mut scene = SceneSettings { dots: arguments.dots, printed: printed(arguments)?, ..SceneSettings::default() };
    let mut pixels = pixels;
    let room = u32::from(sensor.width) * u32::from(sensor.height);
    for effect in &arguments.effects {
        let most = match effect {
            Effect::HotPixels(count) if *count > room => Some(("hot-pixels", room)),
            Effect::DeadColumns(count) if *count > u32::from(sensor.width) => {
                Some(("dead-columns", sensor.width.into()))
            }
            _ => None,
        };
        if let Some((name, most)) = most {
            return Err(UsageError(format!("--effects {name}: a sensor of {sensor} pixels has at most {most}")).into());
        }
        effect.apply(&mut scene, &mut pixels);
    }
    let settings =
        SimulationSettings { duration: arguments.duration, seed: arguments.seed, scene, sensor: pixels, motion };
    let davis = davis_settings(arguments)?;
    let mut simulation = Simulation::new(Rays::new(&camera, sensor), arguments.board, settings)?;
    let frame_camera = match &arguments.frame_lens {
        Some(parameters) => Some(of_model(camera.kind(), parameters)?),
        None => None,
    };
    if let Some(lens) = &frame_camera {
        simulation = simulation.with_frame_rays(Rays::new(lens, sensor));
    }
    let second_camera = second_camera(arguments, &camera, sensor)?;
    let folders = folders(second_camera.as_ref());
    let folder = arguments.results.open_folder(&arguments.output, is_result, folders)?;
    let mut waiting = Waiting::new(arguments.json);
    let recorded = SimulatedRecording {
        simulation: &simulation,
        camera: &camera,
        frame_camera: frame_camera.as_ref(),
        davis,
        motion_capture: motion_capture(arguments)?,
        second_camera: second_camera.as_ref(),
        format: arguments.format,
    };
    let slices = recorded.slice_count().max(1);
    let written = write_folder(&folder, &recorded, |done| {
        waiting.stage("simulating", Some(done as f64 / slices as f64));
    })?;
    waiting.finish();
    print_summary(arguments, &written)
}

fn print_summary(arguments: &Arguments, written: &WrittenFolder) -> super::Outcome {
    let WrittenFolder { files, truth, counts, davis } = written;
    if arguments.json {
        return print::json(truth);
    }
    if arguments.verbose {
        print::pretty(truth)?;
    }
    let total = counts.off + counts.on;
    print::line(format!(
        "{total} events in {} s ({:.1} % ON), board at {:.0} px/s on average",
        arguments.duration,
        100.0 * counts.on as f64 / total.max(1) as f64,
        truth.mean_speed,
    ))?;
    if truth.davis.is_some() {
        print::line(format!("{} frames, {} IMU samples", davis.frames.len(), davis.imu.len()))?;
    }
    files.iter().try_for_each(|file| print::line(visible::path(file)))
}

/// Returns the shape of the printed board; `None` if it is the nominal shape.
fn printed(arguments: &Arguments) -> Result<Option<BoardShape>, UsageError> {
    let nominal = BoardShape::nominal(&arguments.board);
    let shape = BoardShape {
        print_ratio: arguments.print_ratio.unwrap_or(nominal.print_ratio),
        bend: arguments.bend.unwrap_or(nominal.bend),
        radius: arguments.printed_radius.unwrap_or(nominal.radius),
    };
    if !shape.is_possible(&arguments.board) {
        return Err(UsageError(format!(
            "this print ratio, bend and radius are impossible for {}: circles must not overlap, dark squares must not cover the light ones, and a bend must be below half the board's side",
            arguments.board
        )));
    }
    Ok((shape != nominal).then_some(shape))
}

/// Reads the bend of a board along x and y (m).
fn bend(text: &str) -> Result<[f64; 2], String> {
    text.split_once(',')
        .and_then(|(x, y)| Some([any_length(x)?, any_length(y)?]))
        .ok_or_else(|| "write two lengths with their units, along x and along y, for example 2mm,0mm".to_owned())
}

/// Reads the radius of a printed circle, or half the width of a printed square (m).
fn printed_radius(text: &str) -> Result<f64, String> {
    any_length(text)
        .filter(|radius| *radius > 0.0)
        .ok_or_else(|| "write a length above 0 with its unit, for example 17mm".to_owned())
}

/// Returns the settings of the requested frames and IMU samples.
fn davis_settings(arguments: &Arguments) -> Result<DavisSettings, Failure> {
    let settings = DavisSettings {
        frames: arguments.frames.map(|rate| arguments.light.frames(rate)),
        imu: arguments.imu.as_deref().map(|unit| inertial_unit(unit, arguments.light)).transpose()?,
    };
    if settings != DavisSettings::default() && !arguments.format.contains_more_than_events() {
        return Err(UsageError("frames and IMU samples need --format aedat4 or dvraw".to_owned()).into());
    }
    settings.check()?;
    Ok(settings)
}

/// Returns the settings of an IMU by name or from a file.
fn inertial_unit(unit: &str, light: LightPreset) -> Result<InertialSettings, Failure> {
    match unit {
        "perfect" => Ok(light.inertia()),
        "davis346" => Ok(InertialSettings::davis346()),
        file => {
            let wrong = |error: &dyn std::fmt::Display| {
                UsageError(format!("--imu {file}: {error}: write perfect, davis346 or a JSON file"))
            };
            let text = text::read(file.as_ref(), text::SETTINGS).map_err(|error| wrong(&error))?;
            Ok(serde_json::from_str(&text).map_err(|error| wrong(&error))?)
        }
    }
}

/// Returns the settings of motion capture, if it is requested.
fn motion_capture(arguments: &Arguments) -> Result<Option<MotionCaptureSettings>, Failure> {
    let settings: Option<MotionCaptureSettings> =
        usual_or_file("--motion-capture", arguments.motion_capture.as_deref())?;
    settings.as_ref().map(MotionCaptureSettings::check).transpose()?;
    Ok(settings)
}

/// Returns the second camera, if it is requested, next to a first camera with the lens `first`.
fn second_camera(arguments: &Arguments, first: &Camera<f64>, sensor: Sensor) -> Result<Option<SecondCamera>, Failure> {
    let mut settings: Option<SecondCameraSettings> =
        usual_or_file("--second-camera", arguments.second_camera.as_deref())?;
    if arguments.second_frames {
        settings.get_or_insert_default().frames.get_or_insert_default();
    }
    Ok(settings.map(|settings| SecondCamera::new(settings, first, sensor, arguments.seed)).transpose()?)
}

/// Returns the settings of an option: none, the defaults, or the content of a JSON file.
fn usual_or_file<T: Default + DeserializeOwned>(option: &str, value: Option<&str>) -> Result<Option<T>, UsageError> {
    match value {
        None => Ok(None),
        Some("") => Ok(Some(T::default())),
        Some(file) => {
            let wrong = |error: &dyn std::fmt::Display| {
                UsageError(format!("{option} {file}: {error}: give a JSON file, or no value"))
            };
            let text = text::read(file.as_ref(), text::SETTINGS).map_err(|error| wrong(&error))?;
            serde_json::from_str(&text).map(Some).map_err(|error| wrong(&error))
        }
    }
}

/// Returns the lens and the size of the sensor.
fn lens(arguments: &Arguments) -> Result<(Camera<f64>, Sensor), Failure> {
    if let Some(file) = &arguments.camera {
        return Ok(camera_file::read(file)?);
    }
    let sensor = arguments.sensor.map_or(DAVIS346_SENSOR, SensorChoice::size);
    let camera = match (arguments.model, &arguments.parameters) {
        (Some(kind), Some(parameters)) => of_model(kind, parameters)?,
        _ => usual_lens(sensor)?,
    };
    Ok((camera, sensor))
}

fn of_model(kind: ModelKind, Numbers(parameters): &Numbers) -> Result<Camera<f64>, UsageError> {
    lens::lens(kind, parameters).map_err(|error| UsageError(error.to_string()))
}
