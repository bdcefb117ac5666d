//! basalt's `calibration.json` with the IMU.
//!
//! `T_imu_cam` maps camera coordinates to IMU coordinates; t_imu = t_cam + `cam_time_offset_ns`. basalt's model is the inverse of
//! Kalibr's: the truth is (I + S) reading − b. With a reading M f + b' it follows that I + S = M⁻¹ and b = M⁻¹ b'; for the
//! gyroscope, whose axes are rotated by C, I + S = (M C)⁻¹. `calib_accel_bias` is b, then S as its lower triangle by columns,
//! `calib_gyro_bias` b, then S by columns. `*_noise_std` are densities.

use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};

use super::{ACCELEROMETER_WALK, GYROSCOPE_WALK, Mounted};
use evcal_geometry::numerics::rigid::pose_of_rows;

/// Writes `basalt-imu.json` from the text of `basalt.json`, with its camera.
pub fn write(mounted: &Mounted) -> Option<String> {
    let mut file: Value = serde_json::from_str(mounted.basalt?).ok()?;
    let inertial = mounted.inertial;
    let matrix = |rows: &[[f64; 3]; 3]| Matrix3::from(*rows).transpose();
    let of_gyroscope = (matrix(&inertial.gyroscope.matrix) * matrix(&inertial.gyroscope_from_imu)).try_inverse()?;
    let of_accelerometer = matrix(&inertial.accelerometer.matrix).try_inverse()?;
    let gyroscope_bias = of_gyroscope * Vector3::from(inertial.gyroscope.bias.value);
    let accelerometer_bias = of_accelerometer * Vector3::from(inertial.accelerometer.bias.value);
    let (gyroscope, accelerometer) = (of_gyroscope - Matrix3::identity(), of_accelerometer - Matrix3::identity());
    let below = [(0, 0), (1, 0), (2, 0), (1, 1), (2, 1), (2, 2)].map(|place| accelerometer[place]);
    let pose = pose_of_rows(&mounted.imu_from_camera?);
    let [px, py, pz]: [f64; 3] = pose.translation.vector.into();
    let [x, y, z, w]: [f64; 4] = pose.rotation.coords.into();
    let calibration = file.get_mut("value0")?.as_object_mut()?;
    let entries = [
        ("T_imu_cam", json!([{ "px": px, "py": py, "pz": pz, "qx": x, "qy": y, "qz": z, "qw": w }])),
        ("calib_accel_bias", json!([accelerometer_bias.as_slice(), &below].concat())),
        ("calib_gyro_bias", json!([gyroscope_bias.as_slice(), gyroscope.as_slice()].concat())),
        ("imu_update_rate", json!(mounted.rate)),
        ("accel_noise_std", json!(inertial.accelerometer.noise_density)),
        ("gyro_noise_std", json!(inertial.gyroscope.noise_density)),
        ("accel_bias_std", json!([ACCELEROMETER_WALK, ACCELEROMETER_WALK, ACCELEROMETER_WALK])),
        ("gyro_bias_std", json!([GYROSCOPE_WALK, GYROSCOPE_WALK, GYROSCOPE_WALK])),
        ("cam_time_offset_ns", json!((1e9 * mounted.shift).round() as i64)),
    ];
    for (name, value) in entries {
        calibration.insert(name.to_owned(), value);
    }
    Some(format!("{file:#}\n"))
}
