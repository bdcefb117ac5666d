//! Input and unknowns of the solve of events and IMU samples.

use nalgebra::Vector3;

use super::parameters::InertialParameters;
use super::prediction::{Prediction, accelerometer, gyroscope};
use super::sample::Sample;
use super::settings::InertialSettings;
use evcal_solve::solve::{Problem, State};
use evcal_solve::trajectory::Trajectory;

/// Degree of the splines.
pub const DEGREE: usize = 5;
/// Number of control points that act at one time.
pub const ORDER: usize = DEGREE + 1;

/// The two sensors. All pairs of values for both have this order.
pub const SENSORS: [Sensor; 2] = [Sensor::Gyroscope, Sensor::Accelerometer];

/// A sensor of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// Angular velocity in rad/s.
    Gyroscope,
    /// Acceleration in m/s².
    Accelerometer,
}

impl Sensor {
    /// Returns its reading.
    pub fn reading(self, sample: &Sample) -> Vector3<f64> {
        match self {
            Self::Gyroscope => sample.angular_velocity,
            Self::Accelerometer => sample.acceleration,
        }
    }

    /// Returns the trajectory time of a sample with timestamp `t`.
    pub fn time(self, parameters: &InertialParameters, t: f64) -> f64 {
        match self {
            Self::Gyroscope => parameters.gyroscope_time(t),
            Self::Accelerometer => parameters.accelerometer_time(t),
        }
    }

    /// Predicts its reading in a sample with timestamp `t`.
    pub fn predict(self, trajectory: &Trajectory, parameters: &InertialParameters, t: f64) -> Option<Prediction> {
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
    /// `true` if it was measured; otherwise it comes from data sheets.
    pub measured: bool,
}

/// A residual of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Timestamp of the sample on the clock of the events (s from the first event).
    pub t: f64,
    /// Number of the recording.
    pub recording: usize,
    /// Reading minus prediction, in units of the sensor.
    pub value: Vector3<f64>,
}

/// Input of the solve.
pub struct Joint<'a> {
    /// The events.
    pub problem: &'a Problem,
    /// Inflation of the events: the factor by which correlated errors enlarge the variance.
    pub inflation: f64,
    /// For each recording its samples, on the clock of its events.
    pub samples: &'a [Vec<Sample>],
    /// For each segment, the indices of the samples of its recording.
    pub used: Vec<std::ops::Range<usize>>,
    /// Sampling rate in Hz.
    pub rate: f64,
    /// Knot spacing of the trajectories (s).
    pub knot_spacing: f64,
    /// Settings.
    pub settings: &'a InertialSettings,
}

impl Joint<'_> {
    /// Returns the same input with another problem of the same events.
    pub fn of_problem<'a>(&'a self, problem: &'a Problem) -> Joint<'a> {
        Joint { problem, used: self.used.clone(), ..*self }
    }
}

/// Unknowns of the solve.
#[derive(Clone)]
pub struct Estimate {
    /// Camera, event biases, trajectories.
    pub state: State,
    /// The IMU.
    pub parameters: InertialParameters,
    /// Its noise: gyroscope, accelerometer.
    pub noise: [Noise; 2],
}
