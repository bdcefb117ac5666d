//! What a user can say about a recording that does not say it itself.

use evcal_core::sensor::Sensor;
use event_recordings::{Columns, Damage, RecordingOptions, TimeUnit};

use usb_davis::capture::DeviceAddress;

use super::value;

/// Options of every subcommand that reads a recording.
#[derive(clap::Args)]
pub struct SourceArguments {
    /// Size of the sensor in pixels, instead of what the file says, for example 346x260
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = value::sensor)]
    pub sensor: Option<Sensor>,
    /// Columns of a table of events, such as x,y,p,t; - leaves one out
    #[arg(long, value_name = "NAMES", allow_hyphen_values = true)]
    columns: Option<Columns>,
    /// Unit of the times in a table of events: s, ms, us or ns
    #[arg(long, value_name = "UNIT")]
    time_unit: Option<TimeUnit>,
    /// Name or number of the event stream to read [default: the first]
    #[arg(long, value_name = "STREAM")]
    stream: Option<String>,
    /// The camera in a USB capture, as BUS.DEVICE; needed only if several devices could be it
    #[arg(long, value_name = "BUS.DEVICE")]
    device: Option<DeviceAddress>,
    /// Leave out damaged packets instead of stopping there
    #[arg(long)]
    skip_damaged: bool,
}

impl SourceArguments {
    /// The options for the reader.
    pub fn options(&self) -> RecordingOptions {
        RecordingOptions {
            stream: self.stream.clone(),
            sensor: self.sensor,
            columns: self.columns.clone(),
            time_unit: self.time_unit,
            device: self.device,
            damage: if self.skip_damaged { Damage::Skip } else { Damage::Refuse },
        }
    }
}
