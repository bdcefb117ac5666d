//! `evcal check`.

use std::path::PathBuf;

use evcal::board::Board;
use evcal::check::check;
use evcal::recording::Recording;
use evcal::settings::Settings;

use super::print;
use super::progress::spinner;
use super::source_arguments::SourceArguments;

/// Arguments of `evcal check`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A recording of events
    recording: PathBuf,
    /// Board to look for, for example acircles:9x4:55mm:r17.5mm; without it, circles of any kind
    #[arg(long)]
    board: Option<Board>,
    #[command(flatten)]
    source: SourceArguments,
    /// Print what was seen as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `evcal check`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let recording = Recording::new(&arguments.recording, arguments.source.options())?;
    let bar = spinner(arguments.json);
    bar.set_message(format!("looking at {}", arguments.recording.display()));
    let checked = check(&recording, arguments.board.as_ref(), &Settings::default().detection)?;
    bar.finish_and_clear();
    if arguments.json { print::json(&checked) } else { print::line(checked) }
}
