//! What events and inertial samples are solved from, and what for.

use nalgebra::Vector3;

use super::parameters::InertialParameters;
use super::prediction::{Prediction, accelerometer, gyroscope};
use super::sample::Sample;
use super::settings::InertialSettings;
use crate::solve::{Problem, State};
use crate::trajectory::Trajectory;

/// Degree of the splines.
pub const DEGREE: usize = 5;
/// Control points that act at one time.
pub const ORDER: usize = DEGREE + 1;

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
    /// What it read.
    pub fn reading(self, sample: &Sample) -> Vector3<f64> {
        match self {
            Self::Gyroscope => sample.angular_velocity,
            Self::Accelerometer => sample.acceleration,
        }
    }

    /// Time of the trajectory at which a sample stamped `t` was true.
    pub fn time(self, parameters: &InertialParameters, t: f64) -> f64 {
        match self {
            Self::Gyroscope => parameters.gyroscope_time(t),
            Self::Accelerometer => parameters.accelerometer_time(t),
        }
    }

    /// What it should read in a sample stamped `t`.
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

impl Joint<'_> {
    /// The same with another problem of the same events.
    pub fn of_problem<'a>(&'a self, problem: &'a Problem) -> Joint<'a> {
        Joint { problem, used: self.used.clone(), ..*self }
    }
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
