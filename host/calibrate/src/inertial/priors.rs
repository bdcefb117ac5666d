//! Priors of an IMU's parameters.

use super::parameters::{self as at, COUNT, InertialParameters};
use super::settings::InertialSettings;

/// Returns, for each parameter, its distance from the expected value, and the σ of that expectation.
pub fn priors(parameters: &InertialParameters, settings: &InertialSettings) -> [(f64, f64); COUNT] {
    // Far above any uncertainty from motion, except for typical tolerances of such chips.
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
