//! Files of several cameras on one mount for other programs, in addition to the files of the first camera alone.
//!
//! | file | for | transform |
//! |---|---|---|
//! | `camchain-cameras.yaml` | Kalibr | `T_cn_cnm1`: from the previous camera to this one |
//! | `stereo.yaml` | OpenCV, as from `stereoCalibrate` | x₂ = `R` x₁ + `T`: from the first camera to the second |
//! | `static_transforms.yaml` | ROS | frame of the second camera in the frame of the first: from the second to the first |
//!
//! The parameters of the cameras come from the joint solve of both, because these match the transform. Only ROS and
//! Kalibr support more than two cameras: each further one has a `stereo-2.yaml` and so on.

mod kalibr;
mod opencv;
mod static_transforms;

use nalgebra::Isometry3;

use crate::result::calibrated_camera::CalibratedCamera;
use crate::result::second_camera_result::{SecondCameraResult, SolvedCamera};
use evcal_geometry::lens::camera_file::DescriptionError;
use evcal_geometry::lens::covered_region::CoveredRegion;

/// Name of the OpenCV file of a pair; those after the first have a number in between.
const STEREO: (&str, &str) = ("stereo", "yaml");
const CAMCHAIN: &str = "camchain-cameras.yaml";
const STATIC_TRANSFORMS: &str = "static_transforms.yaml";

/// Two cameras on a mount.
struct Pair<'a> {
    first: CalibratedCamera,
    second: CalibratedCamera,
    /// `T_second_first`.
    second_first: Isometry3<f64>,
    result: &'a SecondCameraResult,
}

/// Returns `true` if [`files`] contains a file of this name.
pub fn is_file(name: &str) -> bool {
    let numbered = name.strip_prefix(STEREO.0).and_then(|rest| rest.strip_suffix(STEREO.1)?.strip_suffix('.'));
    let numbered = numbered.is_some_and(|rest| {
        rest.is_empty() || rest.strip_prefix('-').is_some_and(|number| number.parse::<u32>().is_ok())
    });
    numbered || name == CAMCHAIN || name == STATIC_TRANSFORMS
}

/// Returns name and content of each file that supports the cameras. `first` is the separate calibration of the first camera.
///
/// # Errors
/// [`DescriptionError`] if a camera of `others` is invalid.
pub fn files(
    first: &CalibratedCamera,
    others: &[SecondCameraResult],
) -> Result<Vec<(String, String)>, DescriptionError> {
    // The first camera's own frames are not another camera.
    let others = others.iter().filter(|result| result.from_identity.is_none());
    let pairs = others.map(|result| pair(first, result)).collect::<Result<Vec<_>, _>>()?;
    let mut files = Vec::new();
    files.extend(kalibr::write(&pairs).map(|text| (CAMCHAIN.to_owned(), text)));
    if !pairs.is_empty() {
        files.push((STATIC_TRANSFORMS.to_owned(), static_transforms::write(&pairs)));
    }
    for (index, pair) in pairs.iter().enumerate() {
        let (name, extension) = STEREO;
        let name = if index == 0 { format!("{name}.{extension}") } else { format!("{name}-{}.{extension}", index + 1) };
        files.extend(opencv::write(pair).map(|text| (name, text)));
    }
    Ok(files)
}

/// Another camera in Kalibr's file of cameras with an IMU.
pub(super) struct KalibrOther {
    /// Its part of the file, without the IMU.
    pub text: String,
    /// `T_camera_first`.
    pub from_first: Isometry3<f64>,
    /// t_camera = t_first + offset (s).
    pub time_offset: f64,
}

/// Returns the other cameras for Kalibr; empty if Kalibr has no model for one of them, because cameras are numbered.
pub(super) fn kalibr_others(first: &CalibratedCamera, others: &[SecondCameraResult]) -> Vec<KalibrOther> {
    let others = others.iter().filter(|result| result.from_identity.is_none());
    let pairs: Option<Vec<Pair>> = others.map(|result| pair(first, result).ok()).collect();
    let parts = pairs.and_then(|pairs| Some((kalibr::others(&pairs)?, pairs)));
    let Some((texts, pairs)) = parts else { return Vec::new() };
    let one = |(text, pair): (String, &Pair)| KalibrOther {
        text,
        from_first: pair.second_first,
        time_offset: pair.result.time_offset.value,
    };
    texts.into_iter().zip(&pairs).map(one).collect()
}

fn pair<'a>(first: &CalibratedCamera, result: &'a SecondCameraResult) -> Result<Pair<'a>, DescriptionError> {
    let solved = |SolvedCamera { sensor, camera }: &SolvedCamera| {
        Ok(CalibratedCamera::seen_everywhere(camera.camera()?, *sensor))
    };
    let [of_first, of_second] = &result.solved_together;
    let corners = result.covered_region.iter().map(|&corner| corner.into());
    let verdict = &result.verdict;
    Ok(Pair {
        first: CalibratedCamera { covered: first.covered.clone(), verdict: verdict.clone(), ..solved(of_first)? },
        second: CalibratedCamera {
            covered: CoveredRegion::around(corners, result.sensor),
            verdict: verdict.clone(),
            ..solved(of_second)?
        },
        second_first: result.pose(),
        result,
    })
}

/// Describes the clocks, for formats without entries for them.
fn clocks(pair: &Pair) -> String {
    let offset = pair.result.time_offset.value;
    let offset = format!("{} {:.9}", if offset < 0.0 { '-' } else { '+' }, offset.abs());
    match pair.result.frames {
        Some(frames) if frames.rolling_shutter => format!(
            "t_second = t_first {offset} s (of the middle row of a frame), line delay {} s",
            frames.line_delay.value
        ),
        Some(_) => format!("t_second = t_first {offset} s (timestamps of events and of a frame of the same moment)"),
        None => format!("t_second = t_first {offset} s (timestamps of events of the same moment)"),
    }
}

#[cfg(test)]
pub(super) mod tests;
