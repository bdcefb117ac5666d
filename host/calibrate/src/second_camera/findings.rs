//! Checks of the calibration of a second camera.

use super::calibration::SecondCalibration;
use super::mount::{LINE_DELAY, OFFSET, RATE, ROTATION, TRANSLATION};
use crate::quality::verdict::{Cause, Finding, Severity, without_consequences};

/// σ from which a position counts as not measured (m).
const PLACE_LIMIT: f64 = 5e-3;
/// σ from which a rotation counts as not measured (rad).
const ROTATION_LIMIT: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// σ from which an offset counts as not measured (s).
const OFFSET_LIMIT: f64 = 1e-3;
/// Smallest difference of the clocks' rates that is reported.
const DRIFT: f64 = 50e-6;
/// Smallest difference of the clocks' rates that is reported, in σ.
const CERTAIN: f64 = 5.0;
/// Ratio of the residuals on the other camera's trajectory to those on its own from which the mount seems loose.
const LOOSE: f64 = 1.3;
/// Share of excluded events from which it is reported.
const MOST_LEFT_OUT: f64 = 0.3;
/// Number of σ below which a line delay is not significant.
const NO_DELAY: f64 = 3.0;
/// Reported difference between an intrinsic parameter and its value in the separate calibration, in its σ.
const MOVED: f64 = 4.0;

/// Returns the problems of `calibration`, and quantities that were not measured.
pub fn findings(calibration: &SecondCalibration) -> Vec<Finding> {
    let mut findings = not_measured(calibration);
    let (rate, sigma) = (calibration.mount.rate, calibration.sigma(RATE));
    if rate.abs() > DRIFT.max(CERTAIN * sigma) {
        findings.push(Finding::new(
            Cause::ClockRate,
            Severity::Note,
            format!(
                "the second clock gains {:.1} ± {:.1} µs a second on the first, and the offset is that in the middle of what both saw",
                1e6 * rate,
                1e6 * sigma
            ),
            "put both cameras on one clock",
        ));
    }
    if let Some(seconds) = calibration.time_scatter {
        findings.push(Finding::new(
            Cause::ScatteredTimes,
            Severity::Warning,
            format!("the times of the second camera scatter by {:.1} ms against the first", 1e3 * seconds),
            "take them from the camera, not from the computer that stores the pictures",
        ));
    }
    if let Some(ratio) = calibration.looseness.filter(|ratio| *ratio > LOOSE) {
        findings.push(Finding::new(
            Cause::Loose,
            Severity::Failure,
            format!(
                "the second camera's events fit the trajectory of the first {ratio:.2} times worse than one of its own"
            ),
            "fix both to a stiff mount",
        ));
    }
    if calibration.left_out > MOST_LEFT_OUT {
        findings.push(Finding::new(
            Cause::NotSeenTogether,
            Severity::Note,
            format!(
                "{:.0} % of what the second camera saw was left out, for the first did not see the board then",
                100.0 * calibration.left_out
            ),
            "keep the board in view of both",
        ));
    }
    if let Some(line_delay) = calibration.mount.line_delay.filter(|_| calibration.rolling_shutter) {
        let sigma = calibration.sigma(LINE_DELAY);
        if line_delay.abs() < NO_DELAY * sigma {
            findings.push(Finding::new(
                Cause::NoLineDelay,
                Severity::Note,
                format!(
                    "no line delay was found ({:.3} ± {:.3} µs per row), so it has a global shutter",
                    1e6 * line_delay,
                    1e6 * sigma
                ),
                "do not state a rolling shutter",
            ));
        }
    }
    findings.extend((0..2).filter_map(|camera| about_camera(calibration, camera)));
    without_consequences(&mut findings);
    findings
}

fn not_measured(calibration: &SecondCalibration) -> Vec<Finding> {
    let largest = |first: usize| (first..first + 3).map(|index| calibration.sigma(index)).fold(0.0, f64::max);
    let (place, rotation, offset) = (largest(TRANSLATION), largest(ROTATION), calibration.sigma(OFFSET));
    let quantities = [
        (
            place > PLACE_LIMIT,
            Cause::PositionNotMeasured,
            format!("the relative position of the cameras was hardly measured (± {:.1} mm)", 1e3 * place),
            "record longer, near the board",
        ),
        (
            rotation > ROTATION_LIMIT,
            Cause::RotationNotMeasured,
            format!("the relative rotation of the cameras was hardly measured (± {:.2}°)", rotation.to_degrees()),
            "record longer, near the board",
        ),
        (
            offset > OFFSET_LIMIT,
            Cause::DelayNotMeasured,
            format!("the offset of the clocks was hardly measured (± {:.1} ms)", 1e3 * offset),
            "move faster, back and forth",
        ),
    ];
    let found = quantities.into_iter().filter(|(is_found, ..)| *is_found);
    found.map(|(_, cause, reason, advice)| Finding::new(cause, Severity::Failure, reason, advice)).collect()
}

/// Returns the finding on the difference between a camera (0 or 1) and its separate calibration.
fn about_camera(calibration: &SecondCalibration, camera: usize) -> Option<Finding> {
    // In the separate calibration of a camera with a rolling shutter, all rows were assumed to be exposed at once.
    let is_of_other_rows = camera == 1 && calibration.rolling_shutter;
    let sigmas = calibration.cameras_moved[camera].filter(|sigmas| *sigmas > MOVED && !is_of_other_rows)?;
    let name = ["first", "second"][camera];
    let (cause, reason, advice) = if calibration.fixed[camera] {
        (
            Cause::OtherCamera,
            format!(
                "the intrinsics of the {name} camera that were fixed are {sigmas:.1} σ from those of this recording"
            ),
            "fix those of the same lens with the same focus",
        )
    } else {
        (
            Cause::CameraMoved,
            format!("the solve of both changed an intrinsic parameter of the {name} camera by {sigmas:.1} σ"),
            "check its own report",
        )
    };
    Some(Finding::new(cause, Severity::Warning, reason, advice))
}
