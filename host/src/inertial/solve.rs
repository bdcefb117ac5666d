//! Events and inertial samples in one solve.
//!
//! The trajectories get splines of degree 5 with even knots, whose acceleration is smooth enough for inertial sensors. The
//! events keep their own equations, divided by their inflation, for errors of theirs that they share make them believe too
//! much; camera and event biases stay free. The noise of the sensors is taken from the spectrum of the residuals in rounds.

use rayon::prelude::*;

use super::error::InertialError;
use super::joint::{DEGREE, Estimate, Joint, Noise, ORDER, Residual, SENSORS};
use super::noise::{Line, density, spectrum};
use super::parameters::{COUNT, InertialParameters};
use super::priors::priors;
use super::sample::Sample;
use super::sample_rows::{inertial_parts, residuals};
use crate::numerics::gravity::STANDARD_GRAVITY;
use crate::solve::Problem;
use crate::solve::bearing_table::BearingTable;
use crate::solve::bordered::{Part, Step, System};
use crate::solve::levenberg::{linearised, moved};
use crate::solve::normal::StretchEquations;
use crate::solve::smoothness::accelerations;
use crate::solve::stretch::{Stretch, stretches};
use crate::trajectory::fit::fit_on_knots;
use crate::trajectory::timed_pose::TimedPose;
use crate::trajectory::{RotationSpline, Trajectory};

/// Time at the ends of a trajectory whose samples are left out (s).
const MARGIN: f64 = 0.02;
/// Rounds of noise and solve.
const ROUNDS: usize = 3;
/// Most iterations in a round.
const ITERATIONS: usize = 15;
/// Stretches of events that are linearised together.
const STRETCHES_TOGETHER: usize = 64;
/// Iterations of the first round that linearise the events anew.
const RELINEARISED: usize = 5;
/// Iterations end when the cost falls by less.
const SETTLED: f64 = 0.02;
/// Noise densities of data sheets: °/s/√Hz and g/√Hz, doubled.
const FIRST_GYROSCOPE: f64 = 0.02 * std::f64::consts::PI / 180.0;
const FIRST_ACCELEROMETER: f64 = 600e-6 * STANDARD_GRAVITY;

/// The solution with its equations.
pub struct Solved {
    /// The solution.
    pub estimate: Estimate,
    /// Equations of its parts.
    pub parts: Vec<Part>,
    /// All of them.
    pub system: System,
    /// Residuals of gyroscope and accelerometer.
    pub residuals: [Vec<Residual>; 2],
    /// Their spectra, for each axis.
    pub spectra: [Vec<Vec<Line>>; 2],
}

/// The trajectories as splines of degree 5 with even knots `spacing` seconds apart.
///
/// # Errors
/// [`InertialError::Singular`] when a trajectory is too short for it.
pub fn smooth_trajectories(trajectories: &[Trajectory], spacing: f64) -> Result<Vec<Trajectory>, InertialError> {
    /// Poses for each knot span.
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

/// For each trajectory the samples within it, but for its ends.
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

/// What data sheets say of the noise.
pub fn first_noise() -> [Noise; 2] {
    [FIRST_GYROSCOPE, FIRST_ACCELEROMETER].map(|density| Noise { density: [density; 3], measured: false })
}

/// Solves from `estimate` on.
///
/// # Errors
/// [`InertialError::Singular`] when events and samples do not determine the parameters.
pub fn solve(joint: &Joint, mut estimate: Estimate) -> Result<Solved, InertialError> {
    for round in 0..ROUNDS {
        let (solved, Linearised { events, parts, system }) =
            minimise(joint, estimate, if round == 0 { RELINEARISED } else { 0 })?;
        estimate = solved;
        let parts = [events, parts].concat();
        let residuals = SENSORS.map(|sensor| residuals(joint, &estimate, sensor));
        let spectra = residuals.each_ref().map(|residuals| spectra_of(residuals, joint.rate));
        let noise = measured_noise(&spectra, joint, &estimate.noise);
        if round + 1 == ROUNDS {
            return Ok(Solved { estimate, parts, system, residuals, spectra });
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

/// The equations at an estimate: those of the events, then those of the samples, and all together.
struct Linearised {
    events: Vec<Part>,
    parts: Vec<Part>,
    system: System,
}

/// The events are linearised anew `relinearised` times; their cost is nearly quadratic.
fn minimise(
    joint: &Joint,
    mut estimate: Estimate,
    relinearised: usize,
) -> Result<(Estimate, Linearised), InertialError> {
    let events = event_parts(joint, &estimate);
    let mut now = with_samples(joint, &estimate, events);
    let mut damping = 1e-9;
    for iteration in 0..ITERATIONS {
        let step = now.system.solve(damping)?;
        if step.predicted < SETTLED {
            break;
        }
        let trial = moved_by(joint, &estimate, &step).map(|trial| {
            let events = if iteration < relinearised {
                event_parts(joint, &trial)
            } else {
                now.events.par_iter().map(|part| part.moved(&step)).collect()
            };
            let linearised = with_samples(joint, &trial, events);
            (trial, linearised)
        });
        match trial {
            Some((trial, linearised)) if linearised.system.cost < now.system.cost => {
                let decrease = now.system.cost - linearised.system.cost;
                (estimate, now) = (trial, linearised);
                damping = (damping * 0.1).max(1e-9);
                if decrease < SETTLED {
                    break;
                }
            }
            _ if damping > 1e4 => break,
            _ => damping = (damping * 30.0).max(1e-5),
        }
    }
    Ok((estimate, now))
}

fn moved_by(joint: &Joint, estimate: &Estimate, step: &Step) -> Option<Estimate> {
    let mask = joint.problem.free.mask();
    let mut globals = [0.0; crate::solve::GLOBAL_COUNT];
    let free = globals.iter_mut().zip(mask).filter(|(_, free)| *free);
    free.zip(step.globals.iter().skip(COUNT)).for_each(|((global, _), value)| *global = *value);
    let state = moved(&estimate.state, &step.segments, &globals)?;
    Some(Estimate { state, parameters: estimate.parameters.moved(&step.globals), noise: estimate.noise })
}

fn event_parts(joint: &Joint, estimate: &Estimate) -> Vec<Part> {
    let problem = joint.problem;
    let free = free_globals(problem);
    let bearings = BearingTable::new(&estimate.state.camera, problem.sensor);
    let part = |(stretch, equations): &(Stretch, StretchEquations)| {
        let place = (stretch.segment, stretch.start(&problem.segments));
        Part::from_events(place, equations, &free, COUNT, 1.0 / joint.inflation)
    };
    // Their equations are large, and needed no longer than it takes to pick what is free.
    let of_group = |group: &[Stretch]| -> Vec<Part> {
        linearised(problem, &estimate.state, &bearings, group).par_iter().map(part).collect()
    };
    stretches(&problem.segments).chunks(STRETCHES_TOGETHER).flat_map(of_group).collect()
}

fn free_globals(problem: &Problem) -> Vec<usize> {
    let mask = problem.free.mask();
    (0..mask.len()).filter(|&global| mask[global]).collect()
}

fn with_samples(joint: &Joint, estimate: &Estimate, events: Vec<Part>) -> Linearised {
    let trajectories = &estimate.state.trajectories;
    let parts = inertial_parts(joint, estimate);
    let counts: Vec<usize> = trajectories.iter().map(Trajectory::control_point_count).collect();
    let globals = COUNT + free_globals(joint.problem).len();
    let mut system = System::new(&counts, ORDER, globals, events.iter().chain(&parts));
    let smoothness: Vec<_> = trajectories.iter().map(|one| accelerations(one, &joint.problem.settings)).collect();
    system.add_smoothness(&smoothness);
    for (index, (distance, sigma)) in priors(&estimate.parameters, joint.settings).into_iter().enumerate() {
        system.add_prior(index, distance, sigma);
    }
    Linearised { events, parts, system }
}
