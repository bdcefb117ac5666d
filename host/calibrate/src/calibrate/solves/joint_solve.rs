//! The joint solve, and the uncertainty of its result.

use evcal_core::camera::MAX_PARAMETERS;
use evcal_geometry::board::shape::PARAMETERS;

use crate::quality::uncertainty::{SolveUncertainty, uncertainty};
use crate::settings::Settings;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::progress::Progress;
use evcal_solve::solve::State;
use evcal_solve::solve::refinement::{EventInput, Refined, RefinementInput, StageSettings, refine};
use evcal_solve::trajectory::first::FirstTrajectorySettings;

/// Returns the settings of the joint solve.
pub(in crate::calibrate) fn stage_settings(settings: &Settings) -> StageSettings<'_> {
    StageSettings {
        refinement: &settings.refinement,
        knots: &settings.knots,
        association: &settings.association,
        solve: &settings.solve,
    }
}

/// Returns the settings of the trajectories at its start.
pub(in crate::calibrate) fn trajectory_settings(settings: &Settings) -> FirstTrajectorySettings<'_> {
    FirstTrajectorySettings { segment: &settings.segment, spline: &settings.spline, knots: &settings.knots }
}

/// Runs the joint solve from `state` on.
pub(in crate::calibrate) fn refined(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    progress: &Progress,
) -> Result<Refined, CalibrateError> {
    let stage = stage_settings(task.settings);
    let on_progress = |round, done| progress.report_part(&format!("joint solve, round {}", round + 1), done);
    Ok(refine(input, state, stage, on_progress)?)
}

/// Returns the uncertainty of a joint solve.
pub(in crate::calibrate) fn certainty(refined: &Refined) -> Result<SolveUncertainty, CalibrateError> {
    uncertainty(&refined.problem, &refined.state).map_err(CalibrateError::Solve)
}

/// Runs the joint solve from `state` on, and computes the uncertainty of its result.
pub(in crate::calibrate) fn solve(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    progress: &Progress,
) -> Result<(Refined, SolveUncertainty), CalibrateError> {
    let refined = refined(task, input, state, progress)?;
    progress.report("uncertainty")?;
    let certainty = certainty(&refined)?;
    Ok((refined, certainty))
}

/// Returns `input` with these estimated parameters of the board and these fixed intrinsics.
pub(in crate::calibrate) fn with<'a>(
    input: &RefinementInput<'a, CalibrateError>,
    free_board: [bool; PARAMETERS],
    fixed: [bool; MAX_PARAMETERS],
) -> RefinementInput<'a, CalibrateError> {
    let events = input.events.as_ref().map(|events| EventInput { ..*events });
    RefinementInput { free_board, fixed, points: input.points.clone(), events, ..*input }
}
