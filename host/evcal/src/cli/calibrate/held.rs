//! Cameras whose intrinsics are held where they are solved together with something else.

use std::path::{Path, PathBuf};

use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_calibrate::solve::held_intrinsics::HeldIntrinsics;
use evcal_core::sensor::Sensor;
use evcal_files::visible;
use evcal_geometry::lens::camera_file::CameraFileError;

use super::super::print;

/// A camera whose intrinsics are held.
pub struct HeldCamera {
    file: PathBuf,
    sensor: Sensor,
    intrinsics: HeldIntrinsics,
}

/// The camera is another one.
#[derive(Debug, thiserror::Error)]
#[error(
    "{} is a camera of {} x {} pixels, that of the recording has {} x {}: give the calibration of the same camera",
    visible::path(file), known.width, known.height, recorded.width, recorded.height
)]
pub struct OtherSensor {
    file: PathBuf,
    known: Sensor,
    recorded: Sensor,
}

impl HeldCamera {
    /// Reads a calibration, or another camera file; without σ it is told.
    pub fn read(path: &Path) -> Result<Self, CameraFileError> {
        let known = CalibratedCamera::read(path)?;
        let (camera, sensor, covariance) = (known.camera, known.sensor, known.covariance_matrix());
        if covariance.is_none() {
            let file = visible::path(path);
            print::aside(format!(
                "{file} has no σ for the intrinsics, so the σ of everything solved with them is too small"
            ));
        }
        Ok(Self { file: path.to_owned(), sensor, intrinsics: HeldIntrinsics { camera, covariance } })
    }

    /// Its intrinsics, for a recording of a camera with this sensor.
    pub fn of(&self, recorded: Sensor) -> Result<&HeldIntrinsics, OtherSensor> {
        if self.sensor == recorded {
            return Ok(&self.intrinsics);
        }
        Err(OtherSensor { file: self.file.clone(), known: self.sensor, recorded })
    }
}

/// Cameras of all recordings whose intrinsics are held.
#[derive(Default)]
pub struct HeldCameras {
    /// The first one.
    pub first: Option<HeldCamera>,
    /// The first of the others.
    pub others: Vec<HeldCamera>,
}
