//! Options for properties that a recording does not contain.

use std::path::Path;

use evcal_core::sensor::Sensor;
use evcal_files::shell_word::shell_word;
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

/// Returns the command that runs a subcommand on a recording that is read with these options, as a shell reads it; `rest` are the words
/// after the recording.
pub fn command(subcommand: &str, recording: &Path, options: &RecordingOptions, rest: &[&str]) -> String {
    let RecordingOptions { stream, sensor, columns, time_unit, device, damage, growth: _ } = options;
    let path = recording.to_string_lossy();
    // A name that begins with a hyphen looks like an option.
    let path = if path.starts_with('-') { format!("./{path}") } else { path.into_owned() };
    let sensor = sensor.map(|Sensor { width, height }| format!("{width}x{height}"));
    let named = [
        ("--sensor", sensor),
        ("--columns", columns.as_ref().map(ToString::to_string)),
        ("--time-unit", time_unit.map(|unit| unit.symbol().to_owned())),
        ("--stream", stream.clone()),
        ("--device", device.map(|device| device.to_string())),
    ];
    let mut words = vec!["evcal".to_owned(), subcommand.to_owned(), path];
    words.extend(rest.iter().map(|word| (*word).to_owned()));
    for (name, value) in named {
        match value {
            Some(value) if value.starts_with('-') => words.push(format!("{name}={value}")),
            Some(value) => words.extend([name.to_owned(), value]),
            None => {}
        }
    }
    if *damage == Damage::Skip {
        words.push("--skip-damaged".to_owned());
    }
    words.iter().map(|word| shell_word(word)).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        recording: std::path::PathBuf,
        #[command(flatten)]
        source: SourceArguments,
    }

    /// Every option of the input is printed, and read again as the same.
    #[test]
    fn a_printed_command_has_all_options_of_the_input() {
        let all = RecordingOptions {
            stream: Some("-my events".to_owned()),
            sensor: Some(Sensor::new(346, 260)),
            columns: Some("-,x,y,t,p".parse().unwrap()),
            time_unit: Some(TimeUnit::Nanoseconds),
            device: Some("3.7".parse().unwrap()),
            damage: Damage::Skip,
            growth: None,
        };
        for options in [all, RecordingOptions::default()] {
            let line = command("info", Path::new("-a b.csv"), &options, &[]);
            let output = std::process::Command::new("sh").args(["-c", &format!("printf '%s\\n' {line}")]).output();
            let words = String::from_utf8(output.unwrap().stdout).unwrap();
            let mut words: Vec<&str> = words.lines().collect();
            assert_eq!(words.remove(0), "evcal");
            let read = Line::try_parse_from(words).unwrap();
            assert_eq!((read.recording.to_str(), read.source.options()), (Some("./-a b.csv"), options), "{line}");
        }
    }
}
