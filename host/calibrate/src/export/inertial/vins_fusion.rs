//! VINS-Fusion (and VINS-Mono): the calibration entries of its configuration, as `cv::FileStorage` reads them.
//!
//! `body_T_cam0` maps camera coordinates to IMU coordinates. `td` is added to a timestamp of the camera to get the IMU's. Its
//! model has no scale and no misalignment: the noise has to cover errors of both, unless the readings are corrected before.
//!
//! Noise is given per sample, not as densities. `integration_base.h` adds the noise of two readings to a step of dt, each over
//! half of dt, which adds 2 (dt/2)² `acc_n`² to the variance of a velocity; a density σ adds σ² dt. With dt = 1/rate, `acc_n` = σ
//! √(2 rate). A bias walks by dt `acc_w` per step, while a density σ adds σ² dt to its variance: `acc_w` = σ √rate.

use std::fmt::Write as _;

use super::{ACCELEROMETER_WALK, GYROSCOPE_WALK, Mounted, mean};
use crate::export::number::{decimal, decimals, quoted};

/// Writes `vins-fusion.yaml`.
pub fn write(mounted: &Mounted) -> Option<String> {
    let inertial = mounted.inertial;
    let gravity = inertial.gravity.iter().map(|value| value * value).sum::<f64>().sqrt();
    let mut text =
        "%YAML:1.0\n---\n# Entries for the configuration of VINS-Fusion.\nimu: 1\nnum_of_cam: 1\n".to_owned();
    let _ = writeln!(text, "imu_topic: {}\nimage0_topic: {}", quoted(super::TOPIC), quoted(&mounted.camera.ros_topic));
    let _ =
        writeln!(text, "image_width: {}\nimage_height: {}", mounted.camera.sensor.width, mounted.camera.sensor.height);
    text += "# From the camera's coordinates to the unit's.\nestimate_extrinsic: 0\nbody_T_cam0: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n";
    let _ = writeln!(text, "   data: [{}]", decimals(&mounted.imu_from_camera?.concat()));
    let _ = writeln!(text, "# t_imu = t_cam + td (gyroscope)\nestimate_td: 0\ntd: {}", decimal(mounted.shift));
    let _ = writeln!(
        text,
        "# Of a sample at {} Hz: densities times the root of twice the rate, random walks times the root of the rate.",
        decimal(mounted.rate)
    );
    let _ = writeln!(text, "# Random walks are not measured: they are those of usual chips.");
    let (noise, walk) = ((2.0 * mounted.rate).sqrt(), mounted.rate.sqrt());
    let _ = writeln!(
        text,
        "acc_n: {}\ngyr_n: {}",
        decimal(noise * mean(&inertial.accelerometer)),
        decimal(noise * mean(&inertial.gyroscope))
    );
    let _ = writeln!(text, "acc_w: {}\ngyr_w: {}", decimal(walk * ACCELEROMETER_WALK), decimal(walk * GYROSCOPE_WALK));
    let _ = writeln!(text, "g_norm: {}", decimal(gravity));
    Some(text)
}
