//! A static transform of ROS from the camera to the IMU.
//!
//! The transform of frame `camera` in frame `imu` has the translation and rotation of `T_imu_camera`: it maps camera coordinates
//! (optical axes: x right, y down, z forward) to IMU coordinates.

use super::Mounted;
use crate::export::static_transform::{Frames, static_transform};
use evcal_geometry::numerics::rigid::pose_of_rows;

const FRAMES: Frames = Frames { parent: "dvs_imu", child: "dvs_optical" };

/// Writes `static_transform.yaml`.
pub fn write(mounted: &Mounted) -> Option<String> {
    Some(static_transform(&FRAMES, &pose_of_rows(&mounted.imu_from_camera?)))
}
