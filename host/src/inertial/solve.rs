//! Events and inertial samples in one solve.
//!
//! The trajectories get splines of degree 5 with even knots, whose acceleration is smooth enough for inertial sensors. The
//! events keep their own equations, divided by their inflation, for errors of theirs that they share make them believe too
//! much; camera and event biases stay free. The noise of the sensors is taken from the spectrum of the residuals in rounds.

use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;

use super::equations::{Part, Step, System};
use super::error::InertialError;
use super::noise::{Line, density, spectrum};
use super::parameters::{self as at, COUNT, InertialParameters, Prediction, accelerometer, gyroscope};
use super::sample::Sample;
use super::settings::InertialSettings;
use crate::numerics::huber::huber;
use crate::solve::bearing_table::BearingTable;
use crate::solve::levenberg::{linearised, moved};
use crate::solve::normal::StretchEquations;
use crate::solve::smoothness::accelerations;
use crate::solve::stretch::{Stretch, stretches};
use crate::solve::{Problem, State};
use crate::trajectory::fit::fit_on_knots;
use crate::trajectory::timed_pose::TimedPose;
use crate::trajectory::{CONTROL_POINT_PARAMETERS as POINT, RotationSpline, Trajectory};
use evcal_core::spline::Knots;

/// Degree of the splines.
pub const DEGREE: usize = 5;
/// Control points that act at one time.
const ORDER: usize = DEGREE + 1;
/// Residual from which a sample counts linearly, in σ.
const HUBER: f64 = 3.0;
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
const FIRST_ACCELEROMETER: f64 = 600e-6 * super::sample::STANDARD_GRAVITY;

/// The two sensors, in the order of pairs of them.
pub const SENSORS: [Sensor; 2] = [Sensor::Gyroscope, Sensor::Accelerometer];

/// A sensor of the unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// Angular velocity in rad/s.
    Gyroscope,
    /// Acceleration in m/s².
    Accelerometer,
}

impl Sensor {
    fn reading(self, sample: &Sample) -> Vector3<f64> {
        match self {
            Self::Gyroscope => sample.angular_velocity,
            Self::Accelerometer => sample.acceleration,
        }
    }

    fn time(self, parameters: &InertialParameters, t: f64) -> f64 {
        match self {
            Self::Gyroscope => parameters.gyroscope_time(t),
            Self::Accelerometer => parameters.accelerometer_time(t),
        }
    }

    fn predict(self, trajectory: &Trajectory, parameters: &InertialParameters, t: f64) -> Option<Prediction> {
        match self {
            Self::Gyroscope => gyroscope(trajectory, parameters, t),
            Self::Accelerometer => accelerometer(trajectory, parameters, t),
        }
    }
}

/// Noise of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Density of each axis, in units of the sensor over √Hz.
    pub density: [f64; 3],
    /// Whether it was measured; else it is that of data sheets.
    pub measured: bool,
}

/// A residual of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Stamp of the sample on the clock of the events (s from the first event).
    pub t: f64,
    /// Number of the recording.
    pub recording: usize,
    /// Reading less prediction, in units of the sensor.
    pub value: Vector3<f64>,
}

/// What the solve works on.
pub struct Joint<'a> {
    /// The events.
    pub problem: &'a Problem,
    /// How much too sure they are of themselves.
    pub inflation: f64,
    /// For each recording its samples, on the clock of its events.
    pub samples: &'a [Vec<Sample>],
    /// For each segment, which samples of its recording.
    pub used: Vec<std::ops::Range<usize>>,
    /// Sampling rate in Hz.
    pub rate: f64,
    /// Distance of the trajectories' knots (s).
    pub knot_spacing: f64,
    /// Thresholds.
    pub settings: &'a InertialSettings,
}

/// What is solved for.
#[derive(Clone)]
pub struct Estimate {
    /// Camera, event biases, trajectories.
    pub state: State,
    /// The inertial unit.
    pub parameters: InertialParameters,
    /// Its noise: gyroscope, accelerometer.
    pub noise: [Noise; 2],
}

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

/// For each parameter how far it is from what is expected before any measurement, and the σ of that expectation.
pub fn priors(parameters: &InertialParameters, settings: &InertialSettings) -> [(f64, f64); COUNT] {
    // Far above what any motion leaves open, but for what parts of such chips really have.
    let mut priors = [(0.0, 10.0); COUNT];
    for axis in 0..3 {
        priors[at::POSITION + axis] = (parameters.position[axis], 1.0);
        priors[at::GYROSCOPE_BIAS + axis] = (parameters.gyroscope_bias[axis], 0.5);
        priors[at::ACCELEROMETER_BIAS + axis] = (parameters.accelerometer_bias[axis], 2.0);
        priors[at::GYROSCOPE_TURN + axis] = (parameters.gyroscope_from_imu.scaled_axis()[axis], settings.misalignment);
    }
    let matrices = [
        (at::ACCELEROMETER_MATRIX, &parameters.accelerometer_matrix),
        (at::GYROSCOPE_MATRIX, &parameters.gyroscope_matrix),
    ];
    for (first, matrix) in matrices {
        for (index, (row, column)) in at::TRIANGLE.into_iter().enumerate() {
            let (expected, sigma) = if row == column { (1.0, settings.scale) } else { (0.0, settings.misalignment) };
            priors[first + index] = (matrix[(row, column)] - expected, sigma);
        }
    }
    priors[at::BOARD_SCALE] = (parameters.board_scale - 1.0, 0.05);
    priors[at::CLOCK_DRIFT] = (parameters.clock_drift, 1e-3);
    // A filter of two poles at 184 Hz has 0.7e-6 s², one at 44 Hz 13e-6 s².
    priors[at::GYROSCOPE_FILTER] = (parameters.gyroscope_filter, 5e-6);
    priors[at::ACCELEROMETER_FILTER] = (parameters.accelerometer_filter, 5e-6);
    priors
}

/// Samples of one sensor in one knot span of a segment.
struct Task {
    segment: usize,
    sensor: usize,
    samples: std::ops::Range<usize>,
}

fn tasks(joint: &Joint, estimate: &Estimate) -> Vec<Task> {
    let mut tasks = Vec::new();
    for (segment, (trajectory, used)) in estimate.state.trajectories.iter().zip(&joint.used).enumerate() {
        let Some(samples) = joint.samples.get(trajectory.recording) else { continue };
        let knots = Knots::assume_valid(&trajectory.knots, trajectory.degree);
        for (index, sensor) in SENSORS.iter().enumerate() {
            let mut run: Option<(usize, Task)> = None;
            for place in used.clone() {
                let Some(sample) = samples.get(place) else { continue };
                let Ok(span) = knots.find_span(sensor.time(&estimate.parameters, sample.t)) else { continue };
                match &mut run {
                    Some((in_span, task)) if *in_span == span => task.samples.end = place + 1,
                    _ => {
                        let next = Task { segment, sensor: index, samples: place..place + 1 };
                        tasks.extend(run.replace((span, next)).map(|(_, task)| task));
                    }
                }
            }
            tasks.extend(run.map(|(_, task)| task));
        }
    }
    tasks
}

fn inertial_parts(joint: &Joint, estimate: &Estimate) -> Vec<Part> {
    tasks(joint, estimate).par_iter().filter_map(|task| inertial_part(joint, estimate, task)).collect()
}

fn inertial_part(joint: &Joint, estimate: &Estimate, task: &Task) -> Option<Part> {
    let trajectory = estimate.state.trajectories.get(task.segment)?;
    let samples = joint.samples.get(trajectory.recording)?.get(task.samples.clone())?;
    let (sensor, noise) = (SENSORS[task.sensor], &estimate.noise[task.sensor]);
    let columns = POINT * ORDER + COUNT + 1;
    let mut rows = DMatrix::zeros(columns, 3 * samples.len());
    let (mut cost, mut first) = (0.0, None);
    for (index, sample) in samples.iter().enumerate() {
        let Some(prediction) = sensor.predict(trajectory, &estimate.parameters, sample.t) else { continue };
        if *first.get_or_insert(prediction.first) != prediction.first {
            continue;
        }
        let error = prediction.value - sensor.reading(sample);
        for axis in 0..3 {
            let inverse = 1.0 / (noise.density[axis] * joint.rate.sqrt());
            let (part, root) = huber(error[axis] * inverse, HUBER);
            cost += part;
            fill_row(rows.column_mut(3 * index + axis).as_mut_slice(), &prediction, axis, error[axis], root * inverse);
        }
    }
    let product = &rows * rows.transpose();
    Some(Part::from_product((task.segment, samples.first()?.t), (first?, ORDER), COUNT, &product, cost))
}

fn fill_row(row: &mut [f64], prediction: &Prediction, axis: usize, error: f64, weight: f64) {
    let mut places = row.iter_mut();
    for (by_rotation, by_translation) in prediction.by_rotation.iter().zip(&prediction.by_translation) {
        let values = by_rotation.row(axis).iter().chain(by_translation.row(axis).iter()).copied().collect::<Vec<f64>>();
        places.by_ref().zip(values).for_each(|(place, value)| *place = weight * value);
    }
    let by_parameters = prediction.by_parameters.iter().map(|column| column[axis]);
    places.zip(by_parameters.chain([error])).for_each(|(place, value)| *place = weight * value);
}

/// Readings less predictions.
pub fn residuals(joint: &Joint, estimate: &Estimate, sensor: Sensor) -> Vec<Residual> {
    let segments = estimate.state.trajectories.par_iter().zip(&joint.used);
    let of_segment = |(trajectory, used): (&Trajectory, &std::ops::Range<usize>)| -> Vec<Residual> {
        let samples = joint.samples.get(trajectory.recording).and_then(|samples| samples.get(used.clone()));
        let residual = |sample: &Sample| {
            let prediction = sensor.predict(trajectory, &estimate.parameters, sample.t)?;
            let value = sensor.reading(sample) - prediction.value;
            Some(Residual { t: sample.t, recording: trajectory.recording, value })
        };
        samples.unwrap_or_default().iter().filter_map(residual).collect()
    };
    segments.map(of_segment).collect::<Vec<_>>().concat()
}
