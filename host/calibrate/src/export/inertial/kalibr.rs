//! Kalibr's files of a camera with an IMU: `camchain-imucam.yaml` and `imu.yaml`, as `kalibr_common/ConfigReader.py` reads them.
//!
//! `T_cam_imu` maps IMU coordinates to camera coordinates; t_imu = t_cam + `timeshift_cam_imu`, which is the delay of the
//! gyroscope, because Kalibr has one delay for both sensors. `accelerometers.M`, `gyroscopes.M` and `gyroscopes.C_gyro_i` are the
//! matrices of its model `scale-misalignment`; the g-sensitivity `gyroscopes.A` is zero.

use std::fmt::Write as _;

use nalgebra::Matrix4;

use super::{Mounted, TOPIC, camera_from_imu, matrix_rows, noise_lines};
use crate::export::number::{decimal, quoted};
use crate::export::second_camera;

/// Writes `camchain-imucam.yaml` from the text of `camchain.yaml`, with the other cameras on the mount that Kalibr's models
/// support.
pub fn camchain(mounted: &Mounted) -> Option<String> {
    let first_from_imu = camera_from_imu(&mounted.imu_from_camera?);
    let others = second_camera::kalibr_others(mounted.camera, mounted.others);
    let numbers: Vec<String> = (1..=others.len()).map(|number| number.to_string()).collect();
    let overlaps = format!("cam_overlaps: [{}]", numbers.join(", "));
    let mut text = mounted.camchain?.replacen("cam_overlaps: []", &overlaps, 1);
    text += &with_unit(first_from_imu, mounted.shift);
    for other in &others {
        text += &other.text;
        // t_n = t_0 + offset, and t_imu = t_0 + shift.
        text += &with_unit(other.from_first.to_homogeneous() * first_from_imu, mounted.shift - other.time_offset);
    }
    Some(text)
}

/// Writes the entries of the IMU for a camera.
fn with_unit(camera_from_imu: Matrix4<f64>, shift: f64) -> String {
    let rows = <[[f64; 4]; 4]>::from(camera_from_imu.transpose());
    format!(
        "  # from the unit's coordinates to the camera's\n  T_cam_imu:\n{}  # t_imu = t_cam + timeshift_cam_imu (gyroscope)\n  timeshift_cam_imu: {}\n",
        matrix_rows(&rows, "  "),
        decimal(shift)
    )
}

/// Writes `imu.yaml`.
pub fn imu(mounted: &Mounted) -> Option<String> {
    let inertial = mounted.inertial;
    let mut text = "# Random walks are not measured: they are those of usual chips.\nimu0:\n  T_i_b:\n".to_owned();
    text +=
        &matrix_rows(&[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]], "  ");
    text += &noise_lines(inertial, "  ");
    text += "  accelerometers:\n    M:\n";
    text += &matrix_rows(&inertial.accelerometer.matrix, "    ");
    text += "  gyroscopes:\n    A:\n";
    text += &matrix_rows(&[[0.0; 3]; 3], "    ");
    text += "    C_gyro_i:\n";
    text += &matrix_rows(&inertial.gyroscope_from_imu, "    ");
    text += "    M:\n";
    text += &matrix_rows(&inertial.gyroscope.matrix, "    ");
    let _ = write!(
        text,
        "  model: scale-misalignment\n  rostopic: {}\n  time_offset: 0.0\n  update_rate: {}\n",
        quoted(TOPIC),
        decimal(mounted.rate)
    );
    Some(text)
}
