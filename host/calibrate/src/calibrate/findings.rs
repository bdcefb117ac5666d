//! Examination of a calibration and of its recordings. Each file of the folder looks for one kind of fault.

mod changed;
pub(super) mod health;
pub(super) mod orientation;
mod other_camera;
mod unseen_rows;
mod unstated_rows;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;

use self::health::Health;
use crate::calibrate::solves::board_solve::BoardSolve;
use crate::quality::cross_check::CrossCheckOutcome;
use crate::quality::verdict::{Cause, Finding, Verdict, verdict};
use crate::quality::{EventQuality, Quality, SolveCertainty, examine};
use crate::task::Task;
use crate::task::error::CalibrateError;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::detection::recognition::larger_pattern::larger_pattern;
use evcal_detection::detection::unplaced::UnplacedWindows;
use evcal_solve::initial::InitialModel;
use evcal_solve::initial::model_choice::{CANDIDATES, ModelRequest, USUAL};
use evcal_solve::solve::State;
use evcal_solve::solve::left_out::LeftOut;
use evcal_solve::solve::refinement::Refined;

/// Results of the stages before the joint solve.
pub(super) struct Seen<'a> {
    pub(super) sensor: Sensor,
    /// Findings on light and pixels.
    pub(super) health: &'a [Health],
    /// Windows with more circles than the board has.
    pub(super) unplaced: &'a [UnplacedWindows],
    /// The frames in the joint solve.
    pub(super) frames: &'a [ReferenceFrame],
    /// The first camera.
    pub(super) initial: &'a InitialModel,
}

/// A calibration and its quality measures.
pub(super) struct Examined {
    pub(super) refined: Refined,
    pub(super) quality: Quality,
    pub(super) event_quality: EventQuality,
    pub(super) cross_check: Option<CrossCheckOutcome>,
    pub(super) verdict: Verdict,
}

/// Examines the joint solve, which includes the `saturated` intervals, and builds the verdict on everything.
///
/// # Errors
/// [`CalibrateError::Solve`] if the observations do not determine the camera.
pub(super) fn examine_calibration(
    task: &Task,
    seen: &Seen,
    solve: BoardSolve,
    saturated: &[LeftOut],
    cross_check: Option<CrossCheckOutcome>,
) -> Result<Examined, CalibrateError> {
    let BoardSolve { mut refined, certainty: uncertainty, board, undetermined, fixed_values, .. } = solve;
    let certainty = SolveCertainty { uncertainty, board, undetermined };
    // The usual model is what most lenses have. Every other choice rests on the events.
    let models: &[ModelKind] = match task.model() {
        ModelRequest::Given(_) => &[],
        ModelRequest::Usual if refined.state.camera.kind() == USUAL => &[],
        ModelRequest::Usual | ModelRequest::Auto => &CANDIDATES,
    };
    let scale = seen.health.iter().filter_map(|health| health.lost_events).map(|lost| lost.scale()).fold(0.0, f64::max);
    let (quality, event_quality) =
        examine(&refined, certainty, task.board, saturated, scale, models).map_err(CalibrateError::Solve)?;
    refined.events = Vec::new();
    let (mut findings, cross_check) = findings(task, seen, &refined.state, cross_check);
    findings.extend(fixed_values);
    let good = task.settings.verdict.good;
    findings.extend(event_quality.drift.as_ref().map(|drift| changed::finding_on(task.inputs, drift, good)));
    let camera = &refined.state.camera;
    let settings = &task.settings.verdict;
    let verdict = verdict(camera, &quality, Some(&event_quality), task.board, seen.sensor, findings, settings);
    Ok(Examined { refined, quality, event_quality, cross_check, verdict })
}

/// Returns the findings on the recordings at the solution `state`, and the cross-check with pictures. If the board
/// turned out to be larger than the nominal one, the reason of a failed cross-check mentions it.
fn findings(
    task: &Task,
    seen: &Seen,
    state: &State,
    cross_check: Option<CrossCheckOutcome>,
) -> (Vec<Finding>, Option<CrossCheckOutcome>) {
    let mut findings = health::findings_on(seen.health);
    if !has_square_pixels(&state.camera) {
        // Each edge passes both pixels that were binned to one.
        findings.retain(|finding| finding.cause != Cause::DoubleEdges);
    }
    findings.extend(other_camera::findings_on(task.inputs, seen.frames, seen.initial));
    findings.extend(unseen_rows::finding_on(task.board.lattice(), seen.frames));
    let circles = task.board.circles();
    let larger = circles.and_then(|board| larger_pattern(seen.unplaced, board.pattern, seen.sensor));
    let cross_check =
        if larger.is_some() { cross_check.map(CrossCheckOutcome::with_larger_board) } else { cross_check };
    findings.extend(
        larger
            .zip(circles)
            .map(|(larger, board)| unstated_rows::finding_on(&larger, board, &state.camera, &state.trajectories)),
    );
    findings.extend(cross_check.as_ref().and_then(CrossCheckOutcome::finding));
    findings.extend(task.board_finding.cloned());
    findings.extend(orientation::finding_on(task.board, seen.sensor));
    (findings, cross_check)
}

/// Returns `false` if pixels were binned along one axis.
fn has_square_pixels(camera: &Camera<f64>) -> bool {
    /// Largest ratio of the focal lengths of square pixels.
    const SQUARE: f64 = 1.3;
    camera.axial_focal_lengths().is_none_or(|[x, y]| x < SQUARE * y && y < SQUARE * x)
}
