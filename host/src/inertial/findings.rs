//! What speaks against the calibration of an inertial unit, in words with what to do.

use std::fmt;

use nalgebra::{Matrix3, Vector3};

use super::parameters::{
    ACCELEROMETER_DELAY, ACCELEROMETER_MATRIX, BOARD_SCALE, CLOCK_DRIFT, GYROSCOPE_DELAY, GYROSCOPE_MATRIX, POSITION,
    ROTATION,
};
use super::stream::Sample;
use super::{InertialCalibration, InertialError};

/// σ from which something was not measured: place (m), rotation (rad), delays (s).
const POSITION_LIMIT: f64 = 0.01;
const ROTATION_LIMIT: f64 = std::f64::consts::PI / 180.0;
const DELAY_LIMIT: f64 = 1e-3;
/// σ over that before any measurement, from which scale or misalignment was not measured.
const PRIOR_SHARE: f64 = 0.5;
/// Drift of the clock that is told, and from how many σ.
const DRIFT: f64 = 50e-6;
const CERTAIN: f64 = 5.0;
/// How linear an accelerometer is: the board's spacing cannot be told better.
pub const LINEARITY: f64 = 0.003;
/// Shares of missing and saturated samples that are told.
const MISSING: f64 = 0.01;
const SATURATED: f64 = 0.001;
/// Scatter of blocks over the formal one from which the unit seems loose.
const LOOSE: f64 = 25.0;
/// Residuals over the signal above which nothing is explained.
const UNEXPLAINED: f64 = 0.3;

/// What speaks against a result, or was not measured.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// The place of the unit along a direction of the camera was not measured.
    PositionNotMeasured {
        /// Axis of the camera that is nearest.
        axis: usize,
        /// σ along it (m).
        sigma: f64,
    },
    /// The rotation was not measured.
    RotationNotMeasured {
        /// Largest σ (rad).
        sigma: f64,
    },
    /// A delay was not measured.
    DelayNotMeasured,
    /// Scale and misalignment of the accelerometer are mixed with its bias and gravity.
    AccelerometerNotMeasured,
    /// Scale and misalignment of the gyroscope.
    GyroscopeNotMeasured,
    /// The clocks run at different rates.
    ClockDrift {
        /// Of the unit's clock against that of the events.
        drift: f64,
        /// Its σ.
        sigma: f64,
    },
    /// Samples are missing.
    Missing {
        /// Their share.
        share: f64,
    },
    /// Samples are at the end of their scale.
    Saturated {
        /// Their share.
        share: f64,
    },
    /// The board's spacing is another one than stated.
    BoardSpacing {
        /// True over stated.
        scale: f64,
        /// Its σ with the accelerometer's linearity.
        sigma: f64,
    },
    /// Blocks of time disagree.
    Loose {
        /// Scatter of blocks over the formal one.
        scatter: f64,
    },
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PositionNotMeasured { axis, .. } => {
                let (name, others) = [("x", "y or z"), ("y", "x or z"), ("z", "x or y")][(*axis).min(2)];
                write!(f, "the lever arm along the camera's {name} was not measured: turn quickly about {others} too")
            }
            Self::RotationNotMeasured { .. } => {
                write!(f, "the rotation of the unit was not measured: turn the camera about two of its axes")
            }
            Self::DelayNotMeasured => {
                write!(f, "a delay was not measured: turn back and forth, not at a constant rate")
            }
            Self::AccelerometerNotMeasured => write!(
                f,
                "scale and misalignment of the accelerometer were not measured, and blur its bias and gravity: tilt the camera by more than 30 degrees to all sides"
            ),
            Self::GyroscopeNotMeasured => write!(
                f,
                "scale and misalignment of the gyroscope were not measured: turn about all three axes of the camera"
            ),
            Self::ClockDrift { drift, sigma } => write!(
                f,
                "the unit's clock drifts by {:.0} ± {:.0} ppm against that of the events; delays are those in the middle of the recording: put both on one clock",
                1e6 * drift,
                1e6 * sigma
            ),
            Self::Missing { share } => {
                write!(
                    f,
                    "{:.1} % of the inertial samples are missing: look for a slow disk or a full buffer",
                    100.0 * share
                )
            }
            Self::Saturated { share } => write!(
                f,
                "{:.1} % of the inertial samples are at the end of their scale and left out: set a larger range",
                100.0 * share
            ),
            Self::BoardSpacing { scale, sigma } => write!(
                f,
                "the board seems to be {scale:.4} ± {sigma:.4} of its stated size: measure its spacing with a ruler"
            ),
            Self::Loose { .. } => write!(
                f,
                "parts of the recording disagree on where the unit is: fix it to the camera, or look for vibration"
            ),
        }
    }
}

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
    if sigma(GYROSCOPE_DELAY).max(sigma(ACCELEROMETER_DELAY)) > DELAY_LIMIT {
        findings.push(Finding::DelayNotMeasured);
    }
    let share = |first: usize| {
        (first..first + 6).map(|index| sigma(index) / calibration.prior_sigma[index]).fold(0.0, f64::max)
    };
    if share(ACCELEROMETER_MATRIX) > PRIOR_SHARE {
        findings.push(Finding::AccelerometerNotMeasured);
    }
    if share(GYROSCOPE_MATRIX) > PRIOR_SHARE {
        findings.push(Finding::GyroscopeNotMeasured);
    }
    let drift = calibration.parameters.clock_drift;
    if drift.abs() > DRIFT.max(CERTAIN * sigma(CLOCK_DRIFT)) {
        findings.push(Finding::ClockDrift { drift, sigma: sigma(CLOCK_DRIFT) });
    }
    let largest = |share: fn(&super::StreamReport) -> f64| calibration.streams.iter().map(share).fold(0.0, f64::max);
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
    if calibration.block_scatter > LOOSE {
        findings.push(Finding::Loose { scatter: calibration.block_scatter });
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
