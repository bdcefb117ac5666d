//! `evcal simulate`.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::{fmt, fs};

use clap::ValueEnum;
use evcal::board::Board;
use evcal::lens::camera_file::{self, CameraDescription};
use evcal::recording::{aedat4, event_calib, text};
use evcal::simulate::davis::{DavisDescription, DavisSettings, DavisTruth};
use evcal::simulate::frame::ExposureModel;
use evcal::simulate::inertia::InertialSettings;
use evcal::simulate::motion::MotionSettings;
use evcal::simulate::rays::Rays;
use evcal::simulate::recording::{self, DAVIS346_SENSOR, RecordingFormat};
use evcal::simulate::scene::SceneSettings;
use evcal::simulate::sensor::SensorModel;
use evcal::simulate::truth::Truth;
use evcal::simulate::{EventCounts, Simulation, SimulationSettings};
use evcal::trajectory::tum;
use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;

use super::{UsageError, print, progress, value};

/// Rate of the poses in the trajectory file in hertz.
const TRAJECTORY_RATE: f64 = 1000.0;

/// Arguments of `evcal simulate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Directory for events.aedat4 (or .dvraw, .csv, .bin), truth.json, trajectory.txt, and with
    /// --frames frames.csv, with --imu imu.csv
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Camera model [default: a radtan lens with a field of view of about 55 degrees]
    #[arg(long, value_name = "NAME", requires = "parameters", value_parser = value::model())]
    model: Option<ModelKind>,
    /// Parameters of the model: fx,fy,cx,cy in pixels, then the distortion coefficients
    #[arg(long, value_name = "NUMBERS", requires = "model", value_delimiter = ',', allow_hyphen_values = true)]
    parameters: Vec<f64>,
    /// Take lens and sensor size from this calibration.json or truth.json
    #[arg(long, value_name = "FILE", conflicts_with_all = ["model", "parameters", "sensor"])]
    camera: Option<PathBuf>,
    /// Size of the sensor in pixels [default: 346x260]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = value::sensor)]
    sensor: Option<Sensor>,
    /// The board: layout, rows x columns, spacing (asymmetric: half the distance in a row), radius
    #[arg(long, default_value = "acircles:9x4:55mm:r17.5mm")]
    board: Board,
    /// How fast the camera moves
    #[arg(long, value_enum, default_value_t = Motion::Slow)]
    motion: Motion,
    /// How good the light and the pixels are
    #[arg(long, value_enum, default_value_t = Light::Default)]
    light: Light,
    /// Length of the recording
    #[arg(long, value_name = "TIME", default_value = "6s", value_parser = value::seconds)]
    duration: f64,
    /// Seed of all that is random; the same seed gives the same files
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Format of the recording; dvraw is what a DAVIS346 sends over USB
    #[arg(long, value_enum, default_value_t = RecordingFile::Aedat4)]
    format: RecordingFile,
    /// Frames too, with a global shutter, so many a second [default: 25] (aedat4 and dvraw)
    #[arg(long, value_name = "RATE", num_args = 0..=1, default_missing_value = "25")]
    frames: Option<f64>,
    /// Another lens for the frames, to see a calibration notice: parameters of the same model
    #[arg(long, value_name = "NUMBERS", requires = "frames", value_delimiter = ',', allow_hyphen_values = true)]
    frame_lens: Vec<f64>,
    /// Inertial samples too, 1000 a second (aedat4 and dvraw)
    #[arg(long)]
    imu: bool,
    /// Print the truth as JSON
    #[arg(long)]
    json: bool,
    /// Print all settings of the simulation
    #[arg(short, long)]
    verbose: bool,
}

/// Motion presets.
#[derive(Clone, Copy, ValueEnum)]
enum Motion {
    /// 150 px/s
    Slow,
    /// 350 px/s
    Fast,
    /// 700 px/s
    Blur,
    /// 350 px/s, with pauses, and looks away from the board
    Interrupted,
    /// 350 px/s, the board far away
    Far,
    /// 350 px/s, the board hardly tilted
    HeadOn,
    /// 350 px/s, in one corner of the image only
    Corner,
}

/// Presets of the pixels.
#[derive(Clone, Copy, ValueEnum)]
enum Light {
    /// A DAVIS346-like sensor in a well-lit room
    Default,
    /// The same in dim light: slow pixels, strong noise
    Low,
    /// Neither noise nor delay nor mismatch
    Ideal,
}

/// Formats of recordings, by their extension.
#[derive(Clone, Copy, ValueEnum)]
enum RecordingFile {
    Aedat4,
    Dvraw,
    Csv,
    Bin,
}

/// Runs `evcal simulate`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let (camera, sensor) = lens(arguments)?;
    let settings = SimulationSettings {
        duration: arguments.duration,
        seed: arguments.seed,
        scene: SceneSettings::default(),
        sensor: match arguments.light {
            Light::Default => SensorModel::default(),
            Light::Low => SensorModel::low_light(),
            Light::Ideal => SensorModel::ideal(),
        },
        motion: match arguments.motion {
            Motion::Slow => MotionSettings::slow(),
            Motion::Fast => MotionSettings::fast(),
            Motion::Blur => MotionSettings::blur(),
            Motion::Far => MotionSettings::far(),
            Motion::HeadOn => MotionSettings::head_on(),
            Motion::Corner => MotionSettings::corner(),
            Motion::Interrupted => MotionSettings::interrupted(arguments.duration),
        },
    };
    let davis = davis_settings(arguments)?;
    let mut simulation = Simulation::new(Rays::new(&camera, sensor), arguments.board, settings)?;
    let mut frame_camera = None;
    if !arguments.frame_lens.is_empty() {
        let lens = of_model(camera.kind(), &arguments.frame_lens)?;
        simulation = simulation.with_frame_rays(Rays::new(&lens, sensor));
        frame_camera = Some(CameraDescription::new(&lens));
    }

    let directory = &arguments.output;
    fs::create_dir_all(directory).map_err(|error| at(directory, error))?;
    let (name, format) = match arguments.format {
        RecordingFile::Aedat4 if davis == DavisSettings::default() => {
            ("events.aedat4", RecordingFormat::Events(aedat4::OUTPUT))
        }
        RecordingFile::Aedat4 => ("events.aedat4", RecordingFormat::Aedat4),
        RecordingFile::Dvraw => ("events.dvraw", RecordingFormat::Davis346),
        RecordingFile::Csv => ("events.csv", RecordingFormat::Events(text::OUTPUT)),
        RecordingFile::Bin => ("events.bin", RecordingFormat::Events(event_calib::OUTPUT)),
    };
    let recording = directory.join(name);
    let (counts, davis_truth) = simulate(&simulation, &davis, &recording, format, arguments.json)?;
    let mut files = vec![recording];
    let mut truth = Truth::new(&camera, &simulation, counts);
    if davis != DavisSettings::default() {
        truth.davis = Some(DavisDescription { settings: davis, frame_camera, imu_bias: davis_truth.bias });
    }
    let mut trajectory = Vec::new();
    tum::write(&mut trajectory, &simulation.trajectory(TRAJECTORY_RATE))?;
    let mut put = |name: &str, content: &[u8]| {
        let path = directory.join(name);
        fs::write(&path, content).map_err(|error| at(&path, error))?;
        files.push(path);
        Ok::<(), String>(())
    };
    put("truth.json", (serde_json::to_string_pretty(&truth)? + "\n").as_bytes())?;
    put("trajectory.txt", &trajectory)?;
    if davis.frames.is_some() {
        put("frames.csv", davis_truth.frames_csv().as_bytes())?;
    }
    if davis.imu.is_some() {
        put("imu.csv", davis_truth.imu_csv().as_bytes())?;
    }

    if arguments.json {
        return print::json(&truth);
    }
    if arguments.verbose {
        print::line(serde_json::to_string_pretty(&truth)?)?;
    }
    let total = counts.off + counts.on;
    print::line(format!(
        "{total} events in {} s ({:.1} % ON), board at {:.0} px/s on average",
        arguments.duration,
        100.0 * counts.on as f64 / total.max(1) as f64,
        truth.mean_speed,
    ))?;
    if davis != DavisSettings::default() {
        print::line(format!("{} frames, {} inertial samples", davis_truth.frames.len(), davis_truth.imu.len()))?;
    }
    files.iter().try_for_each(|file| print::line(file.display()))
}

/// Frames and inertial samples, as far as asked for.
fn davis_settings(arguments: &Arguments) -> Result<DavisSettings, Box<dyn Error>> {
    if (arguments.frames.is_some() || arguments.imu)
        && matches!(arguments.format, RecordingFile::Csv | RecordingFile::Bin)
    {
        return Err(UsageError("frames and inertial samples need --format aedat4 or dvraw".to_owned()).into());
    }
    let (frames, imu) = match arguments.light {
        Light::Default => (ExposureModel::default(), InertialSettings::default()),
        Light::Low => (ExposureModel::low_light(), InertialSettings::default()),
        Light::Ideal => (ExposureModel::ideal(), InertialSettings::ideal()),
    };
    let at_rate = |rate: f64| ExposureModel { interval: (1e6 / rate).round() as u32, ..frames };
    let settings = DavisSettings { frames: arguments.frames.map(at_rate), imu: arguments.imu.then_some(imu) };
    settings.check()?;
    Ok(settings)
}

/// The lens and the size of the sensor.
fn lens(arguments: &Arguments) -> Result<(Camera<f64>, Sensor), Box<dyn Error>> {
    if let Some(file) = &arguments.camera {
        return Ok(camera_file::read(file)?);
    }
    let Sensor { width, height } = arguments.sensor.unwrap_or(DAVIS346_SENSOR);
    let (kind, parameters) = match arguments.model {
        Some(kind) => (kind, arguments.parameters.clone()),
        None => {
            let (width, height) = (f64::from(width), f64::from(height));
            let focal = 0.96 * width;
            let center = [0.5 * (width - 1.0), 0.5 * (height - 1.0)];
            (ModelKind::Radtan, vec![focal, focal, center[0], center[1], -0.35, 0.15, 0.0, 0.0, 0.0])
        }
    };
    Ok((of_model(kind, &parameters)?, Sensor { width, height }))
}

/// The lens with these parameters.
fn of_model(kind: ModelKind, parameters: &[f64]) -> Result<Camera<f64>, UsageError> {
    Camera::from_parameters(kind, parameters).ok_or_else(|| {
        let names = kind.parameter_names();
        UsageError(format!(
            "model {kind} takes {} parameters {}, all finite, with positive focal lengths; {} were given",
            names.len(),
            names.join(","),
            parameters.len()
        ))
    })
}

/// Writes the recording, with a spinner unless `silent`.
fn simulate(
    simulation: &Simulation,
    davis: &DavisSettings,
    path: &Path,
    format: RecordingFormat,
    silent: bool,
) -> Result<(EventCounts, DavisTruth), Box<dyn Error>> {
    let spinner = progress::spinner(silent);
    let slices = simulation.slice_count().max(1);
    let results = recording::write(simulation, davis, path, format, |done| {
        spinner.set_message(format!("{} % simulated", 100 * done / slices));
    });
    spinner.finish_and_clear();
    Ok(results.map_err(|error| at(path, error))?)
}

/// An error that names its file.
fn at(path: &Path, error: impl fmt::Display) -> String {
    format!("{}: {error}", path.display())
}
