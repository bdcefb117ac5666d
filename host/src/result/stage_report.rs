//! What every stage took in and gave out, as text for people (`stages.txt`, `--verbose`).

use std::fmt::Write as _;

use crate::calibrate::Calibrated;
use crate::picture_calibration::joint::JointReport;
use crate::trust::witness::{PictureWitness, WitnessOutcome};

/// The report of all stages of a calibration, in their order.
pub fn stage_report(calibrated: &Calibrated) -> String {
    let reports = &calibrated.reports;
    let mut text = String::new();
    for recording in &reports.recordings {
        let _ = writeln!(text, "recording      {} events or circles in {:.3} s", recording.count, recording.duration);
        for note in &recording.notes {
            let _ = writeln!(text, "               {note}");
        }
    }
    if let Some(outcome) = &calibrated.witness {
        frame_report(&mut text, outcome, calibrated.joint.as_ref());
        if let WitnessOutcome::Only(_) = outcome {
            return text;
        }
    }
    let detection = &reports.detection;
    let _ = writeln!(
        text,
        "windows        {} tried, {} held the board ({} more had too few events)",
        detection.windows, detection.found, detection.too_few_events
    );
    if detection.found_by_neighbours > 0 {
        let _ =
            writeln!(text, "               {} of them placed by the frames around them", detection.found_by_neighbours);
    }
    for (reason, count) in &detection.grids_refused {
        let _ = writeln!(text, "               {count} refused: {reason}");
    }
    let _ = writeln!(text, "circles        {} found, {} on boards", detection.circles, detection.board_circles);
    for (reason, count) in &detection.pairs_refused {
        let _ = writeln!(text, "               {count} pairs refused: {reason}");
    }
    let initial = &reports.initial;
    let _ = writeln!(
        text,
        "initial model  {} frames in, {} kept",
        calibrated.frames.len(),
        calibrated.initial.frames.len()
    );
    if !initial.reasons().is_empty() {
        let _ = writeln!(text, "               {}", initial.reasons());
    }
    if let Some(choice) = &reports.model_choice {
        for (index, line) in choice.to_string().lines().enumerate() {
            let _ = writeln!(text, "{:<14} {line}", if index == 0 { "model" } else { "" });
        }
    }
    let segments = &reports.segments;
    let _ = writeln!(
        text,
        "segments       {} frames in, {} kept in {} segments of {:.3} s ({} too few frames, {} too short, {} without spline)",
        segments.frames_in,
        segments.frames_out,
        segments.segments,
        segments.duration,
        segments.too_few_frames,
        segments.too_short,
        reports.segments_without_spline
    );
    for (index, round) in reports.rounds.iter().enumerate() {
        let association = &round.association;
        let _ = writeln!(
            text,
            "round {:<2}       {} events: {} outside segments, {} thinned, {} off the board, {} far from an edge, {} on a sliding edge, {} of wrong polarity, {} kept",
            index + 1,
            association.events,
            association.outside_segments,
            association.thinned,
            association.off_board,
            association.far_from_edge,
            association.edge_slides,
            association.wrong_polarity,
            association.kept
        );
        let _ = writeln!(
            text,
            "               {} observations, {} iterations, cost {:.1} -> {:.1}, projection moved {:.4} px",
            round.solve.observations,
            round.solve.iterations,
            round.solve.initial_cost,
            round.solve.final_cost,
            round.change
        );
    }
    text
}

/// What became of the camera's own frames.
fn frame_report(text: &mut String, outcome: &WitnessOutcome, joint: Option<&JointReport>) {
    let report = outcome.report();
    let detection = &report.detection;
    let _ = writeln!(text, "frames         {} read, {} held the board", detection.frames, detection.with_board);
    for (reason, count) in &detection.refused {
        let _ = writeln!(text, "               {count} refused: {reason}");
    }
    let _ = writeln!(
        text,
        "dots           {} measured, {} on boards, edges blurred by {:.2} px",
        detection.dots, detection.board_dots, detection.blur
    );
    for (reason, count) in &detection.dots_refused {
        let _ = writeln!(text, "               {count} refused: {reason}");
    }
    if detection.without_exposure > 0 {
        let _ = writeln!(text, "               {} frames without times of exposure", detection.without_exposure);
    }
    for note in &detection.notes {
        let _ = writeln!(text, "               {note}");
    }
    match outcome {
        WitnessOutcome::Witness(witness) => witness_report(text, witness),
        WitnessOutcome::Silent(silent) => {
            let _ = writeln!(text, "               no calibration: {silent}");
        }
        WitnessOutcome::Only(frames) => {
            let _ = writeln!(
                text,
                "               {} frames with {} dots used ({}); a centre scatters by {:.3} px, variance {:.1} times that of \
                 independent centres",
                report.used, report.dots_used, report.dropped, frames.spread, frames.inflation
            );
        }
    }
    if let Some(joint) = joint {
        let _ = writeln!(
            text,
            "               {} dots of {} frames solved with the events ({} elsewhere), {:.3} ± {:.3} ms later, spread {:.3} px",
            joint.dots,
            joint.frames,
            joint.dots_elsewhere,
            1e3 * joint.time_offset,
            1e3 * joint.time_offset_sigma,
            joint.spread
        );
    }
}

fn witness_report(text: &mut String, witness: &PictureWitness) {
    let report = &witness.report;
    let _ = writeln!(
        text,
        "               {} frames with {} dots used ({}); a centre scatters by {:.3} px, variance {:.1} times that of \
         independent centres",
        report.used, report.dots_used, report.dropped, witness.spread, witness.inflation
    );
    for parameter in &witness.parameters {
        let _ = writeln!(
            text,
            "               {:<3} {:>12.5} ± {:.5} from frames, {:>12.5} from events",
            parameter.name, parameter.frames, parameter.frames_sigma, parameter.events
        );
    }
    let _ = writeln!(text, "               {}", witness.sentence);
}
