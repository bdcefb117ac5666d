//! Checks of the calibration of a second camera.

use super::calibration::SecondCalibration;
use super::finding::Finding;
use super::mount::{LINE_DELAY, OFFSET, RATE, ROTATION, TRANSLATION};

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

/// Returns the problems of `calibration`.
pub fn findings(calibration: &SecondCalibration) -> Vec<Finding> {
    let mut findings = Vec::new();
    let largest = |first: usize| (first..first + 3).map(|index| calibration.sigma(index)).fold(0.0, f64::max);
    let (place, rotation, offset) = (largest(TRANSLATION), largest(ROTATION), calibration.sigma(OFFSET));
    if place > PLACE_LIMIT {
        findings.push(Finding::PlaceNotMeasured { sigma: place });
    }
    if rotation > ROTATION_LIMIT {
        findings.push(Finding::RotationNotMeasured { sigma: rotation });
    }
    if offset > OFFSET_LIMIT {
        findings.push(Finding::OffsetNotMeasured { sigma: offset });
    }
    let (rate, sigma) = (calibration.mount.rate, calibration.sigma(RATE));
    if rate.abs() > DRIFT.max(CERTAIN * sigma) {
        findings.push(Finding::ClockRate { rate, sigma });
    }
    if let Some(ratio) = calibration.looseness.filter(|ratio| *ratio > LOOSE) {
        findings.push(Finding::Loose { ratio });
    }
    if calibration.left_out > MOST_LEFT_OUT {
        findings.push(Finding::LeftOut { share: calibration.left_out });
    }
    if let Some(line_delay) = calibration.mount.line_delay.filter(|_| calibration.rolling_shutter) {
        let sigma = calibration.sigma(LINE_DELAY);
        if line_delay.abs() < NO_DELAY * sigma {
            findings.push(Finding::NoLineDelay { line_delay, sigma });
        }
    }
    for (camera, sigmas) in calibration.cameras_moved.into_iter().enumerate() {
        // In the separate calibration of a camera with a rolling shutter, all rows were assumed to be exposed at once.
        let is_of_other_rows = camera == 1 && calibration.rolling_shutter;
        let Some(sigmas) = sigmas.filter(|sigmas| *sigmas > MOVED && !is_of_other_rows) else { continue };
        findings.push(match calibration.fixed[camera] {
            true => Finding::OtherCamera { camera, sigmas },
            false => Finding::CameraMoved { camera, sigmas },
        });
    }
    findings
}
