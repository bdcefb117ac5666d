//! ROS `camera_info` YAML, as `camera_info_manager` and `camera_calibration_parsers` read it.
//!
//! `plumb_bob` is k1 k2 p1 p2 k3, `rational_polynomial` k1 k2 p1 p2 k3 k4 k5 k6, `equidistant` k1 k2 k3 k4. The
//! camera is monocular: no rectifying rotation, and rectified images keep the camera matrix.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::number::{decimals, quoted};
use evcal_core::sensor::Sensor;

/// `camera_info.yaml`.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "ros",
    program: "ROS",
    file: "camera_info.yaml",
    models: &[ModelKind::Radtan, ModelKind::Radtan8, ModelKind::KannalaBrandt],
    substitutes: &[ModelKind::Radtan, ModelKind::KannalaBrandt],
    write,
};

fn write(content: &Content) -> String {
    let Sensor { width, height } = content.calibrated.sensor;
    let model = match content.model {
        ModelKind::KannalaBrandt => "equidistant",
        ModelKind::Radtan8 => "rational_polynomial",
        _ => "plumb_bob",
    };
    let [fx, fy, cx, cy] = content.matrix;
    let mut text = String::new();
    for remark in content.remarks() {
        let _ = writeln!(text, "# {remark}");
    }
    let _ = write!(
        text,
        "image_width: {width}\nimage_height: {height}\ncamera_name: {}\n",
        quoted(&content.calibrated.name)
    );
    matrix(&mut text, "camera_matrix", 3, &content.camera_matrix());
    let _ = writeln!(text, "distortion_model: {model}");
    matrix(&mut text, "distortion_coefficients", 1, content.distortion);
    matrix(&mut text, "rectification_matrix", 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    matrix(&mut text, "projection_matrix", 3, &[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    text
}

fn matrix(text: &mut String, name: &str, rows: usize, values: &[f64]) {
    let _ = writeln!(
        text,
        "{name}:\n  rows: {rows}\n  cols: {}\n  data: [{}]",
        values.len() / rows,
        // On one line, because some readers of this format do not support wrapped lists.
        decimals(values)
    );
}
