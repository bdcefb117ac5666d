//! Reports of all stages, with the amounts that each got, kept and dropped, for `stages.txt` and the report.

use crate::calibrate::calibrated::{Calibrated, EventCalibration, Evidence};
use crate::calibrate::interval_choice::IntervalChoice;
use crate::picture_calibration::calibration::{PictureCalibration, PictureReport, PictureSource};
use crate::picture_calibration::joint::JointReport;
use crate::quality::cross_check::{Comparison, CrossCheckOutcome};
use evcal_detection::detection::DetectionReport;
use evcal_detection::detection::counted::counted;
use evcal_solve::initial::InitialReport;
use evcal_solve::solve::refinement::RoundReport;
use evcal_solve::solve::residual_statistics::Measured;

/// Report of one stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageLine {
    /// Its name.
    pub stage: String,
    /// Input.
    pub taken: Amount,
    /// Output.
    pub given: Amount,
    /// Dropped input, by reason.
    pub dropped: Vec<Amount>,
    /// Further statements.
    pub notes: Vec<String>,
}

/// A number of things.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Amount {
    /// The number.
    pub count: u64,
    /// The kind of thing, or the reason.
    pub what: String,
}

impl Amount {
    fn new(count: u64, what: impl Into<String>) -> Self {
        Self { count, what: what.into() }
    }
}

impl StageLine {
    fn new(stage: impl Into<String>, taken: Amount, given: Amount) -> Self {
        Self { stage: stage.into(), taken, given, dropped: Vec::new(), notes: Vec::new() }
    }

    /// Adds the dropped amounts, without zero counts.
    fn dropping(mut self, dropped: impl IntoIterator<Item = (u64, String)>) -> Self {
        let some = dropped.into_iter().filter(|(count, _)| *count > 0);
        self.dropped.extend(some.map(|(count, what)| Amount { count, what }));
        self
    }

    fn noting(mut self, notes: impl IntoIterator<Item = String>) -> Self {
        self.notes.extend(notes);
        self
    }
}

/// Returns the reports of all stages of a calibration, in their order.
pub fn stage_lines(calibrated: &Calibrated) -> Vec<StageLine> {
    match &calibrated.evidence {
        Evidence::Events(events) => event_lines(events),
        Evidence::Pictures(pictures) => picture_lines(pictures),
    }
}

fn event_lines(events: &EventCalibration) -> Vec<StageLine> {
    let mut lines = Vec::new();
    let detection = &events.detection;
    if detection.windows + detection.too_few_events > 0 {
        lines.extend(detection_lines(detection));
    }
    lines.extend(events.choice.as_ref().map(|choice| choice_line(events, choice)));
    lines.push(initial_line(&events.initial.report));
    let segments = &events.segments;
    let parts = counted(segments.segments as u64, "segment", "segments");
    let kept = format!("reference frames in {parts}, {:.3} s together", segments.duration);
    let taken = Amount::new(segments.frames_in as u64, "reference frames");
    lines.push(StageLine::new("Trajectory segments", taken, Amount::new(segments.frames_out as u64, kept)).dropping([
        (segments.too_few_frames as u64, "groups of too few frames".to_owned()),
        (segments.too_short as u64, "groups too short".to_owned()),
        (events.segments_without_spline as u64, "segments without spline".to_owned()),
    ]));
    let observed = events.measured == Measured::EventEdges;
    for (index, round) in events.refined.rounds.iter().enumerate() {
        lines.extend(observed.then(|| association_line(index + 1, round)));
        lines.push(solve_line(index + 1, round));
    }
    if let Some(outcome) = &events.cross_check {
        lines.extend(search_lines(outcome.report()));
        lines.push(cross_check_line(outcome));
    }
    lines.extend(events.joint.as_ref().map(joint_line));
    lines
}

fn choice_line(events: &EventCalibration, choice: &IntervalChoice) -> StageLine {
    let taken = Amount::new(choice.seconds as u64, "seconds with the board");
    let poses = events.followed.iter().map(|interval| interval.poses.len()).sum::<usize>();
    StageLine::new("Seconds in the joint solve", taken, Amount::new(choice.chosen.len() as u64, "seconds")).noting([
        format!("{} frames of the others; {poses} poses along them with the camera fixed", events.other_windows.len()),
    ])
}

fn picture_lines(pictures: &PictureCalibration) -> Vec<StageLine> {
    let mut lines = Vec::from(search_lines(&pictures.report));
    lines.push(initial_line(&pictures.initial.report));
    lines.push(used_line(&pictures.report, pictures.spread, pictures.inflation));
    lines
}

fn detection_lines(detection: &DetectionReport) -> Vec<StageLine> {
    let windows = detection.windows + detection.too_few_events;
    let refused = detection.grids_refused.iter().map(|(reason, count)| (*count, reason.to_string()));
    let too_few = (detection.too_few_events, "too few events".to_owned());
    let by_neighbours = detection.found_by_neighbours;
    let note = (by_neighbours > 0).then(|| {
        format!("in {by_neighbours} of those with the board, neighbouring windows determined which part of it was seen")
    });
    let pairs = detection.pairs_refused.iter().map(|(reason, count)| (*count, format!("{reason} (pairs of clusters)")));
    let (windows, found) = (Amount::new(windows, "windows"), Amount::new(detection.found, "with the board"));
    let mut lines =
        vec![StageLine::new("Board in time windows", windows, found).dropping(refused.chain([too_few])).noting(note)];
    // Squares are found in pictures, without circles.
    if detection.circles > 0 {
        let (circles, on_boards) =
            (Amount::new(detection.circles, "circles"), Amount::new(detection.board_circles, "on boards"));
        lines.push(StageLine::new("Circles", circles, on_boards).dropping(pairs));
    }
    lines
}

fn initial_line(initial: &InitialReport) -> StageLine {
    let dropped = initial.dropped_by_reason().into_iter();
    StageLine::new(
        "First lens and poses",
        Amount::new(initial.frames_in as u64, "reference frames"),
        Amount::new(initial.frames_out as u64, "reference frames"),
    )
    .dropping(dropped.map(|(reason, count)| (count as u64, reason.to_string())))
}

fn association_line(round: usize, report: &RoundReport) -> StageLine {
    let association = &report.association;
    let dropped = [
        (association.thinned, "left out by thinning"),
        (association.outside_segments, "outside segments"),
        (association.off_board, "not on the board"),
        (association.far_from_edge, "far from an edge"),
        (association.edge_slides, "on a slow or sliding edge"),
        (association.wrong_polarity, "of the wrong polarity"),
    ];
    StageLine::new(
        format!("Events to edges, round {round}"),
        Amount::new(association.events, "events"),
        Amount::new(association.kept, "events"),
    )
    .dropping(dropped.map(|(count, what)| (count, what.to_owned())))
}

fn solve_line(round: usize, report: &RoundReport) -> StageLine {
    let solve = &report.solve;
    StageLine::new(
        format!("Joint solve, round {round}"),
        Amount::new(solve.observations as u64, "observations"),
        Amount::new(solve.iterations as u64, if solve.iterations == 1 { "iteration" } else { "iterations" }),
    )
    .noting([format!("cost {:.1} to {:.1}", solve.initial_cost, solve.final_cost)])
    .noting(report.change.map(|change| format!("projection changed by {change:.4} px")))
    .noting(report.knots.as_ref().map(|knots| {
        let times = |(level, seconds): (usize, &f64)| {
            format!("{:.1} ms for {seconds:.2} s", 1e3 * knots.finest * (1 << level) as f64)
        };
        let spans: Vec<String> =
            knots.seconds.iter().enumerate().filter(|(_, seconds)| **seconds > 0.0).map(times).collect();
        format!("{} control points; knot spacing: {}", knots.control_points, spans.join(", "))
    }))
}

/// Returns the reports on the search for boards in the camera's own pictures.
fn search_lines(report: &PictureReport) -> [StageLine; 2] {
    let search = &report.detection;
    let refused = search.refused.iter().map(|(reason, count)| (*count, reason.to_string()));
    let without =
        (search.without_exposure > 0).then(|| format!("{} frames without times of exposure", search.without_exposure));
    let passed_over = (search.passed_over > 0).then(|| format!("{} more were not needed", search.passed_over));
    let spots = search.dots_refused.iter().map(|(reason, count)| (*count, format!("{reason} (dark spots)")));
    [
        StageLine::new(
            match report.source {
                PictureSource::Frames => "Board in the camera's frames",
                PictureSource::StillViews => "Board in views at rest",
            },
            Amount::new(search.frames, report.source.to_string()),
            Amount::new(search.with_board, "with the board"),
        )
        .dropping(refused)
        .noting(passed_over.into_iter().chain(without).chain(search.notes.iter().cloned())),
        StageLine::new("Points", Amount::new(search.dots, "points"), Amount::new(search.board_dots, "on boards"))
            .dropping(spots)
            .noting((search.blur > 0.0).then(|| format!("their edges are blurred by {:.2} px", search.blur))),
    ]
}

fn used_line(report: &PictureReport, spread: f64, inflation: f64) -> StageLine {
    let with_board = report.detection.with_board;
    let reasons = (with_board > report.used as u64).then(|| format!("the others were dropped ({})", report.dropped));
    StageLine::new(
        format!("Calibration from {}", report.source),
        Amount::new(with_board, format!("{} with the board", report.source)),
        Amount::new(report.used as u64, format!("{} with {} points", report.source, report.dots_used)),
    )
    .noting(reasons)
    .noting([
        format!("a centre scatters by {spread:.3} px"),
        format!(
            "errors of the centres are correlated: the variance of the parameters is {inflation:.1} times as large as without"
        ),
    ])
}

fn cross_check_line(outcome: &CrossCheckOutcome) -> StageLine {
    match outcome {
        CrossCheckOutcome::Compared(cross_check) => {
            let Comparison { report, spread, inflation, .. } = &cross_check.comparison;
            used_line(report, *spread, *inflation)
        }
        CrossCheckOutcome::Failed(failure) => StageLine::new(
            "Calibration from frames",
            Amount::new(failure.report.detection.with_board, "frames with the board"),
            Amount::new(0, "frames"),
        )
        .noting([format!("no calibration: {failure}")]),
    }
}

fn joint_line(joint: &JointReport) -> StageLine {
    let offset = format!("{:.3} ± {:.3} ms", 1e3 * joint.time_offset, 1e3 * joint.time_offset_sigma);
    StageLine::new(
        "Frames solved with the events",
        Amount::new((joint.dots + joint.dots_elsewhere) as u64, "points"),
        Amount::new(joint.dots as u64, format!("points of {} frames", joint.frames)),
    )
    .dropping([(joint.dots_elsewhere as u64, "not at the position that the trajectory predicts".to_owned())])
    .noting([format!("events come {offset} later"), format!("spread {:.3} px", joint.spread)])
}
