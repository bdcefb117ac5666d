//! `calibration.json` of basalt, as cereal reads it.
//!
//! Only the camera comes from evcal: the inertial entries, which its reader requires, come from basalt's own example, and
//! `T_imu_cam` is the identity.

use std::fmt::Write as _;

use evcal_core::camera::{Camera, ModelKind};
use nalgebra::Vector3;

use super::content::{Content, ExportFormat};
use super::number::{decimal, quoted};
use evcal_core::sensor::Sensor;

/// `basalt.json`. Its model with radial and tangential distortion, `pinhole-radtan8`, is in newer versions only.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "basalt",
    program: "basalt",
    file: "basalt.json",
    models: &[
        ModelKind::Radtan8,
        ModelKind::KannalaBrandt,
        ModelKind::Ucm,
        ModelKind::Eucm,
        ModelKind::DoubleSphere,
        ModelKind::Fov,
    ],
    substitutes: &[ModelKind::KannalaBrandt, ModelKind::Eucm, ModelKind::DoubleSphere],
    write,
    first_pixel: 0.0,
    front_only: false,
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
        ModelKind::Radtan8 => "pinhole-radtan8",
        ModelKind::Ucm => "ucm",
        ModelKind::Eucm => "eucm",
        ModelKind::DoubleSphere => "ds",
        ModelKind::Fov => "fov",
        _ => "kb4",
    };
    let names = content.model.parameter_names().iter();
    let values = content.matrix.iter().chain(content.distortion);
    let mut intrinsics: Vec<String> =
        names.zip(values).map(|(name, value)| format!("\"{name}\": {}", decimal(*value))).collect();
    if content.model == ModelKind::Radtan8 {
        intrinsics.push(format!("\"rpmax\": {}", decimal(largest_radius(content.distortion))));
    }
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

/// Radius beyond which basalt need not look: 89.4° from the axis.
const FAR: f64 = 99.0;

/// Returns the radius in the plane at distance 1 up to which these coefficients of `radtan8` are one-to-one; 0 if they are
/// everywhere, as basalt writes it.
fn largest_radius(distortion: &[f64]) -> f64 {
    let camera: Option<Camera<f64>> =
        Camera::from_parameters(ModelKind::Radtan8, &[&[1.0, 1.0, 0.0, 0.0], distortion].concat());
    let Some(camera) = camera else { return 0.0 };
    // The domain is a circle.
    let sees = |radius: f64| camera.project(&Vector3::new(radius, 0.0, 1.0)).is_some();
    if sees(FAR) {
        return 0.0;
    }
    let (mut inside, mut outside) = (0.0, FAR);
    for _ in 0..60 {
        let middle = 0.5 * (inside + outside);
        if sees(middle) { inside = middle } else { outside = middle }
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without tangential distortion r (1 + k1 r²) has its largest value at r² = -1 / (3 k1).
    #[test]
    fn the_radius_ends_where_the_distortion_folds() {
        let radius = largest_radius(&[-0.25, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!((radius - (1.0_f64 / 0.75).sqrt()).abs() < 0.02 && radius < (1.0_f64 / 0.75).sqrt(), "{radius}");
        assert_eq!(largest_radius(&[0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 0.0);
    }
}
