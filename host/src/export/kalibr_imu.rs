//! Kalibr's files of a camera with an inertial unit: `camchain-imucam.yaml` and `imu.yaml`, as `kalibr_common/ConfigReader.py`
//! reads them.
//!
//! `T_cam_imu` maps coordinates of the unit to those of the camera; t_imu = t_cam + `timeshift_cam_imu`, for which the delay of
//! the gyroscope is written: Kalibr has one for both sensors. `accelerometers.M`, `gyroscopes.M` and `gyroscopes.C_gyro_i` are
//! those of its model `scale-misalignment`; g-sensitivity `gyroscopes.A` is zero.

use std::fmt::Write as _;

use nalgebra::{Isometry3, Matrix4, Rotation3, Translation3, UnitQuaternion};

use super::number::{decimal, decimals, quoted};
use crate::result::inertial_result::{InertialResult, SensorResult};

/// Random walks of usual chips, for they are not measured: rad/s²/√Hz and m/s³/√Hz.
const GYROSCOPE_WALK: f64 = 2e-5;
const ACCELEROMETER_WALK: f64 = 1e-3;
const TOPIC: &str = "/dvs/imu";

/// `camchain-imucam.yaml` from the text of `camchain.yaml`; none where the place of the unit was not measured.
pub fn camchain(camchain: &str, inertial: &InertialResult) -> Option<String> {
    let rows = inertial.imu_from_camera?;
    let matrix = Matrix4::from(rows).transpose();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
        matrix.fixed_view::<3, 3>(0, 0).into_owned(),
    ));
    let place = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    let camera_from_imu = Isometry3::from_parts(Translation3::from(place), rotation).inverse().to_homogeneous();
    let mut text = camchain.to_owned();
    let _ = writeln!(text, "  # from the unit's coordinates to the camera's");
    text += "  T_cam_imu:\n";
    text += &matrix_rows(&<[[f64; 4]; 4]>::from(camera_from_imu.transpose()), "  ");
    let _ = writeln!(text, "  # t_imu = t_cam + timeshift_cam_imu (gyroscope)");
    let shift = inertial.gyroscope.delay.value + inertial.clock_origin;
    let _ = writeln!(text, "  timeshift_cam_imu: {}", decimal(shift));
    Some(text)
}

/// `imu.yaml`.
pub fn imu(inertial: &InertialResult) -> String {
    let mean = |sensor: &SensorResult| decimal(sensor.noise_density.iter().sum::<f64>() / 3.0);
    let rate = inertial.streams.iter().map(|stream| stream.rate).fold(0.0, f64::max);
    let mut text = "# Random walks are not measured: they are those of usual chips.\nimu0:\n  T_i_b:\n".to_owned();
    let identity = <[[f64; 4]; 4]>::from(Matrix4::<f64>::identity());
    text += &matrix_rows(&identity, "  ");
    let _ = writeln!(text, "  accelerometer_noise_density: {}", mean(&inertial.accelerometer));
    let _ = writeln!(text, "  accelerometer_random_walk: {}", decimal(ACCELEROMETER_WALK));
    text += "  accelerometers:\n    M:\n";
    text += &matrix_rows(&inertial.accelerometer.matrix, "    ");
    let _ = writeln!(text, "  gyroscope_noise_density: {}", mean(&inertial.gyroscope));
    let _ = writeln!(text, "  gyroscope_random_walk: {}", decimal(GYROSCOPE_WALK));
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
        decimal((rate * 1e3).round() * 1e-3)
    );
    text
}

fn matrix_rows<const N: usize>(matrix: &[[f64; N]; N], indent: &str) -> String {
    matrix.iter().map(|row| format!("{indent}- [{}]\n", decimals(row))).collect()
}
