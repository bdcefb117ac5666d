//! Trajectories along intervals outside the joint solve, with the camera and the biases of the events fixed.

use super::Problem;
use super::State;
use super::association::AssociationReport;
use super::knot_choice::choose_knots;
use super::left_out::{LeftOut, leave_out};
use super::levenberg::{assemble, solve};
use super::observation_range::{observation_ranges, residuals_at};
use super::refinement::{Associated, RefinementError, RefinementInput, StageSettings, associate_all, hold, problem};
use super::unexplained::unexplained;
use crate::solve::equations::border::Columns;
use crate::solve::equations::system::System;
use crate::solve::rows::bearing_table::BearingTable;

/// Result along intervals with a fixed camera.
pub struct Followed {
    /// The unchanged camera with the solved trajectories.
    pub state: State,
    /// The normal equations there, with the columns of the parameters that were estimated with the camera.
    pub system: System,
    /// Intervals that no curve explains.
    pub left_out: Vec<LeftOut>,
    /// Counts of kept and dropped events.
    pub association: AssociationReport,
}

/// Solves the trajectories of `state` from the events of `input` with everything else in `state` fixed. The unit of
/// plane residuals comes from `solved`, the problem in which the camera was estimated.
///
/// # Errors
/// As [`refine`](super::refinement::refine).
pub fn follow<E: Send>(
    input: &RefinementInput<E>,
    mut state: State,
    solved: &Problem,
    settings: StageSettings,
) -> Result<Followed, RefinementError<E>> {
    let bearings = BearingTable::new(&state.camera, input.sensor);
    let associated = |state: &State| {
        let Associated { segments, report, .. } =
            associate_all(input, state, &bearings, settings, true, 1.0, &mut |_| {})?;
        let mut problem = problem(input, settings, segments, state);
        problem.mean_scale = solved.mean_scale;
        leave_out(&mut problem, state, input.left_out);
        Ok::<_, RefinementError<E>>((problem, report))
    };
    let (mut first, _) = associated(&state)?;
    hold(&mut first, input.anchors);
    state = solve(&first, state)?.estimate;
    let (mut problem, association) = associated(&state)?;
    let choice = choose_knots(&problem, &state, settings.knots)?;
    (state.trajectories, problem.stiffness) = (choice.trajectories, choice.stiffness);
    let mut followed = solve(&problem, state)?.estimate;
    let left_out = unexplained(&problem, &followed, &residuals_at(&problem, &followed));
    if !left_out.is_empty() {
        leave_out(&mut problem, &followed, &left_out);
        followed = solve(&problem, followed)?.estimate;
    }
    let ranges = observation_ranges(&problem.segments);
    let columns = Columns::new(&solved.free.mask());
    let system = assemble(&problem, &followed, &ranges, &columns)?;
    Ok(Followed { state: followed, system, left_out, association })
}
