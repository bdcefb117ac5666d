//! `evcal convert`.

use std::path::PathBuf;

use evcal_detection::circles::file::open_events;
use evcal_files::is_stream;
use evcal_files::remedies;
use evcal_files::visible;
use event_recordings::convert::{ConvertError, TimeOrigin, convert, output_of};
use event_recordings::encode::OutputFormat;

use super::output_arguments::OutputArguments;
use super::progress::{Waiting, short_name};
use super::source_arguments::SourceArguments;
use super::{print, value};

/// Arguments of `evcal convert`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Recording; the format is detected from the content
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// File to write
    #[arg(value_name = "OUT", value_parser = value::output_file())]
    output: PathBuf,
    #[command(flatten)]
    results: OutputArguments,
    /// Format to write, such as aedat4, npz, hdf5 or csv; an unknown name prints the list [default: by the extension of OUT]
    #[arg(long, value_name = "FORMAT")]
    to: Option<OutputFormat>,
    /// Write Unix times (since 1970), if the recording contains its start time
    #[arg(long)]
    unix_time: bool,
    #[command(flatten)]
    source: SourceArguments,
    /// Print the statistics as JSON
    #[arg(long)]
    json: bool,
}

/// An error stopped the conversion before the end of the recording.
#[derive(Debug, thiserror::Error)]
#[error("{error}\nthe part before the error is in {}", visible::path(output))]
pub(super) struct BrokenOff {
    #[source]
    pub error: ConvertError,
    pub output: PathBuf,
}

remedies! { BrokenOff, say;
    Self { error, .. } => error.remedy(say);
}

/// Runs `evcal convert`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let (input, output) = (&arguments.input, &arguments.output);
    let target = arguments.to.map_or_else(|| output_of(output), Ok)?;
    let origin = if arguments.unix_time { TimeOrigin::Unix } else { TimeOrigin::Kept };
    arguments.results.check([output.as_path()], &[input])?;
    let recording = open_events(input, arguments.source.options())?;
    let mut waiting = Waiting::new(arguments.json);
    let stage = format!("converting {}", short_name(input));
    waiting.stage(&stage, None);
    let report = convert(&recording, output, target, origin, |at| {
        waiting.part(&stage, &format!("{stage}: {} events", at.events), at.done);
    });
    waiting.finish();
    let report = report?;
    match (arguments.json, is_stream(output)) {
        (true, _) => print::json(&report)?,
        (false, false) => print::line(format!("{}: {report}", visible::path(output)))?,
        // Standard output may be the converted recording.
        (false, true) => print::aside(format!("{}: {report}", visible::path(output))),
    }
    match report.error {
        Some(error) => Err(BrokenOff { error, output: output.clone() }.into()),
        None => Ok(()),
    }
}
