//! Cameras whose intrinsics are fixed in the solve with an IMU or with other cameras.

use std::path::{Path, PathBuf};

use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_core::sensor::Sensor;
use evcal_files::remedy::Remedy;
use evcal_files::visible;
use evcal_geometry::lens::camera_file::CameraFileError;
use evcal_solve::solve::fixed_intrinsics::FixedIntrinsics;

use super::super::print;

/// A camera whose intrinsics are fixed.
pub struct FixedCamera {
    file: PathBuf,
    sensor: Sensor,
    intrinsics: FixedIntrinsics,
}

/// The given camera and the recording have different sensor sizes.
#[derive(Debug, thiserror::Error)]
#[error(
    "{} is for a camera with {} x {} pixels, but the camera of the recording has {} x {}: give the calibration of the same camera",
    visible::path(file), known.width, known.height, recorded.width, recorded.height
)]
pub struct OtherSensor {
    file: PathBuf,
    known: Sensor,
    recorded: Sensor,
}

impl Remedy for OtherSensor {}

impl FixedCamera {
    /// Reads a calibration or another camera file; prints a warning if it contains no σ.
    pub fn read(path: &Path) -> Result<Self, CameraFileError> {
        let known = CalibratedCamera::read(path)?;
        let (camera, sensor, covariance) = (known.camera, known.sensor, known.covariance_matrix());
        if covariance.is_none() {
            let file = visible::path(path);
            print::aside(format!("{file} contains no σ of the intrinsics, so all σ of this calibration are too small"));
        }
        Ok(Self { file: path.to_owned(), sensor, intrinsics: FixedIntrinsics { camera, covariance } })
    }

    /// Returns the intrinsics for a recording with this sensor size.
    pub fn of(&self, recorded: Sensor) -> Result<&FixedIntrinsics, OtherSensor> {
        if self.sensor == recorded {
            return Ok(&self.intrinsics);
        }
        Err(OtherSensor { file: self.file.clone(), known: self.sensor, recorded })
    }
}

/// The cameras whose intrinsics are fixed.
#[derive(Default)]
pub struct FixedCameras {
    /// The first camera.
    pub first: Option<FixedCamera>,
    /// The other cameras, in the order of their recordings; may be fewer.
    pub others: Vec<FixedCamera>,
}
