//! Another camera on the mount of the first, after its calibration.

use evcal_core::sensor::Sensor;

use crate::quality::verdict::Grade;
use crate::second_camera::calibration::SecondCalibration;
use evcal_geometry::lens::camera_file::CameraDescription;
use evcal_geometry::lens::covered_region::CoveredRegion;
use event_recordings::Files;
use event_recordings::image_folder::Stamps;

/// Another camera on the mount of the first.
#[derive(Clone, Debug)]
pub struct SecondCamera {
    /// Its recording.
    pub file: String,
    /// The files of this recording.
    pub source_files: Files,
    /// Size of its sensor.
    pub sensor: Sensor,
    /// Its lens, calibrated separately.
    pub camera: CameraDescription,
    /// Standard deviation of each parameter of the lens.
    pub sigma: CameraDescription,
    /// Region of its sensor in which the board was seen.
    pub covered: CoveredRegion,
    /// Grade of the separate calibration of its lens. `None` if it does not matter: for the first camera's own frames,
    /// with fixed intrinsics, and with a rolling shutter, because no lens model explains its frames before the delay of
    /// the rows is known.
    pub lens_grade: Option<Grade>,
    /// Verdict of the calibration of its lens.
    pub lens_verdict: String,
    /// Times of the first events of the first camera's recording and of this one, on their own clocks (s).
    pub starts: [f64; 2],
    /// Its frames, if it is a frame camera.
    pub frames: Option<SecondFrames>,
    /// Its pose relative to the first camera, and its clock.
    pub calibration: SecondCalibration,
}

/// The frames of another camera on the mount.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SecondFrames {
    /// Number of frames that show the board and were used.
    pub used: usize,
    /// Meaning of their timestamps.
    pub stamps: Stamps,
    /// `true` if they have exposure times.
    pub exposure_known: bool,
}
