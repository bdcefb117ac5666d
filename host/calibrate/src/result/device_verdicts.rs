//! Verdicts on calibrated devices other than the camera: an IMU, other cameras.

use crate::calibrate::calibrated::{Calibrated, EventCalibration};
use crate::inertial::calibration::InertialCalibration;
use crate::quality::verdict::Grade;
use crate::result::inertial_result::InertialResult;
use crate::result::second_camera_result::SecondCameraResult;

/// The verdict on one device other than the camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceVerdict {
    /// The subject, capitalised.
    pub about: String,
    /// The grade.
    pub grade: Grade,
    /// The verdict in words.
    pub sentence: String,
}

/// Returns the verdicts on all other calibrated devices.
pub fn device_verdicts(calibrated: &Calibrated) -> Vec<DeviceVerdict> {
    let unit = calibrated.inertial.as_ref().map(of_unit);
    unit.into_iter().chain(calibrated.events().into_iter().flat_map(of_cameras)).collect()
}

/// Returns the worst grade of the camera and all other calibrated devices.
pub fn worst_grade(calibrated: &Calibrated) -> Grade {
    let others = device_verdicts(calibrated).into_iter().map(|other| other.grade);
    others.fold(calibrated.verdict.grade, Grade::max)
}

fn of_unit(inertial: &InertialCalibration) -> DeviceVerdict {
    let InertialResult { grade, verdict, .. } = InertialResult::new(inertial);
    DeviceVerdict { about: "IMU".to_owned(), grade, sentence: verdict }
}

fn of_cameras(events: &EventCalibration) -> impl Iterator<Item = DeviceVerdict> {
    events.second_cameras.iter().flat_map(|second| {
        let SecondCameraResult { recording, grade, verdict, lens_grade, lens_verdict, .. } =
            SecondCameraResult::new(second);
        let lens = lens_grade.map(|grade| DeviceVerdict {
            about: format!("Lens of {recording}"),
            grade,
            sentence: lens_verdict,
        });
        let place = DeviceVerdict { about: format!("Position of {recording}"), grade, sentence: verdict };
        lens.into_iter().chain([place])
    })
}
