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
    /// Play this recording instead of a camera, until enough was seen; calibrate from all of it
    #[arg(long, value_name = "RECORDING", conflicts_with_all = ["duration", "frames", "preset", "serial"])]
    replay: Option<PathBuf>,
    /// How fast to play, 1 being as recorded, or max
    #[arg(long, value_name = "NUMBER|max", default_value = "1", value_parser = speed, requires = "replay")]
    speed: Speed,
    #[command(flatten)]
    source: SourceArguments,
    /// Stop once a calibration states an error of the projection of at most this: one standard deviation, root mean square over
    /// the sensor [default: 0.05px]
    #[arg(long, value_name = "ERROR", value_parser = value::pixels)]
    target: Option<f64>,
    /// Hints as lines of text only, no page
    #[arg(long)]
    no_page: bool,
    /// Port of the page [default: the first free one from 8346 on]
    #[arg(long, conflicts_with = "no_page")]
    port: Option<u16>,
    /// Serve the page to other computers too, at this address of this one, 0.0.0.0 for all; whoever has the address with its token
    /// sees it [default: this computer alone]
    #[arg(long, value_name = "ADDRESS", conflicts_with = "no_page")]
    listen: Option<IpAddr>,
    /// Do not open a browser
    #[arg(long, conflicts_with = "no_page")]
    no_open: bool,
    /// Mirror the picture and the hints, for someone who holds the board and watches the screen
    #[arg(long)]
    mirror: bool,
}

impl Arguments {
    /// All thresholds.
    fn settings(&self) -> Result<Settings, Box<dyn std::error::Error>> {
        let mut settings = self.calibration.method.settings()?;
        settings.live.target = self.target.unwrap_or(settings.live.target);
        Ok(settings)
    }
}

/// How fast a recording is played.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Speed {
    /// So many seconds of the recording a second.
    Times(f64),
    /// As fast as the detector.
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

/// Runs `evcal live`: records, or plays a recording, while it says where the board should go; then calibrates as
/// `evcal calibrate` does.
pub fn run(arguments: &Arguments) -> super::Outcome {
    if arguments.replay.is_none() && arguments.source.options() != RecordingOptions::default() {
        return Err(UsageError("these options describe a recording: add --replay RECORDING".to_owned()).into());
    }
    // Before the session, not after it.
    arguments.calibration.parameters()?;
    let settings = arguments.settings()?;
    let interrupt = Interrupt::catch()?;
    let folder = arguments.calibration.open_folder()?;
    match &arguments.replay {
        Some(recording) => replay::run(arguments, recording, &settings, &folder, &interrupt),
        None => camera::run(arguments, &settings, &folder, &interrupt),
    }
}

/// Opens the page, unless it is not wanted; `has_frames` says whether there may be frames to show.
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
