//! A static transform of ROS from the camera to the inertial unit.
//!
//! The transform of frame `camera` in frame `imu` has the translation and rotation of `T_imu_camera`: it maps coordinates of the
//! camera (optical axes: x right, y down, z forward) to those of the unit.

use nalgebra::{Isometry3, Matrix4, Rotation3, Translation3, UnitQuaternion};

use super::Mounted;
use crate::export::static_transform::{Frames, static_transform};

const FRAMES: Frames = Frames { parent: "dvs_imu", child: "dvs_optical" };

/// `static_transform.yaml`.
pub fn write(mounted: &Mounted) -> Option<String> {
    let pose = Matrix4::from(mounted.imu_from_camera?).transpose();
    let rotation = Rotation3::from_matrix_unchecked(pose.fixed_view::<3, 3>(0, 0).into_owned());
    let place = Translation3::new(pose[(0, 3)], pose[(1, 3)], pose[(2, 3)]);
    Some(static_transform(&FRAMES, &Isometry3::from_parts(place, UnitQuaternion::from_rotation_matrix(&rotation))))
}
