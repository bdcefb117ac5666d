//! Both cameras in one solve: the events of the second are rows on the trajectories of the first.
//!
//! The border of the normal equations contains the mount (transform, offset, rate, for frames the line delay), then lens and
//! event biases of the second camera, then lens and event biases of the first. The board is fixed at the result of the first
//! camera, because both see the same board.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::error::SecondCameraError;
use super::estimate::Estimate;
use super::mount::{RATE, RATE_SIGMA};
use super::rows::{SecondPart, second_parts};
use crate::quality::uncertainty::blocks::jackknife_step;
use crate::quality::uncertainty::{BLOCK, Time, reported_covariance};
use crate::solve::bearing_table::BearingTable;
use crate::solve::bordered::{Part, Step, System, event_parts, minimise, moved_by};
use crate::solve::fixed_intrinsics::{FixedIntrinsics, share_of_fixed};
use crate::solve::levenberg::linearised;
use crate::solve::observation_range::{ObservationRange, RANGES_TOGETHER, observation_ranges};
use crate::solve::{Problem, State};
use crate::trajectory::Trajectory;

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

/// The equations at an estimate.
struct Linearised {
    parts: Vec<Part>,
    system: System,
    /// Number of observations of the first and the second camera.
    counts: [usize; 2],
    misfit: Vec<Misfit>,
    /// Misfit over the whole recording.
    rms: f64,
}

/// Solves, starting at `estimate`.
///
/// # Errors
/// [`SecondCameraError::Singular`] if the events do not determine the parameters.
pub fn solve(joint: &Joint, estimate: Estimate) -> Result<Solved, SecondCameraError> {
    let start = linearise(joint, &estimate)?;
    let attempt = |_, (estimate, now): (&Estimate, &Linearised), step: &Step| {
        let Some(trial) = stepped(joint, estimate, step) else { return Ok(None) };
        let next = linearise(joint, &trial)?;
        // The loss of observations outside a model's domain must not make a step look good.
        Ok::<_, SecondCameraError>(next.counts.iter().ge(now.counts.iter()).then_some((trial, next)))
    };
    let (estimate, now) = minimise(estimate, start, |now: &Linearised| &now.system, attempt)?;
    let formal = now.system.covariance()?;
    let blocks = now.system.contributions(&now.parts, 0.5 * BLOCK)?;
    let total = estimate.first.trajectories.iter().map(|one| one.end() - one.start()).sum();
    let time = Time { starts: &blocks.times, total };
    let count = estimate.mount.count();
    // Only the covariance of the intrinsics contains errors common to all blocks. Here the longer steps of the jackknife make up for
    // them: the rms of error / σ is 0.6 to 1.1 with them, and 0.8 to 1.5 with limited steps (seeds 606 to 611).
    let (covariance, inflation, blocks) =
        reported_covariance(&formal, &blocks.contributions, &|all| all, time, count, jackknife_step);
    Ok(Solved { estimate, covariance, inflation, blocks, used: now.counts[1], misfit: now.misfit, rms: now.rms })
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
    let system = linearise(&with_lenses, estimate)?.system;
    let of_second = estimate.mount.count();
    let of_first = of_second + with_lenses.second.free.places().len();
    let fixed = lenses.into_iter().zip([of_first, of_second]).filter_map(|(lens, place)| {
        let covariance = lens?.uncertain_covariance();
        Some((place..place + covariance.nrows(), covariance))
    });
    let share = share_of_fixed(&system, &fixed.collect::<Vec<_>>())?;
    Ok(Some(share.view((0, 0), (of_second, of_second)).into_owned()))
}

fn linearise(joint: &Joint, estimate: &Estimate) -> Result<Linearised, SecondCameraError> {
    let of_second = joint.second.free.places();
    let trajectories = &estimate.first.trajectories;
    let order = trajectories.first().ok_or(SecondCameraError::Singular)?.degree + 1;
    let offset = estimate.mount.count() + of_second.len();
    let (mut parts, first_count) = event_parts(&joint.first, &estimate.first, offset, 1.0);
    let mut counts = [first_count, 0];
    let bearings = BearingTable::new(&estimate.second.camera, joint.second.sensor);
    let of_range = |range: &ObservationRange| second_parts(&joint.second, estimate, &bearings, &of_second, range);
    let second: Vec<SecondPart> =
        observation_ranges(&joint.second.segments).par_iter().flat_map_iter(of_range).collect();
    let mut misfit = Vec::with_capacity(second.len());
    let mut cost = 0.0;
    for SecondPart { part, count } in second {
        misfit.push(Misfit { t: part.t, rms: rms(part.cost, count) });
        cost += part.cost;
        counts[1] += count;
        parts.push(part);
    }
    let control_points: Vec<usize> = trajectories.iter().map(Trajectory::control_point_count).collect();
    let globals = offset + joint.first.free.places().len();
    let mut system = System::new(&control_points, order, globals, parts.iter());
    system.add_smoothness(trajectories);
    system.add_jerks(trajectories, &joint.first.stiffness);
    system.add_prior(RATE, estimate.mount.rate, RATE_SIGMA);
    Ok(Linearised { parts, system, counts, misfit, rms: rms(cost, counts[1]) })
}

/// Returns the root mean square of `count` residuals whose sum of ρ is `cost`.
fn rms(cost: f64, count: usize) -> f64 {
    (2.0 * cost / count.max(1) as f64).sqrt()
}

/// Returns the misfit of the events of `problem` for a `state` with its own trajectories, like [`Misfit::rms`] over the whole
/// recording.
pub fn own_rms(problem: &Problem, state: &State) -> f64 {
    let bearings = BearingTable::new(&state.camera, problem.sensor);
    let (mut cost, mut count) = (0.0, 0);
    for group in observation_ranges(&problem.segments).chunks(RANGES_TOGETHER) {
        for (_, equations) in linearised(problem, state, &bearings, group) {
            cost += equations.loss.cost;
            count += equations.loss.count;
        }
    }
    rms(cost, count)
}

/// Returns the estimate after a step; `None` if a camera model rejects it.
fn stepped(joint: &Joint, estimate: &Estimate, step: &Step) -> Option<Estimate> {
    let count = estimate.mount.count();
    let second = moved_by(&estimate.second, &joint.second, step, count)?;
    let first = moved_by(&estimate.first, &joint.first, step, count + joint.second.free.places().len())?;
    Some(Estimate { first, second, mount: estimate.mount.moved(&step.globals) })
}
