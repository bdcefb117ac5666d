//! Kalibr's `camchain.yaml` of several cameras, as `kalibr_common/ConfigReader.py` reads it.
//!
//! `T_cn_cnm1` maps coordinates of the previous camera to coordinates of this one. The format has a time shift only against an
//! IMU (`timeshift_cam_imu`); the offset between cameras is in a comment.

use std::fmt::Write as _;

use nalgebra::Isometry3;

use super::{Pair, clocks};
use crate::export::kalibr::FORMAT;
use crate::export::number::decimals;
use crate::result::calibrated_camera::CalibratedCamera;

/// Writes `camchain-cameras.yaml`; `None` if the format does not support the model of a camera, or there is no second one.
pub fn write(pairs: &[Pair]) -> Option<String> {
    let others: Vec<usize> = (1..=pairs.len()).collect();
    Some(camera(&pairs.first()?.first, 0, &others)? + &self::others(pairs)?.concat())
}

/// Writes the parts of all cameras except the first.
pub fn others(pairs: &[Pair]) -> Option<Vec<String>> {
    let mut before = Isometry3::identity();
    let mut parts = Vec::new();
    for (index, pair) in pairs.iter().enumerate() {
        let mut text = camera(&pair.second, index + 1, &[0])?;
        let from_before = pair.second_first * before.inverse();
        let _ = writeln!(text, "  # from the coordinates of cam{index} to those of cam{}\n  T_cn_cnm1:", index + 1);
        let rows = <[[f64; 4]; 4]>::from(from_before.to_homogeneous().transpose());
        rows.iter().for_each(|row| text += &format!("  - [{}]\n", decimals(row)));
        let _ = writeln!(text, "  # cam0 is the first, cam{} the second camera here: {}", index + 1, clocks(pair));
        before = pair.second_first;
        parts.push(text);
    }
    Some(parts)
}

/// Writes the part of camera number `number`, whose views overlap with views of the cameras `with`.
fn camera(calibrated: &CalibratedCamera, number: usize, with: &[usize]) -> Option<String> {
    let topic = if number == 0 { calibrated.ros_topic.clone() } else { format!("/dvs{number}/image_raw") };
    let named = CalibratedCamera { ros_topic: topic, ..calibrated.clone() };
    let with: Vec<String> = with.iter().map(ToString::to_string).collect();
    let text = FORMAT.export(&named).ok()?.text;
    Some(text.replacen("cam0:", &format!("cam{number}:"), 1).replacen(
        "cam_overlaps: []",
        &format!("cam_overlaps: [{}]", with.join(", ")),
        1,
    ))
}
