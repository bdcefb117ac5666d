//! The joint solve, and how sure its result is.

use super::Task;
use super::error::CalibrateError;
use super::progress::Progress;
use crate::solve::State;
use crate::solve::refinement::{Refined, RefinementInput, StageSettings, refine};
use crate::trust::uncertainty::{SolveUncertainty, uncertainty};

/// The joint solve from `state` on, and how sure its result is.
pub(super) fn solve(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    progress: &Progress,
) -> Result<(Refined, SolveUncertainty), CalibrateError> {
    let settings = task.settings;
    let stage = StageSettings {
        refinement: &settings.refinement,
        knots: &settings.knots,
        unexplained: &settings.unexplained,
        association: &settings.association,
        solve: &settings.solve,
    };
    // An answer that it should end is heard when the round reads its events.
    let tell = |round| {
        let _ = progress.tell(format!("joint solve, round {}", round + 1));
    };
    let refined = refine(input, state, stage, tell)?;
    progress.go_on()?;
    let certainty =
        uncertainty(&refined.problem, &refined.state, &settings.uncertainty).map_err(CalibrateError::Solve)?;
    Ok((refined, certainty))
}
