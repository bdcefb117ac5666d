//! The joint solve, and how sure its result is.

use super::Task;
use super::error::CalibrateError;
use super::progress::Progress;
use crate::settings::Settings;
use crate::solve::State;
use crate::solve::refinement::{Refined, RefinementInput, StageSettings, refine};
use crate::solve::system::System;
use crate::trajectory::first::FirstTrajectorySettings;
use crate::trust::ExamineSettings;
use crate::trust::uncertainty::{SolveUncertainty, uncertainty};

/// The settings of the joint solve among all.
pub(super) fn stage_settings(settings: &Settings) -> StageSettings<'_> {
    StageSettings {
        refinement: &settings.refinement,
        knots: &settings.knots,
        unexplained: &settings.unexplained,
        association: &settings.association,
        solve: &settings.solve,
    }
}

/// The settings of the trajectories that it starts from.
pub(super) fn trajectory_settings(settings: &Settings) -> FirstTrajectorySettings<'_> {
    FirstTrajectorySettings { segment: &settings.segment, spline: &settings.spline, knots: &settings.knots }
}

/// How its result is looked at.
pub(super) fn examine_settings(settings: &Settings) -> ExamineSettings<'_> {
    ExamineSettings { halves: &settings.split_half, map: &settings.residual_map, verdict: &settings.verdict }
}

/// The joint solve from `state` on, and the system at its result.
pub(super) fn refined(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    progress: &Progress,
) -> Result<(Refined, System), CalibrateError> {
    let stage = stage_settings(task.settings);
    let tell = |round, done| progress.tell_part(&format!("joint solve, round {}", round + 1), done);
    Ok(refine(input, state, stage, tell)?)
}

/// How sure a joint solve is whose result has this `system`.
pub(super) fn certainty(task: &Task, refined: &Refined, system: System) -> Result<SolveUncertainty, CalibrateError> {
    uncertainty(&refined.problem, &refined.state, system, &task.settings.uncertainty).map_err(CalibrateError::Solve)
}

/// The joint solve from `state` on, and how sure its result is.
pub(super) fn solve(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    progress: &Progress,
) -> Result<(Refined, SolveUncertainty), CalibrateError> {
    let (refined, system) = refined(task, input, state, progress)?;
    progress.tell("uncertainty")?;
    let certainty = certainty(task, &refined, system)?;
    Ok((refined, certainty))
}
