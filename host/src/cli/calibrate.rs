//! `evcal calibrate`.

use evcal_core::sensor::Sensor;
use std::path::PathBuf;

use evcal::board::Board;
use evcal::calibrate::input::Input;
use evcal::calibrate::{PictureUse, Task, calibrate};
use evcal::initial::model_choice::ModelRequest;
use evcal::output::folder::write_folder;
use evcal::recording::RecordingOptions;
use evcal::settings::{Extraction, Grid, Settings, SettingsError};
use evcal::trajectory::RotationSpline;

use super::progress::spinner;
use super::{detector, print};

/// Arguments of `evcal calibrate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Recordings of one camera: .dvraw, AEDAT4, CSV or text, EventCalib binary, pcap, circle tracks, circle
    /// streams, or the serial port of a detector, serial:PORT?baud=921600&seconds=10
    #[arg(required = true)]
    recordings: Vec<PathBuf>,
    /// Sensor size, where a recording does not tell it, for example 346x260
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = super::sensor)]
    sensor: Option<Sensor>,
    #[command(flatten)]
    calibration: CalibrationArguments,
}

/// Where results go, and what is printed.
#[derive(clap::Args)]
pub struct CalibrationArguments {
    #[command(flatten)]
    pub method: MethodArguments,
    /// Calibrate from the camera's own frames alone, as ordinary image calibration does
    #[arg(long, conflicts_with = "joint_frames")]
    frames_only: bool,
    /// Solve the camera's own frames and its events together
    #[arg(long)]
    joint_frames: bool,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Print the calibration as JSON
    #[arg(long)]
    pub json: bool,
    /// Print the stage report
    #[arg(short, long)]
    verbose: bool,
}

/// What is calibrated, and how; whatever the events come from.
#[derive(clap::Args)]
pub struct MethodArguments {
    /// Board, for example acircles:9x4:55mm:r17.5mm (layout, rows x columns, spacing, radius)
    #[arg(long)]
    pub board: Board,
    /// Camera model, or auto: the simplest one that predicts held-out circles as well as any
    #[arg(long, default_value = "radtan", value_parser = super::value::model_request())]
    pub model: ModelRequest,
    /// Circle extraction: hard or soft [default: hard]
    #[arg(long, value_parser = extraction)]
    extraction: Option<Extraction>,
    /// Spline of the rotation: quaternion or so3 [default: quaternion]
    #[arg(long)]
    rotation: Option<RotationSpline>,
    /// Grid finder: lattice or opencv [default: lattice]
    #[arg(long, value_parser = grid)]
    grid: Option<Grid>,
    /// Settings file (TOML); names and defaults are in docs/settings.md
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
}

impl MethodArguments {
    /// All thresholds.
    pub fn settings(&self) -> Result<Settings, SettingsError> {
        let mut settings = self.settings.as_deref().map(Settings::read).transpose()?.unwrap_or_default();
        settings.detection.extraction = self.extraction.unwrap_or(settings.detection.extraction);
        settings.detection.grid = self.grid.unwrap_or(settings.detection.grid);
        settings.spline.rotation = self.rotation.unwrap_or(settings.spline.rotation);
        Ok(settings)
    }
}

pub(super) fn extraction(text: &str) -> Result<Extraction, &'static str> {
    match text {
        "hard" => Ok(Extraction::Hard),
        "soft" => Ok(Extraction::Soft),
        _ => Err("write hard or soft"),
    }
}

fn grid(text: &str) -> Result<Grid, &'static str> {
    match text {
        "lattice" => Ok(Grid::Lattice),
        "opencv" => Ok(Grid::Opencv),
        _ => Err("write lattice or opencv"),
    }
}

/// Runs `evcal calibrate`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    calibrate_recordings(&arguments.recordings, arguments.sensor, &arguments.calibration)
}

/// Calibrates from `recordings` and writes the results.
pub fn calibrate_recordings(
    recordings: &[PathBuf],
    sensor: Option<Sensor>,
    arguments: &CalibrationArguments,
) -> super::Outcome {
    let method = &arguments.method;
    let settings = method.settings()?;
    let options = RecordingOptions { sensor, ..RecordingOptions::default() };
    let inputs = recordings
        .iter()
        .map(|path| detector::open_input(path, &options, &method.board, &arguments.output, arguments.json))
        .collect::<Result<Vec<Input>, _>>()?;
    let pictures = match (arguments.frames_only, arguments.joint_frames) {
        (true, _) => PictureUse::Only,
        (false, true) => PictureUse::Joint,
        (false, false) => PictureUse::Witness,
    };
    let task = Task {
        inputs: &inputs,
        board: &method.board,
        model: method.model,
        sensor,
        pictures,
        settings: &settings,
        command_line: &super::command_line(),
    };
    let bar = spinner(arguments.json);
    let calibrated = calibrate(&task, |message| bar.set_message(message.to_owned()))?;
    bar.set_message("writing results");
    let written = write_folder(&arguments.output, &calibrated, &task)?;
    bar.finish_and_clear();
    if arguments.json {
        return print::line(written.json);
    }
    print::line(written.summary)?;
    if arguments.verbose {
        print::line(format!("\n{}", written.stage_report))?;
    }
    print::line(format!("\nwritten to {}", arguments.output.display()))
}
