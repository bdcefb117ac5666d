//! `evcal repeat`.

use std::fmt::Write as _;
use std::path::PathBuf;

use evcal_calibrate::calibrate::repeat::{RepeatSettings, Repetition, Run, repeat};
use evcal_calibrate::task::{PictureUse, Task};
use evcal_detection::circles::file::open_events;

use super::calibrate::MethodArguments;
use super::progress::Waiting;
use super::source_arguments::SourceArguments;
use super::{print, value};

/// Arguments of `evcal repeat`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A recording of events
    recording: PathBuf,
    #[command(flatten)]
    source: SourceArguments,
    #[command(flatten)]
    method: MethodArguments,
    /// Number of parts
    #[arg(long, value_name = "COUNT", default_value_t = 10, value_parser = value::count(2..=u16::MAX))]
    runs: u16,
    /// Length of each part in seconds
    #[arg(long, value_name = "TIME", default_value = "4s", value_parser = value::seconds)]
    seconds: f64,
    /// Seed of the random positions of the parts; the same seed gives the same result
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `evcal repeat`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let settings = arguments.method.settings()?;
    let options = arguments.source.options();
    let sensor = options.sensor;
    let recording = open_events(&arguments.recording, options)?;
    let files = std::slice::from_ref(&arguments.recording);
    let board =
        &arguments.method.choose_board(files, recording.options(), PictureUse::Ignore, &settings.detection)?.board;
    let model = arguments.method.model();
    let task = Task { model, sensor, pictures: PictureUse::Ignore, settings: &settings, ..Task::new(&[], board) };
    let parts = RepeatSettings { runs: arguments.runs.into(), seconds: arguments.seconds, seed: arguments.seed };
    let mut waiting = Waiting::new(arguments.json);
    let repetition = repeat(&recording, &task, &parts, |run| {
        let done = run as f64 / f64::from(arguments.runs).max(1.0);
        waiting.part(
            "calibrating parts of the recording",
            &format!("part {} of {}", run + 1, arguments.runs),
            Some(done),
        );
    })?;
    waiting.finish();
    if arguments.json {
        return print::pretty(&repetition);
    }
    print::line(table(&repetition))
}

fn table(repetition: &Repetition) -> String {
    let mut text = String::new();
    for run in &repetition.runs {
        let _ = write!(text, "{:8.3} s to {:8.3} s  ", run.start, run.end);
        let _ = match &run.outcome {
            Ok(camera) => writeln!(
                text,
                "fx {:9.3} ± {:.3}, projection {:.4} px from the mean camera (95 % bound: {:.4} px)",
                camera.parameters.first().unwrap_or(&f64::NAN),
                camera.sigma.first().unwrap_or(&f64::NAN),
                camera.difference,
                camera.stated
            ),
            Err(reason) => writeln!(text, "failed: {reason}"),
        };
    }
    let overlap = |(index, run): (usize, &Run)| {
        repetition.runs.iter().skip(index + 1).any(|other| other.start < run.end && run.start < other.end)
    };
    if repetition.runs.iter().enumerate().any(overlap) {
        text += "parts overlap: their results share events, so they scatter less than results of separate recordings\n";
    }
    let _ = writeln!(
        text,
        "\n{:<4} {:>12} {:>11} {:>11} {:>9}",
        repetition.model, "mean", "scatter", "reported σ", "σ/scatter"
    );
    for parameter in &repetition.parameters {
        let _ = writeln!(
            text,
            "{:<4} {:>12.5} {:>11.5} {:>11.5} {:>9.2}",
            parameter.name,
            parameter.mean,
            parameter.scatter,
            parameter.stated,
            parameter.stated / parameter.scatter
        );
    }
    text +=
        "σ/scatter is 1 if the reported uncertainty is right, below 1 if it is too small, above 1 if it is too large\n";
    let _ = write!(text, "projection: {:.4} px rms from the mean camera", repetition.projection);
    text
}
