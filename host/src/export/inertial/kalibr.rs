//! Kalibr's files of a camera with an inertial unit: `camchain-imucam.yaml` and `imu.yaml`, as `kalibr_common/ConfigReader.py`
//! reads them.
//!
//! `T_cam_imu` maps coordinates of the unit to those of the camera; t_imu = t_cam + `timeshift_cam_imu`, for which the delay of
//! the gyroscope is written: Kalibr has one for both sensors. `accelerometers.M`, `gyroscopes.M` and `gyroscopes.C_gyro_i` are
//! those of its model `scale-misalignment`; g-sensitivity `gyroscopes.A` is zero.

use std::fmt::Write as _;

use super::{Mounted, TOPIC, camera_from_imu, matrix_rows, noise_lines};
use crate::export::number::{decimal, quoted};

/// `camchain-imucam.yaml` from the text of `camchain.yaml`.
pub fn camchain(mounted: &Mounted) -> Option<String> {
    let mut text = mounted.camchain?.to_owned();
    let _ = writeln!(text, "  # from the unit's coordinates to the camera's\n  T_cam_imu:");
    let rows = <[[f64; 4]; 4]>::from(camera_from_imu(&mounted.imu_from_camera?).transpose());
    text += &matrix_rows(&rows, "  ");
    let _ = writeln!(text, "  # t_imu = t_cam + timeshift_cam_imu (gyroscope)");
    let _ = writeln!(text, "  timeshift_cam_imu: {}", decimal(mounted.shift));
    Some(text)
}

/// `imu.yaml`.
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
