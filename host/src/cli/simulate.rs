//! `evcal simulate`.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::{fmt, fs};

use clap::ValueEnum;
use evcal::board::Board;
use evcal::camera_file::{self, SensorSize};
use evcal::simulate::motion::MotionSettings;
use evcal::simulate::rays::Rays;
use evcal::simulate::scene::SceneSettings;
use evcal::simulate::sensor::SensorModel;
use evcal::simulate::truth::Truth;
use evcal::simulate::{EventCounts, Simulation, SimulationSettings};
use evcal::source::write::{EventWriter, OutputFormat};
use evcal::tum;
use evcal_core::camera::{Camera, ModelKind};

use super::{UsageError, print, progress, value};

/// Rate of the poses in the trajectory file in hertz.
const TRAJECTORY_RATE: f64 = 1000.0;
/// Name of the camera in the recording.
const CAMERA_NAME: &str = "evcal simulator";
const SENSOR: (u16, u16) = (346, 260);

/// Arguments of `evcal simulate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Directory for events.aedat4 (or .csv, .bin), truth.json and trajectory.txt
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
    sensor: Option<(u16, u16)>,
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
    /// Format of the recording
    #[arg(long, value_enum, default_value_t = Format::Aedat4)]
    format: Format,
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
enum Format {
    Aedat4,
    Csv,
    Bin,
}

/// Runs `evcal simulate`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let (camera, SensorSize { width, height }) = lens(arguments)?;
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
            Motion::Interrupted => MotionSettings::interrupted(arguments.duration),
        },
    };
    let simulation = Simulation::new(Rays::new(&camera, width, height), arguments.board, settings)?;

    let directory = &arguments.output;
    fs::create_dir_all(directory).map_err(|error| at(directory, error))?;
    let events = directory.join(match arguments.format {
        Format::Aedat4 => "events.aedat4",
        Format::Csv => "events.csv",
        Format::Bin => "events.bin",
    });
    let counts = write_events(&simulation, &events, arguments.json)?;
    let truth = Truth::new(&camera, &simulation, counts);
    let truth_file = directory.join("truth.json");
    fs::write(&truth_file, serde_json::to_string_pretty(&truth)? + "\n").map_err(|error| at(&truth_file, error))?;
    let trajectory_file = directory.join("trajectory.txt");
    let mut trajectory = Vec::new();
    tum::write(&mut trajectory, &simulation.trajectory(TRAJECTORY_RATE))?;
    fs::write(&trajectory_file, trajectory).map_err(|error| at(&trajectory_file, error))?;

    if arguments.json {
        return print::json(&truth);
    }
    if arguments.verbose {
        print::line(serde_json::to_string_pretty(&truth)?)?;
    }
    let total = counts.off + counts.on;
    print::line(format!(
        "{total} events in {} s ({:.1} % ON), board at {:.0} px/s on average\n{}\n{}\n{}",
        arguments.duration,
        100.0 * counts.on as f64 / total.max(1) as f64,
        truth.mean_speed,
        events.display(),
        truth_file.display(),
        trajectory_file.display()
    ))
}

/// The lens and the size of the sensor.
fn lens(arguments: &Arguments) -> Result<(Camera<f64>, SensorSize), Box<dyn Error>> {
    if let Some(file) = &arguments.camera {
        return Ok(camera_file::read(file)?);
    }
    let (width, height) = arguments.sensor.unwrap_or(SENSOR);
    let (kind, parameters) = match arguments.model {
        Some(kind) => (kind, arguments.parameters.clone()),
        None => {
            let (width, height) = (f64::from(width), f64::from(height));
            let focal = 0.96 * width;
            let center = [0.5 * (width - 1.0), 0.5 * (height - 1.0)];
            (ModelKind::Radtan, vec![focal, focal, center[0], center[1], -0.35, 0.15, 0.0, 0.0, 0.0])
        }
    };
    let camera = Camera::from_parameters(kind, &parameters).ok_or_else(|| {
        let names = kind.parameter_names();
        UsageError(format!(
            "model {kind} takes {} parameters {}, all finite, with positive focal lengths; {} were given",
            names.len(),
            names.join(","),
            parameters.len()
        ))
    })?;
    Ok((camera, SensorSize { width, height }))
}

fn write_events(simulation: &Simulation, path: &Path, silent: bool) -> Result<EventCounts, Box<dyn Error>> {
    let failed = |error| at(path, error);
    let format = OutputFormat::from_extension(path)?;
    let rays = simulation.rays();
    let mut writer = EventWriter::create(path, format, (rays.width(), rays.height()), CAMERA_NAME).map_err(failed)?;
    let spinner = progress::spinner(silent);
    let slices = simulation.slice_count();
    let mut done = 0;
    let counts = simulation
        .run(|events| {
            done += 1;
            spinner.set_message(format!("{} % simulated", 100 * done / slices.max(1)));
            writer.write(events)
        })
        .map_err(failed)?;
    spinner.finish_and_clear();
    writer.finish().map_err(failed)?;
    Ok(counts)
}

/// An error that names its file.
fn at(path: &Path, error: impl fmt::Display) -> String {
    format!("{}: {error}", path.display())
}
