//! Files of a camera with its IMU for other programs, in addition to the files of the camera alone.
//!
//! | file | for | transform | shift |
//! |---|---|---|---|
//! | `camchain-imucam.yaml`, `imu.yaml` | Kalibr | `T_cam_imu`: IMU to camera | t_imu = t_cam + `timeshift_cam_imu` |
//! | `kalibr_imucam_chain.yaml`, `kalibr_imu_chain.yaml` | OpenVINS | `T_imu_cam`: camera to IMU | the same |
//! | `vins-fusion.yaml` | VINS-Fusion, VINS-Mono | `body_T_cam0`: camera to IMU | t_imu = t_cam + `td` |
//! | `basalt-imu.json` | basalt | `T_imu_cam`: camera to IMU | t_imu = t_cam + `cam_time_offset_ns` |
//! | `dv-processing-imu.json` | dv-processing | `transformationToC0`: IMU to camera | t_cam = t_imu − `timeOffsetMicros` |
//! | `static_transform.yaml` | ROS | frame of the camera in the frame of the IMU: camera to IMU | none |
//!
//! The delay of the gyroscope is written, because all formats have one delay for both sensors.

mod basalt;
mod dv_processing;
mod kalibr;
mod openvins;
mod static_transform;
mod vins_fusion;

use std::fmt::Write as _;

use nalgebra::Matrix4;

use super::number::{decimal, decimals};
use crate::result::calibrated_camera::CalibratedCamera;
use crate::result::inertial_result::{InertialResult, SensorResult};
use crate::result::second_camera_result::SecondCameraResult;
use evcal_geometry::numerics::rigid::pose_of_rows;

/// Random walk of the gyroscope's bias for typical chips, because it is not measured (rad/s²/√Hz).
const GYROSCOPE_WALK: f64 = 2e-5;
/// The same for the accelerometer (m/s³/√Hz).
const ACCELEROMETER_WALK: f64 = 1e-3;
const TOPIC: &str = "/dvs/imu";

/// An IMU with its camera.
struct Mounted<'a> {
    camera: &'a CalibratedCamera,
    inertial: &'a InertialResult,
    /// Other cameras on the mount.
    others: &'a [SecondCameraResult],
    /// `T_imu_camera`, row by row; `None` if it was not measured.
    imu_from_camera: Option<[[f64; 4]; 4]>,
    /// t_imu = t_cam + shift (s).
    shift: f64,
    /// Samples per second.
    rate: f64,
    /// `camchain.yaml` of the camera.
    camchain: Option<&'a str>,
    /// `basalt.json` of the camera.
    basalt: Option<&'a str>,
    /// `dv-processing.json` of the camera.
    dv_processing: Option<&'a str>,
}

/// A file, by its name.
struct File {
    name: &'static str,
    write: fn(&Mounted) -> Option<String>,
}

const FILES: [File; 8] = [
    File { name: "camchain-imucam.yaml", write: kalibr::camchain },
    File { name: "imu.yaml", write: kalibr::imu },
    File { name: "kalibr_imucam_chain.yaml", write: openvins::camera },
    File { name: "kalibr_imu_chain.yaml", write: openvins::unit },
    File { name: "vins-fusion.yaml", write: vins_fusion::write },
    File { name: "basalt-imu.json", write: basalt::write },
    File { name: "dv-processing-imu.json", write: dv_processing::write },
    File { name: "static_transform.yaml", write: static_transform::write },
];

/// Returns the names of all files.
pub fn names() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|file| file.name)
}

/// Returns name and content of each file that supports camera and IMU, Kalibr's with the `others` on the mount. If the position
/// of the IMU was not measured, only files that do not contain it are returned.
pub fn files(
    camera: &CalibratedCamera,
    inertial: &InertialResult,
    others: &[SecondCameraResult],
) -> Vec<(&'static str, String)> {
    // The IMU's parameters match the intrinsics of its solve; older files contain these only if they were fixed.
    let with_unit = inertial.solved_together.as_ref().or(inertial.fixed_camera.as_ref());
    let with_unit = with_unit.and_then(|known| known.camera().ok());
    let camera = &CalibratedCamera { camera: with_unit.unwrap_or(camera.camera), ..camera.clone() };
    let text = |format: &super::content::ExportFormat| format.export(camera).ok().map(|exported| exported.text);
    let (camchain, basalt) = (text(&super::kalibr::FORMAT), text(&super::basalt::FORMAT));
    let dv_processing = text(&super::dv_processing::FORMAT);
    let rate = inertial.streams.iter().map(|stream| stream.rate).fold(0.0, f64::max);
    let mounted = Mounted {
        camera,
        inertial,
        others,
        imu_from_camera: inertial.imu_from_camera,
        shift: inertial.gyroscope.delay.value + inertial.clock_origin,
        rate: (rate * 1e3).round() * 1e-3,
        camchain: camchain.as_deref(),
        basalt: basalt.as_deref(),
        dv_processing: dv_processing.as_deref(),
    };
    FILES.iter().filter_map(|file| Some((file.name, (file.write)(&mounted)?))).collect()
}

/// Returns `T_camera_imu` from `T_imu_camera`.
fn camera_from_imu(rows: &[[f64; 4]; 4]) -> Matrix4<f64> {
    pose_of_rows(rows).inverse().to_homogeneous()
}

fn mean(sensor: &SensorResult) -> f64 {
    sensor.noise_density.iter().sum::<f64>() / 3.0
}

/// Writes noise and random walks under the names of Kalibr.
fn noise_lines(inertial: &InertialResult, indent: &str) -> String {
    let mut text = String::new();
    for (name, value) in [
        ("accelerometer_noise_density", mean(&inertial.accelerometer)),
        ("accelerometer_random_walk", ACCELEROMETER_WALK),
        ("gyroscope_noise_density", mean(&inertial.gyroscope)),
        ("gyroscope_random_walk", GYROSCOPE_WALK),
    ] {
        let _ = writeln!(text, "{indent}{name}: {}", decimal(value));
    }
    text
}

fn matrix_rows<const N: usize>(matrix: &[[f64; N]; N], indent: &str) -> String {
    matrix.iter().map(|row| format!("{indent}- [{}]\n", decimals(row))).collect()
}

#[cfg(test)]
mod tests;
