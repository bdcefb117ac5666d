//! Another camera on the mount of the first, as it was calibrated.

use evcal_core::sensor::Sensor;

use crate::second_camera::calibration::SecondCalibration;
use crate::trust::verdict::Grade;
use evcal_geometry::lens::camera_file::CameraDescription;
use evcal_geometry::lens::covered_region::CoveredRegion;
use event_recordings::image_folder::Stamps;

/// Another camera on the mount of the first.
#[derive(Clone, Debug)]
pub struct SecondCamera {
    /// Its recording.
    pub file: String,
    /// Size of its sensor.
    pub sensor: Sensor,
    /// Its lens, calibrated apart.
    pub camera: CameraDescription,
    /// Standard deviation of each parameter of the lens.
    pub sigma: CameraDescription,
    /// Where on its sensor the board was seen.
    pub covered: CoveredRegion,
    /// Whether its lens, calibrated apart, is good; none where that does not matter: for the first camera's own frames, with held
    /// intrinsics, and with a rolling shutter, whose frames no lens explains before it is known.
    pub lens_grade: Option<Grade>,
    /// What the calibration of its lens says of itself.
    pub lens_verdict: String,
    /// Times of the first events of the first camera's recording and of this one, on their clocks (s).
    pub starts: [f64; 2],
    /// Its frames, where it takes frames.
    pub frames: Option<SecondFrames>,
    /// Where it is, and how its clock goes.
    pub calibration: SecondCalibration,
}

/// The frames of another camera on the mount.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SecondFrames {
    /// How many show the board and were used.
    pub used: usize,
    /// What their time stamps stand for.
    pub stamps: Stamps,
    /// Whether they came with their exposure times.
    pub exposure_known: bool,
}
