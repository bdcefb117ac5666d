//! Checks of the calibration of an IMU.

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
use super::timing::Timing;

/// σ from which a position counts as not measured (m).
const POSITION_LIMIT: f64 = 0.01;
/// σ from which a rotation counts as not measured (rad).
const ROTATION_LIMIT: f64 = std::f64::consts::PI / 180.0;
/// σ from which a delay counts as not measured (s).
pub const DELAY_LIMIT: f64 = 1e-3;
/// Tilt below which gravity and the accelerometer's bias can hardly be separated (rad).
const LEAST_TILT: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// Smallest drift of the clock that is reported.
const DRIFT: f64 = 50e-6;
/// Smallest drift that is reported, in σ.
const CERTAIN: f64 = 5.0;
/// Relative nonlinearity of an accelerometer, which limits the accuracy of the board's spacing.
pub const LINEARITY: f64 = 0.003;
/// Smallest share of missing samples that is reported.
const MISSING: f64 = 0.01;
/// Smallest share of saturated samples that is reported.
const SATURATED: f64 = 0.001;
/// Ratio of the scatter of blocks to the formal one from which the IMU seems loose. In simulated recordings it is 0.5 to 0.8 for
/// a fixed IMU, and 19 for one that slips by a degree.
const LOOSE: f64 = 12.0;
/// Smallest difference between an intrinsic parameter and its value in the calibration of the camera alone that is
/// reported, in σ of the difference; for estimated intrinsics.
const MOVED: f64 = 2.0;
/// The same for fixed intrinsics.
const OTHER: f64 = 5.0;
/// Ratio of the residuals to the signal above which the model does not fit.
const UNEXPLAINED: f64 = 0.3;

/// Returns the problems of `calibration`.
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
    let timing = calibration.streams.iter().map(|stream| stream.timing.uncertainty()).fold(0.0, f64::max);
    for (sensor, delay) in [("gyroscope", GYROSCOPE_DELAY), ("accelerometer", ACCELEROMETER_DELAY)] {
        // Timestamps that do not belong to the samples have a finding of their own.
        if sigma(delay).powi(2) - timing.powi(2) > DELAY_LIMIT.powi(2) {
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
    findings.extend(calibration.streams.iter().filter_map(|stream| about_timing(stream, calibration)));
    let largest = |share: fn(&StreamReport) -> f64| calibration.streams.iter().map(share).fold(0.0, f64::max);
    let (missing, saturated) = (largest(|stream| stream.missing), largest(|stream| stream.saturated));
    if missing > MISSING {
        findings.push(Finding::Missing { share: missing });
    }
    let left_out = largest(|stream| stream.out_of_order as f64 / (stream.out_of_order + stream.samples).max(1) as f64);
    if left_out > MISSING {
        findings.push(Finding::LeftOut { share: left_out });
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
    match calibration.fixed {
        // A loose IMU affects the camera, too.
        None if distance > MOVED && !loose => findings.push(Finding::CameraMoved { sigmas: distance }),
        Some(_) if distance > OTHER => findings.push(Finding::OtherCamera { sigmas: distance }),
        _ => {}
    }
    findings
}

/// Returns the finding on timestamps that do not belong to the samples.
fn about_timing(stream: &StreamReport, calibration: &InertialCalibration) -> Option<Finding> {
    match stream.timing {
        Timing::Own => None,
        Timing::Groups { samples, interval } => {
            Some(Finding::Groups { samples, interval, delay: calibration.parameters.gyroscope_delay })
        }
        Timing::Even { scatter } => Some(Finding::Scattered { scatter }),
        Timing::Sorted { scatter } => Some(Finding::Irregular { scatter }),
    }
}

/// Returns the axes of the camera along which the IMU's position was not measured, with σ.
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

/// Checks that the residuals are small compared with the signal.
///
/// # Errors
/// [`InertialError::NotExplained`] if they are not.
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
