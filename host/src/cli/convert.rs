//! `evcal convert`.

use std::path::PathBuf;

use evcal::recording::Recording;
use evcal::recording::convert::{TimeOrigin, convert, output_of};
use evcal::recording::encode::OutputFormat;

use super::print;
use super::progress::Waiting;
use super::source_arguments::SourceArguments;

/// Arguments of `evcal convert`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Recording of any format, told apart by its content
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// File to write; one that is there already is left alone
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Format to write, such as aedat4, npz, hdf5 or csv; any other word prints all [default: by the extension of OUT]
    #[arg(long, value_name = "FORMAT")]
    to: Option<OutputFormat>,
    /// Count times from 1970, by the time at which the recording of a camera began
    #[arg(long)]
    unix_time: bool,
    #[command(flatten)]
    source: SourceArguments,
    /// Print what was converted as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `evcal convert`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let (input, output) = (&arguments.input, &arguments.output);
    let target = arguments.to.map_or_else(|| output_of(output), Ok)?;
    let origin = if arguments.unix_time { TimeOrigin::Unix } else { TimeOrigin::Kept };
    let recording = Recording::new(input, arguments.source.options())?;
    let mut waiting = Waiting::new(arguments.json);
    let stage = format!("converting {}", input.display());
    waiting.stage(&stage, None);
    let report = convert(&recording, output, target, origin, |at| {
        waiting.part(&stage, &format!("{stage}: {} events", at.events), at.done);
    });
    waiting.finish();
    let report = report?;
    if arguments.json {
        print::json(&report)?;
    } else {
        print::line(format!("{}: {report}", output.display()))?;
    }
    match report.error {
        Some(error) => Err(format!("{error}\nwhat came before is in {}", output.display()).into()),
        None => Ok(()),
    }
}
