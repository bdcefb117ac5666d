//! ROS `camera_info` YAML, as `camera_info_manager` and `camera_calibration_parsers` read it.
//!
//! `plumb_bob` is k1 k2 p1 p2 k3, `rational_polynomial` k1 k2 p1 p2 k3 k4 k5 k6, `equidistant` k1 k2 k3 k4. The
//! camera is monocular: no rectifying rotation, and rectified images keep the camera matrix.

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::fill::fill;

/// `camera_info.yaml`.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "ros",
    program: "ROS",
    file: "camera_info.yaml",
    models: &[ModelKind::Radtan, ModelKind::Radtan8, ModelKind::KannalaBrandt],
    substitutes: &[ModelKind::Radtan, ModelKind::KannalaBrandt],
    write,
    first_pixel: 0.0,
    front_only: false,
};

fn write(content: &Content) -> String {
    let (model, count) = match content.model {
        ModelKind::KannalaBrandt => ("equidistant", 4),
        ModelKind::Radtan8 => ("rational_polynomial", 8),
        _ => ("plumb_bob", 5),
    };
    // Lists are on one line, because some readers of this format do not support wrapped lists.
    let text = format!(
        "$remarks
image_width: $width
image_height: $height
camera_name: $name
camera_matrix:
  rows: 3
  cols: 3
  data: [$fx, 0.0, $cx, 0.0, $fy, $cy, 0.0, 0.0, 1.0]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: [$distortion]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [$fx, 0.0, $cx, 0.0, 0.0, $fy, $cy, 0.0, 0.0, 0.0, 1.0, 0.0]
"
    );
    fill(&text, content)
}
