//! `evcal record`.

use std::ops::ControlFlow;
use std::path::PathBuf;

use evcal_files::visible;
use evcal_live::recorder::{Ending, Moment, RecorderReport, RecordingStatus, record};
use serde_json::json;

use super::camera_arguments::CameraArguments;
use super::interrupt::Interrupt;
use super::{Failure, print, progress};

/// Arguments of `evcal record`.
#[derive(clap::Args)]
pub struct Arguments {
    /// File to write (.dvraw); an existing file is never replaced
    #[arg(value_name = "OUT.dvraw", value_parser = dvraw)]
    output: PathBuf,
    #[command(flatten)]
    camera: CameraArguments,
    /// Print the statistics as JSON
    #[arg(long)]
    json: bool,
}

/// Parses the output file, which must end in `.dvraw`.
fn dvraw(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("dvraw")) {
        true => Ok(path),
        false => Err(format!(
            "cameras are recorded as .dvraw: write {}, then convert it with evcal convert",
            visible::path(path.with_extension("dvraw"))
        )),
    }
}

/// Runs `evcal record`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let interrupt = Interrupt::catch()?;
    let mut camera = arguments.camera.open()?;
    let bar = progress::spinner(arguments.json);
    let report = record(&mut camera, &arguments.output, &arguments.camera.plan(), |moment| {
        if let Moment::Status(status) = moment {
            bar.set_message(as_text(status));
        }
        if interrupt.is_asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    bar.finish_and_clear();
    if arguments.json {
        print::json(&as_json(&report))?;
    } else {
        print::line(summary(&report))?;
    }
    good_end(&report)
}

/// Returns an error if the recording did not end as planned.
pub(super) fn good_end(report: &RecorderReport) -> super::Outcome {
    if report.ending.is_good() {
        return Ok(());
    }
    let (file, status) = (visible::path(&report.path), &report.status);
    let advice = match report.ending {
        Ending::File(_) => "; make room on the disk, or record to another one",
        _ => "",
    };
    Err(Failure::plain(format!(
        "{}; the part before is in {file}: {} events in {:.1} s, {} bytes{advice}",
        report.ending, status.events, status.seconds, report.file_bytes
    )))
}

/// Returns the status in one line.
pub(super) fn as_text(status: &RecordingStatus) -> String {
    let (rate, megabytes) = (status.event_rate / 1e6, status.bytes as f64 / 1e6);
    let silent =
        if status.events == 0 { "; no event yet: remove the lens cap, and move something in the scene" } else { "" };
    format!("{rate:.3} Mev/s, {megabytes:.1} MB, {} events dropped by the camera{silent}", status.dropped)
}

/// Returns a summary of a recording in a few lines.
pub(super) fn summary(report: &RecorderReport) -> String {
    let status = &report.status;
    let mut text = format!(
        "{}: {} events in {:.1} s, {:.1} MB in {} transfers ({})",
        visible::path(&report.path),
        status.events,
        status.seconds,
        status.bytes as f64 / 1e6,
        report.transfers,
        report.ending
    );
    if status.dropped > 0 || report.starved > 0 {
        text += &format!(
            "\nthe camera dropped {} events; {} transfers were late because this computer was busy: close other programs, or record to a faster disk",
            status.dropped, report.starved
        );
    }
    if report.failed > 0 {
        text += &format!("\n{} transfers failed and their data are lost: check cable and hub", report.failed);
    }
    if report.faults > 0 {
        text += &format!("\n{} errors in the data stream (details: evcal info): check cable and hub", report.faults);
    }
    text
}

fn as_json(report: &RecorderReport) -> serde_json::Value {
    let status = &report.status;
    json!({
        "file": report.path, "seconds": status.seconds, "events": status.events, "bytes": status.bytes,
        "transfers": report.transfers, "file_bytes": report.file_bytes, "dropped": status.dropped,
        "starved": report.starved, "failed": report.failed, "faults": report.faults, "ending": report.ending.to_string(),
    })
}
