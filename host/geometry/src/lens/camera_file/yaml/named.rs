//! Cameras whose parameters are a list or have names: Kalibr, EuRoC, basalt, dv-processing and mrcal.

use evcal_core::camera::ModelKind;
use yaml_rust2::Yaml;

use super::{YamlError, file, number, numbers, radtan, unknown};
use crate::lens::camera_file::CameraFile;

/// Reads Kalibr's form, where the shape of the projection precedes its focal lengths, and EuRoC's, which has other names.
pub(super) fn kalibr_camera(camera: &Yaml) -> Result<CameraFile, YamlError> {
    let intrinsics = numbers(&camera["intrinsics"]).ok_or(YamlError::Missing("intrinsics in numbers"))?;
    let coefficients = ["distortion_coeffs", "distortion_coefficients"].map(|name| &camera[name]);
    let coefficients = coefficients.into_iter().find(|list| !list.is_badvalue());
    let coefficients = match coefficients {
        Some(list) => numbers(list).ok_or(YamlError::Missing("distortion coefficients in numbers"))?,
        None => Vec::new(),
    };
    let projection = camera["camera_model"].as_str().unwrap_or("pinhole");
    let name = camera["distortion_model"].as_str().unwrap_or("none");
    let (kind, shape) = match (projection, name, coefficients.len()) {
        ("pinhole", "radtan" | "radial-tangential", 4) | ("pinhole", "none", 0) => (ModelKind::Radtan4, 0),
        ("pinhole", "equidistant", 4) => (ModelKind::KannalaBrandt, 0),
        ("pinhole", "fov", 1) => (ModelKind::Fov, 0),
        ("omni", "radtan", 4) | ("omni", "none", 0) => (ModelKind::Omni, 1),
        ("eucm", "none", 0) => (ModelKind::Eucm, 2),
        ("ds", "none", 0) => (ModelKind::DoubleSphere, 2),
        _ => return Err(unknown(projection, name, coefficients.len())),
    };
    let (shape, matrix) = intrinsics.split_at_checked(shape).ok_or(YamlError::Missing("intrinsics of its model"))?;
    let size = [&camera["resolution"][0], &camera["resolution"][1]];
    let zeros: &[f64] = if name == "none" && shape.len() < 2 { &[0.0; 4] } else { &[] };
    file(kind, &[matrix, shape, &coefficients, zeros].concat(), size)
}

/// Reads basalt's form: parameters by name. `rpmax` of `pinhole-radtan8` limits the region where basalt uses the model, and
/// changes no pixel.
pub(super) fn basalt_camera(value: &Yaml) -> Result<CameraFile, YamlError> {
    let camera = &value["intrinsics"][0];
    let name = camera["camera_type"].as_str().ok_or(YamlError::Missing("camera_type"))?;
    let (kind, absent) = match name {
        "pinhole" => (ModelKind::Radtan4, 4),
        "pinhole-radtan8" => (ModelKind::Radtan8, 0),
        "kb4" => (ModelKind::KannalaBrandt, 0),
        "ucm" => (ModelKind::Ucm, 0),
        "eucm" => (ModelKind::Eucm, 0),
        "ds" => (ModelKind::DoubleSphere, 0),
        "fov" => (ModelKind::Fov, 0),
        _ => return Err(unknown(name, "none", 0)),
    };
    let names = kind.parameter_names();
    let named = names.iter().take(names.len() - absent).map(|name| number(&camera["intrinsics"][*name]));
    let mut parameters = named.collect::<Option<Vec<f64>>>().ok_or(YamlError::Missing("intrinsics of its model"))?;
    parameters.resize(names.len(), 0.0);
    file(kind, &parameters, [&value["resolution"][0][0], &value["resolution"][0][1]])
}

/// Reads dv-processing's form: every number is text.
pub(super) fn dv_processing_camera(camera: &Yaml) -> Result<CameraFile, YamlError> {
    let list = |name: &str, missing| numbers(&camera[name]).ok_or(YamlError::Missing(missing));
    let focal = list("focalLength", "cameras.C0 with focalLength")?;
    let center = list("principalPoint", "principalPoint")?;
    let name = camera["distortionModel"].as_str().unwrap_or_default();
    // An empty list is written as an empty text.
    let coefficients = match name {
        "none" if camera["distortionCoefficients"].as_str() == Some("") => Vec::new(),
        _ => list("distortionCoefficients", "distortionCoefficients")?,
    };
    let (kind, coefficients) = match (name, coefficients.len()) {
        ("radialTangential", 4 | 5) | ("none", 0) => radtan("pinhole", name, coefficients)?,
        ("equidistant", 4) => (ModelKind::KannalaBrandt, coefficients),
        _ => return Err(unknown("pinhole", name, coefficients.len())),
    };
    file(kind, &[focal, center, coefficients].concat(), [&camera["resolution"][0], &camera["resolution"][1]])
}

/// Reads mrcal's form.
pub(super) fn mrcal_camera(document: &Yaml) -> Result<CameraFile, YamlError> {
    let intrinsics = numbers(&document["intrinsics"]).ok_or(YamlError::Missing("intrinsics in numbers"))?;
    let name = document["lensmodel"].as_str().unwrap_or_default();
    let (matrix, coefficients) = intrinsics.split_at_checked(4).ok_or(YamlError::Missing("intrinsics of its model"))?;
    let expected = match name.strip_prefix("LENSMODEL_") {
        Some("PINHOLE") => Some(0),
        Some(opencv) => opencv.strip_prefix("OPENCV").and_then(|count| count.parse().ok()),
        None => None,
    };
    if expected != Some(coefficients.len()) {
        return Err(unknown(name, "none", coefficients.len()));
    }
    let (kind, coefficients) = radtan(name, "none", coefficients.to_vec())?;
    file(kind, &[matrix, &coefficients].concat(), [&document["imagersize"][0], &document["imagersize"][1]])
}
