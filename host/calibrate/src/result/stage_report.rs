//! Reports of all stages as text (`stages.txt`).

use std::fmt::Write as _;

use super::stage_lines::{Amount, StageLine, stage_lines};
use crate::calibrate::calibrated::{Calibrated, EventCalibration, Evidence};
use crate::picture_calibration::calibration::PictureSource;
use crate::quality::cross_check::{Comparison, CrossCheckOutcome};
use evcal_solve::solve::residual_statistics::Measured;
use event_recordings::pass::RecordingReport;

/// Width of the column of stage names.
const NAME: usize = 30;

/// Returns the text of all stages of a calibration, in their order.
pub fn stage_report(calibrated: &Calibrated) -> String {
    let counted = match &calibrated.evidence {
        Evidence::Pictures(pictures) if pictures.report.source == PictureSource::Frames => "frames with the board",
        Evidence::Events(events) if events.measured == Measured::CircleCentres => "circles",
        Evidence::Events(_) | Evidence::Pictures(_) => "events",
    };
    let mut text = String::new();
    for recording in &calibrated.recordings {
        put_recording(&mut text, recording, counted);
    }
    for line in stage_lines(calibrated) {
        put(&mut text, &line);
    }
    if let Some(choice) = &calibrated.model_choice {
        for (index, line) in choice.to_string().lines().enumerate() {
            put_row(&mut text, if index == 0 { "Camera model" } else { "" }, line);
        }
    }
    if let Some(EventCalibration { cross_check: Some(CrossCheckOutcome::Compared(cross_check)), .. }) =
        calibrated.events()
    {
        put_comparison(&mut text, &cross_check.comparison);
    }
    text
}

fn put_row(text: &mut String, name: &str, row: &str) {
    let _ = writeln!(text, "{name:<NAME$} {row}");
}

fn put_recording(text: &mut String, recording: &RecordingReport, counted: &str) {
    put_row(text, "Recording", &format!("{} {counted} in {:.3} s", recording.count, recording.duration));
    for note in &recording.notes {
        put_row(text, "", note);
    }
}

fn put(text: &mut String, line: &StageLine) {
    let in_words = |amount: &Amount| format!("{} {}", amount.count, amount.what);
    put_row(text, &line.stage, &format!("{} -> {}", in_words(&line.taken), in_words(&line.given)));
    for amount in &line.dropped {
        put_row(text, "", &format!("{} dropped: {}", amount.count, amount.what));
    }
    for note in &line.notes {
        put_row(text, "", note);
    }
}

/// Prints the parameters from pictures and from events.
fn put_comparison(text: &mut String, comparison: &Comparison) {
    put_row(text, "Frames against events", &comparison.sentence);
    for parameter in &comparison.parameters {
        let row = format!(
            "{:<3} {:>12.5} ± {:.5} from frames, {:>12.5} from events",
            parameter.name, parameter.frames, parameter.frames_sigma, parameter.events
        );
        put_row(text, "", &row);
    }
}
