//! OpenVINS: `kalibr_imucam_chain.yaml` and `kalibr_imu_chain.yaml`, as its `YamlParser` reads them.
//!
//! `T_imu_cam` maps camera coordinates to IMU coordinates; t_imu = t_cam + `timeshift_cam_imu`. The true angular velocity is
//! `R_IMUtoGYRO`ᵀ `Tw`⁻¹ (reading − bias), the true acceleration `R_IMUtoACC`ᵀ `Ta`⁻¹ (reading − bias): `Tw` and `Ta` are the
//! matrices of the readings, with the lower triangle of its model `kalibr`. The camera must be a pinhole with `radtan` or
//! `equidistant`.

use std::fmt::Write as _;

use super::{Mounted, matrix_rows, noise_lines};
use crate::export::number::{decimal, quoted};

/// Writes `kalibr_imucam_chain.yaml` from the text of `camchain.yaml`.
pub fn camera(mounted: &Mounted) -> Option<String> {
    let known = ["distortion_model: radtan", "distortion_model: equidistant"];
    let camchain = mounted.camchain?;
    if !camchain.contains("camera_model: pinhole") || !known.iter().any(|one| camchain.contains(one)) {
        return None;
    }
    let mut text = format!("%YAML:1.0\n\n{camchain}");
    text += "  # from the camera's coordinates to the unit's\n  T_imu_cam:\n";
    text += &matrix_rows(&mounted.imu_from_camera?, "    ");
    let _ = writeln!(
        text,
        "  # t_imu = t_cam + timeshift_cam_imu (gyroscope)\n  timeshift_cam_imu: {}",
        decimal(mounted.shift)
    );
    Some(text)
}

/// Writes `kalibr_imu_chain.yaml`.
pub fn unit(mounted: &Mounted) -> Option<String> {
    let inertial = mounted.inertial;
    let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut text =
        "%YAML:1.0\n\n# Random walks are not measured: they are those of usual chips.\nimu0:\n  T_i_b:\n".to_owned();
    text +=
        &matrix_rows(&[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]], "    ");
    text += &noise_lines(inertial, "  ");
    let _ = writeln!(text, "  model: {}\n  rostopic: {}\n  time_offset: 0.0", quoted("kalibr"), quoted(super::TOPIC));
    let _ = writeln!(text, "  update_rate: {}", decimal(mounted.rate));
    let matrices = [
        ("Tw", &inertial.gyroscope.matrix),
        ("R_IMUtoGYRO", &inertial.gyroscope_from_imu),
        ("Ta", &inertial.accelerometer.matrix),
        ("R_IMUtoACC", &identity),
        ("Tg", &[[0.0; 3]; 3]),
    ];
    for (name, matrix) in matrices {
        let _ = writeln!(text, "  {name}:");
        text += &matrix_rows(matrix, "    ");
    }
    Some(text)
}
