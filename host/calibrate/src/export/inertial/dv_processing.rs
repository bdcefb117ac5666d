//! Calibration JSON, version 2, of dv-processing with the IMU, `S0`, below `imus`.
//!
//! `transformationToC0` maps IMU coordinates to camera coordinates, row by row. A timestamp of the IMU minus `timeOffsetMicros`
//! is one of the camera. Every scalar is a string. The offsets are subtracted from readings; the format has no scale and no
//! misalignment.

use nalgebra::Matrix4;
use serde_json::{Value, json};

use super::{ACCELEROMETER_WALK, GYROSCOPE_WALK, Mounted, camera_from_imu, mean};
use crate::export::number::decimal;
use crate::result::inertial_result::SensorResult;
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

/// Range of the gyroscope to which DV sets a DAVIS346 (°/s).
const LARGEST_TURN: f64 = 500.0;
/// Range of the accelerometer to which DV sets a DAVIS346 (g).
const LARGEST_ACCELERATION: f64 = 4.0;

/// Writes `dv-processing-imu.json` from the text of `dv-processing.json`, with its camera.
pub fn write(mounted: &Mounted) -> Option<String> {
    let mut file: Value = serde_json::from_str(mounted.dv_processing?).ok()?;
    let texts = |values: &[f64]| values.iter().map(|value| decimal(*value)).collect::<Vec<_>>();
    let spread = |sensor: &SensorResult| decimal(sensor.bias.sigma.iter().copied().fold(0.0, f64::max));
    let (gyroscope, accelerometer) = (&mounted.inertial.gyroscope, &mounted.inertial.accelerometer);
    let to_camera: Matrix4<f64> = camera_from_imu(&mounted.imu_from_camera?);
    let unit = json!({
        "name": mounted.camera.name,
        "omegaMax": decimal(LARGEST_TURN.to_radians()),
        "accMax": decimal(LARGEST_ACCELERATION * STANDARD_GRAVITY),
        "omegaOffsetAvg": texts(&gyroscope.bias.value),
        "accOffsetAvg": texts(&accelerometer.bias.value),
        "omegaOffsetVar": spread(gyroscope),
        "accOffsetVar": spread(accelerometer),
        "omegaNoiseDensity": decimal(mean(gyroscope)),
        "accNoiseDensity": decimal(mean(accelerometer)),
        "omegaNoiseRandomWalk": decimal(GYROSCOPE_WALK),
        "accNoiseRandomWalk": decimal(ACCELEROMETER_WALK),
        "timeOffsetMicros": ((1e6 * mounted.shift).round() as i64).to_string(),
        "transformationToC0": texts(to_camera.transpose().as_slice()),
    });
    file.as_object_mut()?.insert("imus".to_owned(), json!({ "S0": unit }));
    Some(format!("{file:#}\n"))
}
