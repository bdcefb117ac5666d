//! Looks for what speaks against the calibration of an inertial unit.

use nalgebra::{Matrix3, Vector3};

use super::calibration::InertialCalibration;
use super::error::InertialError;
use super::finding::Finding;
use super::parameters::{
    ACCELEROMETER_BIAS, ACCELEROMETER_DELAY, ACCELEROMETER_MATRIX, BOARD_SCALE, CLOCK_DRIFT, GYROSCOPE_DELAY,
    GYROSCOPE_MATRIX, POSITION, ROTATION, TRIANGLE,
};
use super::sample::Sample;
use super::stream::StreamReport;

/// σ from which something was not measured: place (m), rotation (rad).
const POSITION_LIMIT: f64 = 0.01;
const ROTATION_LIMIT: f64 = std::f64::consts::PI / 180.0;
/// The same of a delay (s).
pub const DELAY_LIMIT: f64 = 1e-3;
/// Tilt below which gravity and the accelerometer's bias are hardly told apart (rad).
const LEAST_TILT: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// Drift of the clock that is told, and from how many σ.
const DRIFT: f64 = 50e-6;
const CERTAIN: f64 = 5.0;
/// How linear an accelerometer is: the board's spacing cannot be told better.
pub const LINEARITY: f64 = 0.003;
/// Shares of missing and saturated samples that are told.
const MISSING: f64 = 0.01;
const SATURATED: f64 = 0.001;
/// Scatter of blocks over the formal one from which the unit seems loose: 0.5 to 0.8 of a unit that holds, 19 of one that slips by a
/// degree, in simulated recordings.
const LOOSE: f64 = 12.0;
/// Distance of an intrinsic parameter from that of the camera alone, in σ of the difference, that is told: of intrinsics that were
/// solved for, and of others that were held.
const MOVED: f64 = 2.0;
const OTHER: f64 = 5.0;
/// Residuals over the signal above which nothing is explained.
const UNEXPLAINED: f64 = 0.3;

/// What speaks against `calibration`.
pub fn findings(calibration: &InertialCalibration) -> Vec<Finding> {
    let mut findings = Vec::new();
    let sigma = |index: usize| calibration.sigma(index);
    for (axis, sigma) in unmeasured_axes(calibration) {
        findings.push(Finding::PositionNotMeasured { axis, sigma });
    }
    let rotation = (0..3).map(|axis| sigma(ROTATION + axis)).fold(0.0, f64::max);
    if rotation > ROTATION_LIMIT {
        findings.push(Finding::RotationNotMeasured { sigma: rotation });
    }
    for (sensor, delay) in [("gyroscope", GYROSCOPE_DELAY), ("accelerometer", ACCELEROMETER_DELAY)] {
        if sigma(delay) > DELAY_LIMIT {
            findings.push(Finding::DelayNotMeasured { sensor });
        }
    }
    if !calibration.is_measured(ACCELEROMETER_MATRIX..ACCELEROMETER_MATRIX + TRIANGLE.len()) {
        findings.push(Finding::AccelerometerNotMeasured);
    } else if calibration.tilt < LEAST_TILT {
        let sigma = (0..3).map(|axis| sigma(ACCELEROMETER_BIAS + axis)).fold(0.0, f64::max);
        findings.push(Finding::HardlyTilted { tilt: calibration.tilt, sigma });
    }
    if !calibration.is_measured(GYROSCOPE_MATRIX..GYROSCOPE_MATRIX + TRIANGLE.len()) {
        findings.push(Finding::GyroscopeNotMeasured);
    }
    let drift = calibration.parameters.clock_drift;
    if drift.abs() > DRIFT.max(CERTAIN * sigma(CLOCK_DRIFT)) {
        findings.push(Finding::ClockDrift { drift, sigma: sigma(CLOCK_DRIFT) });
    }
    let largest = |share: fn(&StreamReport) -> f64| calibration.streams.iter().map(share).fold(0.0, f64::max);
    let (missing, saturated) = (largest(|stream| stream.missing), largest(|stream| stream.saturated));
    if missing > MISSING {
        findings.push(Finding::Missing { share: missing });
    }
    if saturated > SATURATED {
        findings.push(Finding::Saturated { share: saturated });
    }
    let (scale, of_scale) = (calibration.parameters.board_scale, sigma(BOARD_SCALE).hypot(LINEARITY));
    if (scale - 1.0).abs() > 3.0 * of_scale {
        findings.push(Finding::BoardSpacing { scale, sigma: of_scale });
    }
    let loose = calibration.block_scatter > LOOSE;
    if loose {
        findings.push(Finding::Loose { scatter: calibration.block_scatter });
    }
    let distance = calibration.camera_moved.unwrap_or(0.0);
    match calibration.held {
        // A loose unit pulls at the camera, too.
        None if distance > MOVED && !loose => findings.push(Finding::CameraMoved { sigmas: distance }),
        Some(_) if distance > OTHER => findings.push(Finding::OtherCamera { sigmas: distance }),
        _ => {}
    }
    findings
}

/// Axes of the camera along which the unit's place was not measured, with σ.
pub fn unmeasured_axes(calibration: &InertialCalibration) -> Vec<(usize, f64)> {
    let block: Matrix3<f64> = calibration.covariance.fixed_view::<3, 3>(POSITION, POSITION).into_owned();
    let eigen = block.symmetric_eigen();
    let mut axes: Vec<(usize, f64)> = Vec::new();
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        let sigma = value.max(0.0).sqrt();
        if sigma > POSITION_LIMIT {
            axes.push((vector.iamax(), sigma));
        }
    }
    axes.sort_by_key(|(axis, _)| *axis);
    axes
}

/// Whether the residuals are small against the signal.
///
/// # Errors
/// [`InertialError::NotExplained`].
pub fn explained(calibration: &InertialCalibration, samples: &[Vec<Sample>]) -> Result<(), InertialError> {
    let signal = |value: fn(&Sample) -> Vector3<f64>| {
        let values: Vec<Vector3<f64>> = samples.iter().flatten().map(value).collect();
        let count = values.len().max(1) as f64;
        let mean = values.iter().sum::<Vector3<f64>>() / count;
        (values.iter().map(|value| (value - mean).norm_squared()).sum::<f64>() / (3.0 * count)).sqrt()
    };
    let [gyroscope, accelerometer] = calibration.residual_rms();
    let turns = signal(|sample| sample.angular_velocity);
    let forces = signal(|sample| sample.acceleration);
    if gyroscope > UNEXPLAINED * turns || accelerometer > UNEXPLAINED * forces {
        return Err(InertialError::NotExplained { gyroscope: gyroscope.to_degrees(), accelerometer });
    }
    Ok(())
}
