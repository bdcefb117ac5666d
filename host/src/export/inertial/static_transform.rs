//! A static transform of ROS: content of a `geometry_msgs/TransformStamped` as YAML, and the commands that publish it.
//!
//! The transform of frame `camera` in frame `imu` has the translation and rotation of `T_imu_camera`: it maps coordinates of the
//! camera (optical axes: x right, y down, z forward) to those of the unit.

use std::fmt::Write as _;

use nalgebra::{Matrix4, Rotation3, UnitQuaternion};

use super::Mounted;
use crate::export::number::{decimal, quoted};

const PARENT: &str = "dvs_imu";
const CHILD: &str = "dvs_optical";

/// `static_transform.yaml`.
pub fn write(mounted: &Mounted) -> Option<String> {
    let pose = Matrix4::from(mounted.imu_from_camera?).transpose();
    let rotation = Rotation3::from_matrix_unchecked(pose.fixed_view::<3, 3>(0, 0).into_owned());
    let quaternion: [f64; 4] = UnitQuaternion::from_rotation_matrix(&rotation).coords.into();
    let place = [pose[(0, 3)], pose[(1, 3)], pose[(2, 3)]];
    let [x, y, z] = place.map(decimal);
    let [qx, qy, qz, qw] = quaternion.map(decimal);
    let mut text =
        format!("# From coordinates of {CHILD} (x right, y down, z forward) to those of {PARENT}, metres.\n");
    let _ = writeln!(
        text,
        "# ROS 1: rosrun tf2_ros static_transform_publisher {x} {y} {z} {qx} {qy} {qz} {qw} {PARENT} {CHILD}"
    );
    let _ = writeln!(
        text,
        "# ROS 2: ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z {z} --qx {qx} --qy {qy} --qz {qz} --qw {qw} \
         --frame-id {PARENT} --child-frame-id {CHILD}"
    );
    let _ = writeln!(text, "header:\n  frame_id: {}\nchild_frame_id: {}", quoted(PARENT), quoted(CHILD));
    let _ = writeln!(text, "transform:\n  translation: {{x: {x}, y: {y}, z: {z}}}");
    let _ = writeln!(text, "  rotation: {{x: {qx}, y: {qy}, z: {qz}, w: {qw}}}");
    Some(text)
}
