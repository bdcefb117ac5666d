//! Both cameras in one solve: the events of the second are rows on the trajectories of the first.
//!
//! The border of the normal equations contains the mount (transform, offset, rate, for frames the line delay), then lens and
//! event biases of the second camera, then lens and event biases of the first. The board is fixed at the result of the first
//! camera, because both see the same board.

use std::ops::ControlFlow;

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::error::SecondCameraError;
use super::estimate::Estimate;
use super::mount::{RATE, RATE_SIGMA};
use super::rows::second_pieces;
use crate::quality::uncertainty::blocks::jackknife_step;
use crate::quality::uncertainty::{BLOCK, Time, reported_covariance};
use evcal_solve::solve::equations::border::Columns;
use evcal_solve::solve::equations::normal::Equations;
use evcal_solve::solve::equations::system::{Blocks, Step, System};
use evcal_solve::solve::fixed_intrinsics::{FixedIntrinsics, share_of_fixed};
use evcal_solve::solve::levenberg::{self, OF_MOUNTED, after, minimise, pieces};
use evcal_solve::solve::observation_range::{ObservationRange, observation_ranges};
use evcal_solve::solve::rows::bearing_table::BearingTable;
use evcal_solve::solve::rows::loss::Loss;
use evcal_solve::solve::{Problem, SolveError, State};

/// Fixed intrinsics of the first and the second camera; `None` for intrinsics that are estimated.
pub type Lenses<'a> = [Option<&'a FixedIntrinsics>; 2];

/// Constant input of the solve.
pub struct Joint {
    /// The events of the first camera.
    pub first: Problem,
    /// The events of the second, at times when the first had the board in view too, with the first camera's numbers of the
    /// circles.
    pub second: Problem,
}

/// Misfit of the second camera's events over an interval of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Time of the first clock (s).
    pub t: f64,
    /// Root mean square distance from the edges, in σ of the events, with Huber's loss.
    pub rms: f64,
}

/// The solution.
pub struct Solved {
    /// The parameters.
    pub estimate: Estimate,
    /// Covariance of the mount.
    pub covariance: DMatrix<f64>,
    /// Ratio of the covariance to that with independent events.
    pub inflation: f64,
    /// Number of blocks of time from which the inflation was estimated.
    pub blocks: usize,
    /// Number of events of the second camera.
    pub used: usize,
    /// Misfit of these events, in order of time.
    pub misfit: Vec<Misfit>,
    /// Misfit over the whole recording.
    pub rms: f64,
}

/// Returns the columns of the first and the second camera; those of the second follow the mount's.
fn columns(joint: &Joint, estimate: &Estimate) -> [Columns; 2] {
    let second = Columns::after(estimate.mount.count(), &joint.second.free.mask());
    [Columns::new(&joint.first.free.mask()).at(second.width()), second]
}

/// Solves, starting at `estimate`.
///
/// # Errors
/// [`SecondCameraError::Singular`] if the events do not determine the parameters.
pub fn solve(joint: &Joint, estimate: Estimate) -> Result<Solved, SecondCameraError> {
    let start = linearise(joint, &estimate)?;
    let again = |_, estimate: &Estimate, _: (&System, &Step)| linearise(joint, estimate);
    let stepped = |estimate: &Estimate, step: &Step| stepped(joint, estimate, step);
    let levenberg::Solved { estimate, mut system, .. } =
        minimise(&OF_MOUNTED, estimate, start, stepped, again, &mut |_| ControlFlow::Continue(()))?;
    let pieces = std::mem::take(&mut system.pieces);
    let reduced = system.into_reduced()?;
    let formal = reduced.whole_covariance()?;
    let Blocks { times, contributions } = reduced.into_follows().blocks(&pieces, 0.5 * BLOCK)?;
    let total = estimate.first.trajectories.iter().map(|one| one.end() - one.start()).sum();
    let time = Time { starts: &times, total };
    let count = estimate.mount.count();
    // Only the covariance of the intrinsics contains errors common to all blocks. Here the longer steps of the jackknife make up for
    // them: the rms of error / σ is 0.6 to 1.1 with them, and 0.8 to 1.5 with limited steps (seeds 606 to 611).
    let (covariance, inflation, blocks) =
        reported_covariance(&formal, &contributions, &|all| all, time, count, jackknife_step);
    // The columns of the second camera are the first ones.
    let of_second = || pieces.iter().filter(|piece| piece.columns.start == 0);
    let misfit = of_second().map(|piece| Misfit { t: piece.t, rms: rms(&piece.loss) }).collect();
    let loss = sum(of_second());
    Ok(Solved { estimate, covariance, inflation, blocks, used: loss.count, misfit, rms: rms(&loss) })
}

/// Returns the covariance that fixed lenses add to the covariance of the mount at `estimate`, for the first and the second
/// camera.
///
/// # Errors
/// [`SecondCameraError::Singular`] if the events do not determine the parameters.
pub fn share_of_lenses(
    joint: &Joint,
    estimate: &Estimate,
    lenses: Lenses,
) -> Result<Option<DMatrix<f64>>, SecondCameraError> {
    if lenses.iter().all(Option::is_none) {
        return Ok(None);
    }
    let with_lens = |lens: Option<&FixedIntrinsics>, problem: &Problem| match lens {
        Some(lens) => lens.with_uncertain_estimated(problem),
        None => problem.with_segments(problem.segments.clone()),
    };
    let with_lenses = Joint { first: with_lens(lenses[0], &joint.first), second: with_lens(lenses[1], &joint.second) };
    let reduced = linearise(&with_lenses, estimate)?.into_reduced()?;
    let of_second = estimate.mount.count();
    let [first, _] = columns(&with_lenses, estimate);
    let of_first = first.range().start;
    let fixed = lenses.into_iter().zip([of_first, of_second]).filter_map(|(lens, place)| {
        let covariance = lens?.uncertain_covariance();
        Some((place..place + covariance.nrows(), covariance))
    });
    let share = share_of_fixed(&reduced, &fixed.collect::<Vec<_>>())?;
    Ok(Some(share.view((0, 0), (of_second, of_second)).into_owned()))
}

/// Returns the equations at an estimate: the pieces of the first camera, then those of the second.
fn linearise(joint: &Joint, estimate: &Estimate) -> Result<System, SolveError> {
    let [of_first, of_second] = columns(joint, estimate);
    let mut all = pieces(&joint.first, &estimate.first, &of_first)?;
    let bearings = BearingTable::new(&estimate.second.camera, joint.second.sensor);
    let of_range = |range: &ObservationRange| second_pieces(&joint.second, estimate, &bearings, &of_second, range);
    let second = observation_ranges(&joint.second.segments).par_iter().map(of_range).collect::<Result<Vec<_>, _>>()?;
    all.extend(second.into_iter().flatten());
    let width = of_first.range().end;
    let mut system = System::of_pieces(all, width, &estimate.first.trajectories, &joint.first.stiffness)?;
    system.add_prior(RATE, estimate.mount.rate, RATE_SIGMA);
    Ok(system)
}

/// Returns the loss of all `pieces`.
fn sum<'a>(pieces: impl Iterator<Item = &'a Equations>) -> Loss {
    pieces.fold(Loss::default(), |mut sum, piece| {
        sum.add(&piece.loss);
        sum
    })
}

/// Returns the root mean square of the residuals.
fn rms(loss: &Loss) -> f64 {
    (2.0 * loss.cost / loss.count.max(1) as f64).sqrt()
}

/// Returns the misfit of the events of `problem` for a `state` with its own trajectories, like [`Misfit::rms`] over the whole
/// recording.
///
/// # Errors
/// [`SolveError::OutOfBand`] if observations and trajectories do not fit together.
pub fn own_rms(problem: &Problem, state: &State) -> Result<f64, SolveError> {
    Ok(rms(&sum(pieces(problem, state, &Columns::none())?.iter())))
}

/// Returns the estimate after a step; `None` if a camera model rejects it.
fn stepped(joint: &Joint, estimate: &Estimate, step: &Step) -> Option<Estimate> {
    let [of_first, of_second] = columns(joint, estimate);
    let first = after(&joint.first, &estimate.first, &of_first, step)?;
    let second = after(&joint.second, &estimate.second, &of_second, step)?;
    Some(Estimate { first, second, mount: estimate.mount.moved(&step.globals) })
}
