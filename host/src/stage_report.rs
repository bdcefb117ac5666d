//! What every stage took in and gave out, as text for people (`stages.txt`, `--verbose`).

use std::fmt::Write as _;

use crate::calibrate::Calibrated;

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
