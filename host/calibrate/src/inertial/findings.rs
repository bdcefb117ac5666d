//! Checks of the calibration of an IMU.

use nalgebra::{Matrix3, Vector3};

use super::calibration::InertialCalibration;
use super::error::InertialError;
use super::parameters::{
    ACCELEROMETER_BIAS, ACCELEROMETER_DELAY, ACCELEROMETER_MATRIX, BOARD_SCALE, CLOCK_DRIFT, GYROSCOPE_DELAY,
    GYROSCOPE_MATRIX, POSITION, ROTATION, TRIANGLE,
};
use super::sample::Sample;
use super::stream::StreamReport;
use super::timing::Timing;
use crate::advice::Advice;
use crate::quality::verdict::{Cause, Finding, Severity, without_consequences};
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

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
/// Largest drift of a clock: a larger one with parts that disagree stands for a jump.
const LARGEST_DRIFT: f64 = 1e-3;
/// Smallest drift that is reported, in σ.
const CERTAIN: f64 = 5.0;
/// Relative nonlinearity of an accelerometer, which limits the accuracy of the board's spacing.
pub const LINEARITY: f64 = 0.003;
/// Number of samples in a row up to which missing ones were left out by the driver, for example by one that sends some of the
/// accelerations in place of angular velocities.
const FEW_IN_A_ROW: f64 = 3.0;
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
/// Advice on timestamps.
const STAMP_EACH: &str = "stamp each sample with the time at which it was taken";
const STAMP_WHEN_TAKEN: &str = "stamp samples when they are taken, not when they arrive";
/// Ratio of the residuals to the signal above which the model does not fit.
const UNEXPLAINED: f64 = 0.3;

/// Returns the problems of `calibration`, and quantities that were not measured.
pub fn findings(calibration: &InertialCalibration) -> Vec<Finding> {
    let mut findings: Vec<Finding> =
        unmeasured_axes(calibration).into_iter().map(|(axis, _)| position_not_measured(axis)).collect();
    let sigma = |index: usize| calibration.sigma(index);
    if (0..3).map(|axis| sigma(ROTATION + axis)).fold(0.0, f64::max) > ROTATION_LIMIT {
        findings.push(Finding::new(
            Cause::RotationNotMeasured,
            Severity::Failure,
            "the rotation of the IMU was not measured".to_owned(),
            "rotate the camera about two of its axes",
        ));
    }
    let timing = calibration.streams.iter().map(|stream| stream.timing.uncertainty()).fold(0.0, f64::max);
    for (sensor, delay) in [("gyroscope", GYROSCOPE_DELAY), ("accelerometer", ACCELEROMETER_DELAY)] {
        // Timestamps that do not belong to the samples have a finding of their own.
        if sigma(delay).powi(2) - timing.powi(2) > DELAY_LIMIT.powi(2) {
            findings.push(Finding::new(
                Cause::DelayNotMeasured,
                Severity::Failure,
                format!("the delay of the {sensor} was not measured"),
                "rotate the camera back and forth, not at a constant rate",
            ));
        }
    }
    findings.extend(about_accelerometer(calibration));
    if !calibration.is_measured(GYROSCOPE_MATRIX..GYROSCOPE_MATRIX + TRIANGLE.len()) {
        findings.push(Finding::new(
            Cause::GyroscopeNotMeasured,
            Severity::Warning,
            "scale and misalignment of the gyroscope were not measured".to_owned(),
            "rotate about all three axes of the camera",
        ));
    }
    let drift = calibration.parameters.clock_drift;
    if drift.abs() > DRIFT.max(CERTAIN * sigma(CLOCK_DRIFT)) {
        findings.push(Finding::new(
            Cause::ClockRate,
            Severity::Note,
            format!(
                "the IMU's clock drifts by {:.0} ± {:.0} ppm against the events' clock, and delays apply to the middle of the recording",
                1e6 * drift,
                1e6 * sigma(CLOCK_DRIFT)
            ),
            "put both on one clock",
        ));
    }
    findings.extend(calibration.streams.iter().filter_map(|stream| about_timing(stream, calibration)));
    findings.extend(about_losses(&calibration.streams));
    let (scale, of_scale) = (calibration.parameters.board_scale, sigma(BOARD_SCALE).hypot(LINEARITY));
    if (scale - 1.0).abs() > 3.0 * of_scale {
        findings.push(Finding::new(
            Cause::BoardSpacing,
            Severity::Warning,
            format!("the board seems to be {scale:.4} ± {of_scale:.4} of its stated size"),
            "measure its spacing with a ruler",
        ));
    }
    if calibration.block_scatter > LOOSE {
        findings.push(if drift.abs() > LARGEST_DRIFT {
            Finding::new(
                Cause::ScatteredTimes,
                Severity::Failure,
                "no constant offset relates the times of the IMU to those of the events: they jump, or parts are missing"
                    .to_owned(),
                STAMP_WHEN_TAKEN,
            )
        } else {
            Finding::new(
                Cause::Loose,
                Severity::Failure,
                "parts of the recording disagree on the position of the IMU".to_owned(),
                "fix it to the camera, or check for vibration",
            )
        });
    }
    findings.extend(about_camera(calibration));
    without_consequences(&mut findings);
    findings
}

fn position_not_measured(axis: usize) -> Finding {
    let (name, others) = [("x", "y or z"), ("y", "x or z"), ("z", "x or y")][axis.min(2)];
    Finding::new(
        Cause::PositionNotMeasured,
        Severity::Failure,
        format!("the lever arm along the camera's {name} was not measured"),
        Advice::Plain(format!("rotate quickly about {others} too")),
    )
}

fn about_accelerometer(calibration: &InertialCalibration) -> Option<Finding> {
    const ADVICE: &str = "tilt the camera by more than 30 degrees to all sides";
    if !calibration.is_measured(ACCELEROMETER_MATRIX..ACCELEROMETER_MATRIX + TRIANGLE.len()) {
        let reason =
            "scale and misalignment of the accelerometer were not measured and make its bias and gravity less certain";
        return Some(Finding::new(Cause::AccelerometerNotMeasured, Severity::Warning, reason.to_owned(), ADVICE));
    }
    (calibration.tilt < LEAST_TILT).then(|| {
        let sigma = (0..3).map(|axis| calibration.sigma(ACCELEROMETER_BIAS + axis)).fold(0.0, f64::max);
        let reason = format!(
            "the camera was tilted by {:.0}° at most, so the accelerometer's bias and the direction of gravity are known to only {:.1} mg",
            calibration.tilt.to_degrees(),
            1e3 * sigma / STANDARD_GRAVITY
        );
        Finding::new(Cause::HardlyTilted, Severity::Warning, reason, ADVICE)
    })
}

/// Returns the findings on samples that are missing, without a time of their own, or saturated.
fn about_losses(streams: &[StreamReport]) -> Vec<Finding> {
    let largest = |share: fn(&StreamReport) -> f64| streams.iter().map(share).fold(0.0, f64::max);
    let missing = largest(|stream| stream.missing);
    let left_out = largest(|stream| stream.out_of_order as f64 / (stream.out_of_order + stream.samples).max(1) as f64);
    let saturated = largest(|stream| stream.saturated);
    let mut findings = Vec::new();
    if missing > MISSING {
        let in_a_row = |stream: &StreamReport| (stream.longest_gap * stream.rate).round() - 1.0;
        let in_a_row = streams.iter().filter(|stream| stream.missing > MISSING).map(in_a_row).fold(0.0, f64::max);
        let share = format!("{:.1} % of the IMU samples are missing", 100.0 * missing);
        let (reason, advice) = if in_a_row <= FEW_IN_A_ROW {
            let reason = format!("{share}, at most {in_a_row:.0} in a row");
            (reason, "check the rates that the driver is set to: a slow disk or a full buffer leaves longer gaps")
        } else {
            (share, "check for a slow disk or a full buffer")
        };
        findings.push(Finding::new(Cause::MissingSamples, Severity::Note, reason, advice));
    }
    if left_out > MISSING {
        findings.push(Finding::new(
            Cause::LeftOutSamples,
            Severity::Warning,
            format!(
                "{:.1} % of the IMU samples are not later than the samples before them and were left out",
                100.0 * left_out
            ),
            STAMP_EACH,
        ));
    }
    if saturated > SATURATED {
        findings.push(Finding::new(
            Cause::SaturatedSamples,
            Severity::Note,
            format!("{:.1} % of the IMU samples are saturated and were excluded", 100.0 * saturated),
            "set a larger range",
        ));
    }
    findings
}

/// Returns the finding on the difference between the camera and its separate calibration.
fn about_camera(calibration: &InertialCalibration) -> Option<Finding> {
    let sigmas = calibration.camera_moved.unwrap_or(0.0);
    match calibration.fixed {
        None => (sigmas > MOVED).then(|| {
            Finding::new(
                Cause::CameraMoved,
                Severity::Warning,
                format!("the solve with the IMU changed an intrinsic parameter by {sigmas:.1} σ"),
                "fix the intrinsics at the values of a slower recording",
            )
        }),
        Some(_) => (sigmas > OTHER).then(|| {
            Finding::new(
                Cause::OtherCamera,
                Severity::Warning,
                format!("the fixed intrinsics differ by {sigmas:.1} σ from the values of this recording"),
                "use a calibration of the same lens with the same focus",
            )
        }),
    }
}

/// Returns the finding on samples that could not be read; `what` describes the loss and its cause.
pub fn damaged(what: &str) -> Finding {
    Finding::new(
        Cause::DamagedSamples,
        Severity::Note,
        format!("the recording is damaged, and IMU samples were lost: {what}"),
        "record again if they matter",
    )
}

/// Returns the finding on timestamps that do not belong to the samples.
fn about_timing(stream: &StreamReport, calibration: &InertialCalibration) -> Option<Finding> {
    let (cause, severity, reason, advice) = match stream.timing {
        Timing::Own => return None,
        Timing::Groups { samples, interval } => {
            let delay = calibration.parameters.gyroscope_delay;
            let reason = format!(
                "{samples} IMU samples, as a rule, share one timestamp; they were spread evenly over the {:.2} ms up to it. The recording does not contain the sample to which a timestamp belongs, so no delay is certain: if it is the last one, timestamps of the gyroscope are {:.3} ms {} than events",
                1e3 * interval,
                1e3 * delay.abs(),
                if delay < 0.0 { "earlier" } else { "later" }
            );
            (Cause::SharedTimestamps, Severity::Warning, reason, STAMP_EACH)
        }
        Timing::Even { scatter } => {
            let reason = format!(
                "the timestamps of the IMU scatter by {:.2} ms (rms), more than the samples are apart: samples were placed evenly in the order in which they arrived, and the delays refer to the mean timestamp",
                1e3 * scatter
            );
            (Cause::ScatteredTimestamps, Severity::Warning, reason, STAMP_WHEN_TAKEN)
        }
        Timing::Sorted { scatter } => {
            let reason = format!(
                "the timestamps of the IMU scatter by {:.2} ms (rms), more than the samples are apart, and the samples do not arrive at a constant rate, so their times are not known",
                1e3 * scatter
            );
            (Cause::IrregularTimestamps, Severity::Failure, reason, STAMP_WHEN_TAKEN)
        }
    };
    Some(Finding::new(cause, severity, reason, advice))
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A driver that sent every fourth sample as an acceleration alone was told of a slow disk.
    #[test]
    fn single_missing_samples_are_not_the_fault_of_a_disk() {
        let advice = |longest_gap: f64| {
            let (samples, timing) = (3000, Timing::Own);
            let stream = StreamReport {
                samples,
                rate: 1000.0,
                missing: 0.25,
                longest_gap,
                out_of_order: 0,
                timing,
                saturated: 0.0,
            };
            about_losses(&[stream]).first().map(ToString::to_string).unwrap()
        };
        let single = advice(0.002);
        assert!(single.contains("at most 1 in a row") && single.contains("check the rates"), "{single}");
        assert!(advice(0.3).contains("check for a slow disk"));
    }
}
