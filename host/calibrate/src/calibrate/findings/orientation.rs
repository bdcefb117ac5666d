//! Findings on the orientation of the image. A board that is its own mirror image looks right in a mirrored image; a device on
//! the mount shows it.

use evcal_core::sensor::Sensor;
use event_recordings::likely_sensor::likely_sensor;

use crate::advice::Advice;
use crate::calibrate::calibrated::Calibrated;
use crate::quality::verdict::{Cause, Finding, Severity, Verdict};
use evcal_geometry::board::Board;
use evcal_geometry::board::symmetry::reflection;

/// Returns the finding on the orientation of the image of `sensor`; `None` if `board` shows that the image is not mirrored.
pub(in crate::calibrate) fn finding_on(board: &Board, sensor: Sensor) -> Option<Finding> {
    reflection(board).map(|_| match turned_sensor(sensor) {
        Some(turned) => Finding {
            cause: Cause::ExchangedAxes,
            severity: Severity::Failure,
            reason: format!("the sensor is {sensor} pixels, but cameras have {turned}: x and y seem to be exchanged"),
            advice: Advice::ExchangeAxes,
        },
        None => Finding {
            cause: Cause::OrientationNotChecked,
            severity: Severity::Note,
            reason: "it was not checked whether the image is mirrored, because this board is its own mirror image"
                .to_owned(),
            advice: "if in doubt, see in a picture of the events that nothing is mirrored, or calibrate the IMU, too"
                .into(),
        },
    })
}

/// Returns the common sensor whose width and height are exchanged in `sensor`.
fn turned_sensor(sensor: Sensor) -> Option<Sensor> {
    let turned = Sensor::new(sensor.height, sensor.width);
    let (column, row) = (turned.width.checked_sub(1)?, turned.height.checked_sub(1)?);
    (sensor.height > sensor.width && likely_sensor(column, row) == Some(turned)).then_some(turned)
}

/// What a device on the mount shows about the image of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::calibrate) enum Shown {
    /// Its orientation is right.
    Right,
    /// The accelerometer measures the opposite of each acceleration along the trajectory.
    OppositeAccelerations,
    /// One of two cameras on the mount is mirrored.
    OneOfTwoMirrored,
}

/// Settles the orientation of the image of `calibrated`, if its verdict says that it was not checked.
pub(in crate::calibrate) fn settle(calibrated: &mut Calibrated, shown: Shown) {
    let is_open = |finding: &Finding| finding.cause == Cause::OrientationNotChecked;
    let mut findings = calibrated.verdict.findings.clone();
    if !findings.iter().any(is_open) {
        return;
    }
    findings.retain(|finding| !is_open(finding));
    let mirrored = match shown {
        Shown::Right => None,
        Shown::OppositeAccelerations => Some(
            "the image is mirrored, or all axes of the accelerometer have the opposite sign: it measures the opposite \
             of each acceleration",
        ),
        Shown::OneOfTwoMirrored => {
            Some("the image of this camera or of the other one is mirrored: their motions match only then")
        }
    };
    findings.extend(mirrored.map(|reason| Finding {
        cause: Cause::MirroredImage,
        severity: Severity::Failure,
        reason: reason.to_owned(),
        advice: "see in a picture of the events which side is wrong, and give recordings whose x grows to the right and \
                 y downwards"
            .into(),
    }));
    calibrated.verdict = Verdict::new(calibrated.camera(), &calibrated.quality, findings);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_that_is_higher_than_wide_has_exchanged_axes() {
        let board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let found = |width, height| finding_on(&board, Sensor::new(width, height)).map(|finding| finding.severity);
        assert_eq!(found(260, 346), Some(Severity::Failure));
        assert_eq!(found(720, 1280), Some(Severity::Failure));
        assert_eq!(found(346, 260), Some(Severity::Note));
        assert_eq!(found(128, 128), Some(Severity::Note));
        assert_eq!(found(300, 400), Some(Severity::Note), "no camera has 400 x 300 pixels");
        let tags = "aprilgrid:6x6:35.2mm:0.3".parse().unwrap();
        assert_eq!(finding_on(&tags, Sensor::new(260, 346)), None);
    }
}
