//! `evcal live`.

mod ahead;
mod browser;
mod camera;
mod checkpoint;
mod lines;
mod replay;
mod window;

use std::error::Error;
use std::net::IpAddr;
use std::path::PathBuf;

use evcal_calibrate::settings::Settings;
use evcal_files::folder::OutputFolder;
use evcal_live::page::view::Context;
use event_recordings::RecordingOptions;

use super::UsageError;
use super::calibrate::CalibrationArguments;
use super::camera_arguments::CameraArguments;
use super::interrupt::Interrupt;
use super::source_arguments::SourceArguments;
use super::value;

use self::window::Window;

/// Arguments of `evcal live`.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    calibration: CalibrationArguments,
    #[command(flatten)]
    camera: CameraArguments,
    /// Play this recording instead of using a camera, until it is good enough; then calibrate from all of it
    #[arg(long, value_name = "RECORDING", conflicts_with_all = ["duration", "frames", "preset", "serial"])]
    replay: Option<PathBuf>,
    /// Playback speed; 1 is the original speed, max is as fast as possible
    #[arg(long, value_name = "NUMBER|max", default_value = "1", value_parser = speed, requires = "replay")]
    speed: Speed,
    #[command(flatten)]
    source: SourceArguments,
    /// Stop when the uncertainty of the projection is at most this: one standard deviation, rms over the sensor
    /// [default: 0.05px]
    #[arg(long, value_name = "ERROR", value_parser = value::pixels)]
    target: Option<f64>,
    /// No page; print hints as lines of text only
    #[arg(long)]
    no_page: bool,
    /// Port of the page [default: the first free port from 8346 on]
    #[arg(long, conflicts_with = "no_page")]
    port: Option<u16>,
    /// Serve the page to other computers at this address of this computer (0.0.0.0: all its addresses); anybody with the printed
    /// URL and its token can open it [default: this computer only]
    #[arg(long, value_name = "ADDRESS", conflicts_with = "no_page")]
    listen: Option<IpAddr>,
    /// Do not open a browser
    #[arg(long, conflicts_with = "no_page")]
    no_open: bool,
    /// Mirror the picture and the hints, for a person who holds the board and watches the screen
    #[arg(long)]
    mirror: bool,
}

impl Arguments {
    /// Returns the settings of the file, with the target of the command line.
    fn settings(&self) -> Result<Settings, Box<dyn std::error::Error>> {
        let mut settings = self.calibration.method.settings()?;
        settings.live.target = self.target.unwrap_or(settings.live.target);
        Ok(settings)
    }
}

/// Playback speed of a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Speed {
    /// Seconds of the recording per second.
    Times(f64),
    /// As fast as the detector can process it.
    Max,
}

impl Speed {
    fn times(self) -> Option<f64> {
        match self {
            Self::Times(times) => Some(times),
            Self::Max => None,
        }
    }
}

fn speed(text: &str) -> Result<Speed, &'static str> {
    match (text, text.parse::<f64>()) {
        ("max", _) => Ok(Speed::Max),
        (_, Ok(times)) if (0.01..=1000.0).contains(&times) => Ok(Speed::Times(times)),
        _ => Err("write a number from 0.01 to 1000, or max"),
    }
}

/// Runs `evcal live`: records, or plays a recording, and shows where to move the board; then calibrates as
/// `evcal calibrate` does.
pub fn run(arguments: &Arguments) -> super::Outcome {
    if arguments.replay.is_none() && arguments.source.options() != RecordingOptions::default() {
        return Err(UsageError("these options describe a recording: add --replay RECORDING".to_owned()).into());
    }
    // Mistakes in the arguments are reported before the session begins.
    arguments.calibration.parameters()?;
    let settings = arguments.settings()?;
    let interrupt = Interrupt::catch()?;
    let folder = arguments.calibration.open_folder()?;
    match &arguments.replay {
        Some(recording) => replay::run(arguments, recording, &settings, &folder, &interrupt),
        None => camera::run(arguments, &settings, &folder, &interrupt),
    }
}

/// Opens the page, unless `--no-page` is given; `has_frames` is `true` if there may be frames to show.
fn open_window(
    arguments: &Arguments,
    folder: &OutputFolder,
    has_frames: bool,
) -> Result<Option<Window>, Box<dyn Error>> {
    if arguments.no_page {
        return Ok(None);
    }
    let context = Context { mirrored: arguments.mirror, has_frames, ..Context::default() };
    let mut window = Window::open(arguments.listen, arguments.port, context)?;
    window.announce(!arguments.no_open, folder.path());
    Ok(Some(window))
}
