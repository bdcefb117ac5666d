//! `evcal live`.

mod ahead;
mod browser;
mod camera;
mod checkpoint;
mod incoming;
mod lines;
mod replay;
mod window;

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use evcal_calibrate::settings::Settings;
use evcal_detection::circles::file::open_events;
use evcal_files::folder::OutputFolder;
use evcal_files::visible;
use evcal_live::page::view::Context;
use event_recordings::RecordingOptions;

use super::calibrate::CalibrationArguments;
use super::camera_arguments::CameraArguments;
use super::interrupt::Interrupt;
use super::source_arguments::SourceArguments;
use super::value;
use super::{Failure, UsageError};

use self::incoming::Incoming;
use self::replay::Source;
use self::window::Window;

/// Name of standard input on the command line.
const STANDARD_INPUT: &str = "-";

/// Arguments of `evcal live`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A recording that arrives now, instead of a camera: - for standard input, which is stored in DIR
    #[arg(value_name = "-|RECORDING", conflicts_with_all = ["replay", "duration", "frames", "preset", "serial"])]
    incoming: Option<PathBuf>,
    /// Read RECORDING while another program is writing it
    #[arg(long, requires = "incoming")]
    follow: bool,
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
    fn settings(&self) -> Result<Settings, Failure> {
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
    let is_recording = arguments.replay.is_some() || arguments.incoming.is_some();
    if !is_recording && arguments.source.options() != RecordingOptions::default() {
        return Err(UsageError("these options describe a recording: add --replay RECORDING".to_owned()).into());
    }
    let incoming = arguments.incoming.as_deref();
    if let Some(file) = incoming.filter(|file| (*file == Path::new(STANDARD_INPUT)) == arguments.follow) {
        let shown = visible::path(file);
        return Err(UsageError(match arguments.follow {
            true => "standard input is always read as it arrives: leave out --follow".to_owned(),
            false => format!(
                "a recording is played with '--replay {shown}'; one that is still being written is read with '{shown} --follow'"
            ),
        })
        .into());
    }
    // Mistakes in the arguments are reported before the session begins.
    arguments.calibration.parameters()?;
    let settings = arguments.settings()?;
    let interrupt = Interrupt::catch()?;
    let folder = arguments.calibration.open_folder()?;
    let options = arguments.source.options();
    match (&arguments.replay, incoming) {
        (Some(recording), _) => {
            replay::run(arguments, Source::Whole(open_events(recording, options)?), &settings, &folder, &interrupt)
        }
        (None, Some(file)) => {
            let incoming = match arguments.follow {
                true => Incoming::follow(file, options, &interrupt)?,
                false => Incoming::standard_input(&folder, options, &interrupt)?,
            };
            replay::run(arguments, Source::Incoming(incoming), &settings, &folder, &interrupt)
        }
        (None, None) => camera::run(arguments, &settings, &folder, &interrupt),
    }
}

/// Opens the page, unless `--no-page` is given; `has_frames` is `true` if there may be frames to show.
fn open_window(arguments: &Arguments, folder: &OutputFolder, has_frames: bool) -> Result<Option<Window>, Failure> {
    if arguments.no_page {
        return Ok(None);
    }
    let context = Context { mirrored: arguments.mirror, has_frames, ..Context::default() };
    let mut window = Window::open(arguments.listen, arguments.port, context)?;
    window.announce(!arguments.no_open, folder.path());
    Ok(Some(window))
}
