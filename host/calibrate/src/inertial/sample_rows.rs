//! Equations of the IMU samples, and their residuals.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::joint::{Estimate, Joint, ORDER, Residual, SENSORS, Sensor};
use super::parameters::COUNT;
use super::prediction::Prediction;
use super::sample::Sample;
use evcal_core::spline::Knots;
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;
use evcal_geometry::numerics::huber::huber;
use evcal_solve::solve::equations::band::Band;
use evcal_solve::solve::equations::normal::Equations;
use evcal_solve::solve::rows::loss::Loss;
use evcal_solve::trajectory::{CONTROL_POINT_PARAMETERS as POINT, Trajectory};

/// Residual from which a sample counts linearly, in σ.
const HUBER: f64 = 3.0;

/// Least noise density that the weights of a sample assume, of the gyroscope (rad/s/√Hz) and the accelerometer (m/s²/√Hz): that of
/// the quietest chips. With the smaller noise of a file without noise, only the error of the trajectory is left, which the weights
/// do not know.
const QUIETEST: [f64; 2] = [0.0014 * std::f64::consts::PI / 180.0, 7e-6 * STANDARD_GRAVITY];

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

/// Builds the equations of all samples.
pub fn sample_pieces(joint: &Joint, estimate: &Estimate) -> Vec<Equations> {
    tasks(joint, estimate).par_iter().filter_map(|task| sample_piece(joint, estimate, task)).collect()
}

fn sample_piece(joint: &Joint, estimate: &Estimate, task: &Task) -> Option<Equations> {
    let trajectory = estimate.state.trajectories.get(task.segment)?;
    let samples = joint.samples.get(trajectory.recording)?.get(task.samples.clone())?;
    let (sensor, noise) = (SENSORS[task.sensor], &estimate.noise[task.sensor]);
    let quietest = QUIETEST[task.sensor];
    let columns = POINT * ORDER + COUNT + 1;
    let mut rows = DMatrix::zeros(columns, 3 * samples.len());
    let (mut loss, mut first) = (Loss::default(), None);
    for (index, sample) in samples.iter().enumerate() {
        let Some(prediction) = sensor.predict(trajectory, &estimate.parameters, sample.t) else { continue };
        if *first.get_or_insert(prediction.first) != prediction.first {
            continue;
        }
        let error = prediction.value - sensor.reading(sample);
        let mut cost = 0.0;
        for axis in 0..3 {
            let inverse = 1.0 / (noise.density[axis].max(quietest) * joint.rate.sqrt());
            let (part, root) = huber(error[axis] * inverse, HUBER);
            cost += part;
            fill_row(rows.column_mut(3 * index + axis).as_mut_slice(), &prediction, axis, error[axis], root * inverse);
        }
        loss.add_cost(cost);
    }
    let product = &rows * rows.transpose();
    let empty = Equations::new(task.segment, samples.first()?.t, 0..COUNT, Band::new(0, 0, ORDER, 0));
    Some(Equations { loss, ..empty.of_gram(first?, ORDER, &product) })
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

/// Returns readings minus predictions.
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
