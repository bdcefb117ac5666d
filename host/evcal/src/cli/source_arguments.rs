//! Options for properties that a recording does not contain.

use evcal_core::sensor::Sensor;
use event_recordings::{Columns, Damage, RecordingOptions, TimeUnit};

use usb_davis::capture::DeviceAddress;

use super::value;

/// Options of every subcommand that reads a recording.
#[derive(clap::Args)]
pub struct SourceArguments {
    /// Size of the sensor in pixels, if the file does not contain it or it is wrong, for example 346x260
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = value::sensor)]
    pub sensor: Option<Sensor>,
    /// Columns of a table of events, such as x,y,p,t; - skips a column
    #[arg(long, value_name = "NAMES", allow_hyphen_values = true)]
    columns: Option<Columns>,
    /// Unit of the timestamps in a table of events: s, ms, us or ns
    #[arg(long, value_name = "UNIT")]
    time_unit: Option<TimeUnit>,
    /// Name or number of the event stream to read [default: the first]
    #[arg(long, value_name = "STREAM")]
    stream: Option<String>,
    /// The camera in a USB capture, as BUS.DEVICE; needed only if the capture contains several candidates
    #[arg(long, value_name = "BUS.DEVICE")]
    device: Option<DeviceAddress>,
    /// Skip damaged packets instead of stopping
    #[arg(long)]
    skip_damaged: bool,
}

impl SourceArguments {
    /// Returns the options for the reader.
    pub fn options(&self) -> RecordingOptions {
        RecordingOptions {
            stream: self.stream.clone(),
            sensor: self.sensor,
            columns: self.columns.clone(),
            time_unit: self.time_unit,
            device: self.device,
            damage: if self.skip_damaged { Damage::Skip } else { Damage::Refuse },
            growth: None,
        }
    }
}
