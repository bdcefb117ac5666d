//! `calibration.json` of basalt, as cereal reads it.
//!
//! Only the camera comes from evcal: the inertial entries, which its reader requires, come from basalt's own example, and
//! `T_imu_cam` is the identity.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::number::{decimal, quoted};
use evcal_core::sensor::Sensor;

/// `basalt.json`. basalt has no radial-tangential model.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "basalt",
    program: "basalt",
    file: "basalt.json",
    models: &[ModelKind::KannalaBrandt, ModelKind::Ucm, ModelKind::Eucm, ModelKind::DoubleSphere, ModelKind::Fov],
    substitutes: &[ModelKind::KannalaBrandt, ModelKind::Eucm, ModelKind::DoubleSphere],
    write,
};

/// Everything except the camera and its size. The reader takes the first value of the file as the calibration, so the comment is
/// inside it.
const INERTIAL: &str = r#"    "calib_accel_bias": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "calib_gyro_bias": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "imu_update_rate": 200.0,
    "accel_noise_std": [0.016, 0.016, 0.016],
    "gyro_noise_std": [0.000282, 0.000282, 0.000282],
    "accel_bias_std": [0.001, 0.001, 0.001],
    "gyro_bias_std": [0.0001, 0.0001, 0.0001],
    "cam_time_offset_ns": 0,
    "vignette": [],
"#;

fn write(content: &Content) -> String {
    let Sensor { width, height } = content.calibrated.sensor;
    let camera_type = match content.model {
        ModelKind::Ucm => "ucm",
        ModelKind::Eucm => "eucm",
        ModelKind::DoubleSphere => "ds",
        ModelKind::Fov => "fov",
        _ => "kb4",
    };
    let names = content.model.parameter_names().iter();
    let values = content.matrix.iter().chain(content.distortion);
    let intrinsics: Vec<String> =
        names.zip(values).map(|(name, value)| format!("\"{name}\": {}", decimal(*value))).collect();
    let mut text = String::from("{\n  \"value0\": {\n");
    let _ = write!(
        text,
        "    \"T_imu_cam\": [{{\"px\": 0.0, \"py\": 0.0, \"pz\": 0.0, \"qx\": 0.0, \"qy\": 0.0, \"qz\": 0.0, \"qw\": 1.0}}],\n    \
         \"intrinsics\": [{{\"camera_type\": \"{camera_type}\", \"intrinsics\": {{{}}}}}],\n    \"resolution\": [[{width}, {height}]],\n",
        intrinsics.join(", ")
    );
    text += INERTIAL;
    let _ = write!(text, "    \"comment\": {}\n  }}\n}}\n", quoted(&content.remarks().join("; ")));
    text
}
