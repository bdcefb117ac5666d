//! Devices on the mount of the first camera, added to its calibration.

use super::calibrated::{Calibrated, Evidence};
use super::mounted::SecondCamera;
use crate::calibrate::findings::orientation::{Shown, settle};
use crate::inertial::calibration::InertialCalibration;
use crate::inertial::error::InertialError;
use crate::second_camera::error::SecondCameraError;

impl Calibrated {
    /// Adds the IMU. Its accelerometer shows whether the image is mirrored; the verdict says so.
    ///
    /// # Errors
    /// The error in `found`.
    pub fn add_inertial(&mut self, found: Result<InertialCalibration, InertialError>) -> Result<(), InertialError> {
        match &found {
            Ok(inertial) if inertial.shows_acceleration() => settle(self, Shown::Right),
            Err(InertialError::OppositeAccelerations) => settle(self, Shown::OppositeAccelerations),
            _ => {}
        }
        self.inertial = Some(found?);
        Ok(())
    }

    /// Adds another camera. If one of both is mirrored, the verdict says so.
    ///
    /// # Errors
    /// The error in `found`.
    pub fn add_second(&mut self, found: Result<SecondCamera, SecondCameraError>) -> Result<(), SecondCameraError> {
        if matches!(found, Err(SecondCameraError::Mirrored)) {
            settle(self, Shown::OneOfTwoMirrored);
        }
        let found = found?;
        if let Evidence::Events(events) = &mut self.evidence {
            events.second_cameras.push(found);
        }
        Ok(())
    }
}
