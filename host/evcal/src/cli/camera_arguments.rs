//! The choice and configuration of a live camera.

use std::time::Duration;

use clap::ValueEnum;
use evcal_live::recorder::RecordingPlan;
use usb_davis::configuration::{Configuration, Streams};
use usb_davis::device::{Camera, DeviceError, Queue, Selector};
use usb_davis::dump::Growth;

use super::{Failure, value};

/// Options of every subcommand that uses a live camera.
#[derive(clap::Args)]
pub struct CameraArguments {
    /// Longest duration of the recording, for example 10s; Ctrl-C stops earlier
    #[arg(long, value_name = "TIME", value_parser = value::seconds)]
    duration: Option<f64>,
    /// Also record frames (9 MB/s more)
    #[arg(long)]
    frames: bool,
    /// Configuration of the camera
    #[arg(long, value_enum, default_value_t = Preset::Calibration)]
    preset: Preset,
    /// Serial number of the camera [default: the first available one]
    #[arg(long, value_name = "NUMBER")]
    serial: Option<String>,
}

/// Configuration of the camera.
#[derive(Clone, Copy, ValueEnum)]
enum Preset {
    /// Without the background-activity filter, which would remove the first event of each edge
    Calibration,
    /// The configuration of iniVation's software
    Default,
}

impl CameraArguments {
    /// Opens and configures the camera.
    pub fn open(&self) -> Result<Camera, Failure> {
        let selector = Selector { serial: self.serial.clone(), ..Selector::default() };
        let mut camera = Camera::open(&selector).map_err(|error| match error {
            DeviceError::NotFound { .. } => Failure::plain(format!("{error}; run evcal devices for advice")),
            error => Failure::plain(error),
        })?;
        camera
            .configure(&match self.preset {
                Preset::Calibration => Configuration::calibration(),
                Preset::Default => Configuration::default(),
            })
            .map_err(Failure::plain)?;
        Ok(camera)
    }

    /// Returns whether frames are recorded, too.
    pub fn has_frames(&self) -> bool {
        self.frames
    }

    /// Returns the streams to record, and the duration.
    pub fn plan(&self) -> RecordingPlan {
        RecordingPlan {
            streams: if self.frames { Streams::ALL } else { Streams::EVENTS },
            queue: Queue::default(),
            duration: self.duration.map(|seconds| Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)),
            growth: Growth::default(),
        }
    }
}
