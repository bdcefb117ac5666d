//! The joint solve of events and IMU samples.
//!
//! The trajectories become splines of degree 5 with even knots, whose acceleration is smooth enough for inertial sensors. The
//! events keep their own equations, divided by ten times their inflation, because their errors depend on the motion, which the IMU
//! measures too (`CAUTION`). Camera and event biases are estimated too. The noise of the sensors is estimated from the
//! spectrum of the residuals in rounds.

use std::ops::ControlFlow;

use rayon::prelude::*;

use super::error::InertialError;
use super::joint::{DEGREE, Estimate, Joint, Noise, Residual, SENSORS};
use super::noise::{Line, density, spectrum};
use super::parameters::{COUNT, InertialParameters};
use super::priors::priors;
use super::sample::Sample;
use super::sample_rows::{residuals, sample_pieces};
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;
use evcal_geometry::timed_pose::TimedPose;
use evcal_solve::solve::SolveError;
use evcal_solve::solve::equations::border::Columns;
use evcal_solve::solve::equations::normal::Equations;
use evcal_solve::solve::equations::system::{Step, System};
use evcal_solve::solve::levenberg::{self, OF_MOUNTED, after, minimise, pieces};
use evcal_solve::trajectory::fit::fit_on_knots;
use evcal_solve::trajectory::{RotationSpline, Trajectory};

/// Time at the ends of a trajectory whose samples are excluded (s).
const MARGIN: f64 = 0.02;
/// Rounds of noise and solve.
const ROUNDS: usize = 3;
/// Iterations of the first round in which the events are linearised again.
const RELINEARISED: usize = 5;
/// Factor by which the weight of events is reduced here, beyond their inflation. The delay of pixels depends on the speed of the
/// edge, so the trajectory has the same error whenever the same motion recurs, and scatter between blocks of time does not show
/// it. In five simulated recordings (seeds 201, 202, 312 to 314) the error along z was 0.27 mm with 10 and 0.37 mm with 1, the
/// error of gravity 0.009° and 0.013° (root mean square); with 100 the position along x was 0.20 mm off on two seeds.
const CAUTION: f64 = 10.0;
/// Noise density of a gyroscope before its estimation (rad/s/√Hz): twice the value of data sheets.
const FIRST_GYROSCOPE: f64 = 0.02 * std::f64::consts::PI / 180.0;
/// The same for an accelerometer (m/s²/√Hz).
const FIRST_ACCELEROMETER: f64 = 600e-6 * STANDARD_GRAVITY;

/// The solution with its equations.
pub struct Solved {
    /// The solution.
    pub estimate: Estimate,
    /// The sum of all pieces: those of the events, then those of the samples.
    pub system: System,
    /// Residuals of gyroscope and accelerometer.
    pub residuals: [Vec<Residual>; 2],
    /// Their spectra, for each axis.
    pub spectra: [Vec<Vec<Line>>; 2],
}

/// Returns the trajectories as splines of degree 5 with even knots `spacing` seconds apart.
///
/// # Errors
/// [`InertialError::Singular`] if a trajectory is too short for it.
pub fn smooth_trajectories(trajectories: &[Trajectory], spacing: f64) -> Result<Vec<Trajectory>, InertialError> {
    /// Poses per knot span.
    const POSES: usize = 4;
    let smooth = |trajectory: &Trajectory| {
        let (start, end) = (trajectory.start(), trajectory.end());
        let spans = ((end - start) / spacing).round().max(2.0) as usize;
        let knot = |index: usize| start + (end - start) * index as f64 / spans as f64;
        let mut knots = vec![start; DEGREE];
        knots.extend((0..spans).map(knot));
        knots.extend([end; DEGREE + 1]);
        let count = POSES * spans;
        let times = (0..=count)
            .map(|index| if index == count { end } else { start + (end - start) * index as f64 / count as f64 });
        let poses: Vec<TimedPose> =
            times.filter_map(|t| trajectory.pose(t).map(|pose| TimedPose { t, pose })).collect();
        fit_on_knots(trajectory.recording, &poses, knots, DEGREE, RotationSpline::Quaternion)
            .map_err(|_| InertialError::Singular)
    };
    trajectories.par_iter().map(smooth).collect()
}

/// Returns, for each trajectory, the samples within it, without its ends.
pub fn samples_within(
    trajectories: &[Trajectory],
    samples: &[Vec<Sample>],
    parameters: &InertialParameters,
) -> Vec<std::ops::Range<usize>> {
    let within = |trajectory: &Trajectory| {
        let samples = samples.get(trajectory.recording).map(Vec::as_slice).unwrap_or_default();
        let place = |t: f64| samples.partition_point(|sample| sample.t - parameters.gyroscope_delay < t);
        let (first, last) = (place(trajectory.start() + MARGIN), place(trajectory.end() - MARGIN));
        first..last.max(first)
    };
    trajectories.iter().map(within).collect()
}

/// Returns the noise from data sheets.
pub fn first_noise() -> [Noise; 2] {
    [FIRST_GYROSCOPE, FIRST_ACCELEROMETER].map(|density| Noise { density: [density; 3], measured: false })
}

/// Solves, starting at `estimate`.
///
/// # Errors
/// [`InertialError::Singular`] if events and samples do not determine the parameters.
pub fn solve(joint: &Joint, mut estimate: Estimate) -> Result<Solved, InertialError> {
    for round in 0..ROUNDS {
        let found = least_cost(joint, estimate, if round == 0 { RELINEARISED } else { 0 })?;
        estimate = found.estimate;
        let residuals = SENSORS.map(|sensor| residuals(joint, &estimate, sensor));
        let spectra = residuals.each_ref().map(|residuals| spectra_of(residuals, joint.rate));
        let noise = measured_noise(&spectra, joint, &estimate.noise);
        if round + 1 == ROUNDS {
            return Ok(Solved { estimate, system: found.system, residuals, spectra });
        }
        estimate.noise = noise;
    }
    Err(InertialError::Singular)
}

fn measured_noise(spectra: &[Vec<Vec<Line>>; 2], joint: &Joint, before: &[Noise; 2]) -> [Noise; 2] {
    std::array::from_fn(|sensor| {
        let found: Vec<f64> =
            spectra[sensor].iter().filter_map(|axis| density(axis, joint.rate, joint.knot_spacing)).collect();
        match *found.as_slice() {
            [x, y, z] => Noise { density: [x, y, z], measured: true },
            _ => before[sensor],
        }
    })
}

fn spectra_of(residuals: &[Residual], rate: f64) -> Vec<Vec<Line>> {
    let axis = |axis: usize| {
        let values: Vec<(f64, f64)> = residuals.iter().map(|residual| (residual.t, residual.value[axis])).collect();
        spectrum(&values, rate)
    };
    (0..3).map(axis).collect()
}

/// Returns the normal equations at an estimate.
///
/// # Errors
/// [`SolveError::OutOfBand`] if observations and trajectories do not fit together.
pub fn system_at(joint: &Joint, estimate: &Estimate) -> Result<System, SolveError> {
    with_samples(joint, estimate, pieces_of_events(joint, estimate)?)
}

/// Minimises the cost. The events are linearised again `relinearised` times; their cost is nearly quadratic.
fn least_cost(
    joint: &Joint,
    estimate: Estimate,
    relinearised: usize,
) -> Result<levenberg::Solved<Estimate>, SolveError> {
    let start = system_at(joint, &estimate)?;
    let again = |iteration, trial: &Estimate, (now, step): (&System, &Step)| {
        let events = if iteration < relinearised {
            pieces_of_events(joint, trial)?
        } else {
            let of_events = now.pieces.par_iter().filter(|piece| !piece.information.is_empty());
            of_events.map(|piece| piece.moved(&step.segments, &step.globals)).collect::<Result<_, _>>()?
        };
        with_samples(joint, trial, events)
    };
    let stepped = |estimate: &Estimate, step: &Step| {
        let state = after(joint.problem, &estimate.state, &columns(joint), step)?;
        Some(Estimate { state, parameters: estimate.parameters.moved(&step.globals), noise: estimate.noise })
    };
    minimise(&OF_MOUNTED, estimate, start, stepped, again, &mut |_| ControlFlow::Continue(()))
}

/// Returns the columns of the events' camera, which follow those of the IMU.
fn columns(joint: &Joint) -> Columns {
    Columns::new(&joint.problem.free.mask()).at(COUNT)
}

fn pieces_of_events(joint: &Joint, estimate: &Estimate) -> Result<Vec<Equations>, SolveError> {
    let weight = 1.0 / (CAUTION * joint.inflation);
    let events = pieces(joint.problem, &estimate.state, &columns(joint))?;
    Ok(events.into_par_iter().map(|piece| piece.weighted(weight)).collect())
}

fn with_samples(joint: &Joint, estimate: &Estimate, mut pieces: Vec<Equations>) -> Result<System, SolveError> {
    pieces.extend(sample_pieces(joint, estimate));
    let mut system = System::of_pieces(pieces, columns(joint).range().end, &estimate.state.trajectories, &[])?;
    for (index, (distance, sigma)) in priors(&estimate.parameters, joint.settings).into_iter().enumerate() {
        system.add_prior(index, distance, sigma);
    }
    Ok(system)
}
