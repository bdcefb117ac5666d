//! `evcal info`.

use std::path::PathBuf;

use evcal_calibrate::advice::Advice;
use evcal_calibrate::check::units::unusual_unit;
use evcal_detection::circles::file::open_events;
use evcal_detection::diagnosis::information;
use evcal_files::remedy::{Remedy as _, Words};

use super::source_arguments::SourceArguments;
use super::{Failure, print};

/// Arguments of `evcal info`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Recordings; the format is detected from the content
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    source: SourceArguments,
    /// Print one JSON object per file, one per line
    #[arg(long)]
    json: bool,
}

/// Runs `evcal info`. After a file that cannot be read, it continues with the others.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let mut failures = Vec::new();
    for (index, path) in arguments.files.iter().enumerate() {
        let gathered = open_events(path, arguments.source.options())
            .and_then(|recording| Ok((information::gather(&recording)?, recording)));
        let (information, recording) = match gathered {
            Ok(gathered) => gathered,
            Err(error) => {
                failures.push(error.advised(&Words::PROGRAM));
                continue;
            }
        };
        if arguments.json {
            print::json(&information)?;
        } else {
            let separator = if index == 0 { "" } else { "\n" };
            print::line(format!("{separator}{}", information.to_string().trim_end()))?;
            let is_inside = information.report.out_of_range <= information.events;
            if let Some(other) = unusual_unit(&recording, information.mean_rate).filter(|_| is_inside) {
                print::line(format!(
                    "{:<12}{other}: {}",
                    "time unit",
                    Advice::NameTimeUnit(other.unit).worded(&Words::PROGRAM)
                ))?;
            }
        }
        if let Some(error) = &information.error {
            failures.push(error.advised(&Words::PROGRAM));
        }
    }
    if failures.is_empty() { Ok(()) } else { Err(Failure::plain(failures.join("\nevcal: "))) }
}
