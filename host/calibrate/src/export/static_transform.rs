//! A static transform of ROS: `geometry_msgs/TransformStamped` as YAML, and the commands that publish it.

use std::fmt::Write as _;

use nalgebra::Isometry3;

use super::number::{decimal, quoted};

/// Names of the frames of a transform.
pub struct Frames<'a> {
    /// Parent frame.
    pub parent: &'a str,
    /// Child frame, of a camera with optical axes.
    pub child: &'a str,
}

/// Writes the transform of frame `child` in frame `parent`, with the translation and rotation of `T_parent_child`.
pub fn static_transform(Frames { parent, child }: &Frames, parent_child: &Isometry3<f64>) -> String {
    let [x, y, z] = <[f64; 3]>::from(parent_child.translation.vector).map(decimal);
    let [qx, qy, qz, qw] = <[f64; 4]>::from(parent_child.rotation.coords).map(decimal);
    let mut text =
        format!("# From coordinates of {child} (x right, y down, z forward) to those of {parent}, metres.\n");
    let _ = writeln!(
        text,
        "# ROS 1: rosrun tf2_ros static_transform_publisher {x} {y} {z} {qx} {qy} {qz} {qw} {parent} {child}"
    );
    let _ = writeln!(
        text,
        "# ROS 2: ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z {z} --qx {qx} --qy {qy} --qz {qz} --qw {qw} \
         --frame-id {parent} --child-frame-id {child}"
    );
    let _ = writeln!(text, "header:\n  frame_id: {}\nchild_frame_id: {}", quoted(parent), quoted(child));
    let _ = writeln!(text, "transform:\n  translation: {{x: {x}, y: {y}, z: {z}}}");
    let _ = writeln!(text, "  rotation: {{x: {qx}, y: {qy}, z: {qz}, w: {qw}}}");
    text
}
