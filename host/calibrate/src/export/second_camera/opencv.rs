//! A pair of cameras as OpenCV's `stereoCalibrate` names it: `cameraMatrix1`, `distCoeffs1`, `cameraMatrix2`, `distCoeffs2`, `R`,
//! `T`, `E`, `F`.
//!
//! x₂ = R x₁ + T maps coordinates of the first camera to coordinates of the second; x₂ᵀ E x₁ = 0 for bearings, m₂ᵀ F m₁ = 0 for
//! undistorted pixels.

use evcal_core::camera::ModelKind;
use nalgebra::Matrix3;

use super::{Pair, clocks};
use crate::export::file_storage::{self, Entry, Value, entry};
use crate::export::opencv::YAML;
use crate::result::calibrated_camera::CalibratedCamera;

/// A camera in OpenCV's terms.
struct Lens {
    /// Family of functions for it: `radtan`, `fisheye`.
    kind: &'static str,
    matrix: Matrix3<f64>,
    distortion: Vec<f64>,
}

/// Writes `stereo.yaml`; `None` if OpenCV has no models for both that can be used together.
pub fn write(pair: &Pair) -> Option<String> {
    let (one, two) = (lens(&pair.first)?, lens(&pair.second)?);
    if one.kind != two.kind {
        return None;
    }
    let rotation = pair.second_first.rotation.to_rotation_matrix().into_inner();
    let place = pair.second_first.translation.vector;
    let essential = place.cross_matrix() * rotation;
    let fundamental = two.matrix.try_inverse()?.transpose() * essential * one.matrix.try_inverse()?;
    // Its scale has no meaning; OpenCV sets the last entry to 1.
    let last = fundamental[(2, 2)];
    let fundamental = if last.abs() > f64::EPSILON { fundamental / last } else { fundamental };
    let matrix = |matrix: Matrix3<f64>| Value::Matrix { rows: 3, values: matrix.transpose().as_slice().to_vec() };
    let mut entries: Vec<Entry> = Vec::new();
    for (number, camera, lens) in [(1, &pair.first, &one), (2, &pair.second, &two)] {
        entries.push(entry(format!("image_width{number}"), Value::Integer(camera.sensor.width.into())));
        entries.push(entry(format!("image_height{number}"), Value::Integer(camera.sensor.height.into())));
        entries.push(entry(format!("cameraMatrix{number}"), matrix(lens.matrix)));
        entries.push(entry(format!("distCoeffs{number}"), Value::row(&lens.distortion)));
    }
    entries.push(entry("distortion_model", Value::Word(one.kind.to_owned())));
    entries.push(entry("R", matrix(rotation)));
    entries.push(entry("T", Value::column(place.as_slice())));
    entries.push(entry("E", matrix(essential)));
    entries.push(entry("F", matrix(fundamental)));
    entries.push(entry("time_offset", Value::Real(pair.result.time_offset.value)));
    let remarks = [
        format!("written by evcal {}; pixel (0, 0) is the centre of the top-left pixel", crate::VERSION),
        pair.result.verdict.replace('±', "+-").replace('µ', "u").replace('°', " degrees").replace('σ', "sigma"),
        "x2 = R x1 + T: from coordinates of the first camera to those of the second, in metres".to_owned(),
        clocks(pair),
    ];
    Some(file_storage::yaml(&remarks, &entries))
}

fn lens(calibrated: &CalibratedCamera) -> Option<Lens> {
    let camera = YAML.export(calibrated).ok()?.camera;
    let kind = match camera.kind() {
        ModelKind::KannalaBrandt => "fisheye",
        // OpenCV's stereo calibration of omnidirectional cameras has other names.
        ModelKind::Omni => return None,
        _ => "radtan",
    };
    let parameters = camera.parameters();
    let (&[fx, fy, cx, cy], distortion) = parameters.split_first_chunk::<4>()?;
    let matrix = Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0);
    Some(Lens { kind, matrix, distortion: distortion.to_vec() })
}
