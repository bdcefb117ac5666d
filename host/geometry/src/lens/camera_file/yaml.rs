//! Camera files of other programs: OpenCV's `FileStorage`, ROS's `camera_info` as a file and as a printed message, DV's XML, the
//! first camera of Kalibr's camchain, EuRoC's `sensor.yaml`, JSON of basalt and dv-processing, and mrcal's `.cameramodel`.
//!
//! A part of a file that changes the projection is read, or the file is rejected by the name of this part. No part is ignored
//! because evcal has no model for it.

mod matrix;
mod named;

use std::borrow::Cow;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use yaml_rust2::Yaml;

use super::{CameraDescription, CameraFile, tree};
use evcal_files::yaml::{self, LoadError};

/// Largest size of a file in bytes. Files of OpenCV's calibration sample contain the points of all views: some 100 kB.
const LARGEST: usize = 4 << 20;

/// Reason why a file of another program is not a camera.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum YamlError {
    /// The text is not YAML, or it is too large or too deep.
    #[error("it cannot be read as JSON or YAML: {0}")]
    NoYaml(LoadError),
    /// The text is not JSON.
    #[error("it cannot be read as JSON: {0}")]
    NoJson(String),
    /// The text is not XML.
    #[error("it cannot be read as XML: {0}")]
    NoXml(String),
    /// The file contains no camera.
    #[error(
        "it is not a camera of OpenCV or ROS (camera_matrix), Kalibr (cam0 with intrinsics), EuRoC (sensor.yaml), basalt, DV or mrcal"
    )]
    NoCamera,
    /// A part of the camera is missing.
    #[error("it has no {0}")]
    Missing(&'static str),
    /// evcal does not support the model.
    #[error("evcal has no model {camera} with distortion {distortion} of {coefficients} coefficients")]
    Model {
        /// Name of the projection.
        camera: String,
        /// Name of the distortion.
        distortion: String,
        /// Number of its coefficients.
        coefficients: usize,
    },
    /// A part of the camera changes its projection in a way that evcal has no model for.
    #[error("evcal has no camera with {0}")]
    Part(String),
    /// The file names two models.
    #[error("{} = {} and {} = {} contradict each other", .0[0], .0[1], .0[2], .0[3])]
    Contradiction([String; 4]),
    /// The coefficients fit two models.
    #[error(
        "its 4 coefficients are those of a fisheye (k1 k2 k3 k4) or of radial and tangential distortion (k1 k2 p1 p2), and it does \
         not say which: add the line distortion_model: \"fisheye\" or distortion_model: \"radtan\""
    )]
    TwoMeanings,
}

/// Reads a camera from the text of a YAML file.
///
/// # Errors
/// [`YamlError`].
pub fn parse(text: &str) -> Result<CameraFile, YamlError> {
    let text = without_optimization_inputs(text);
    // OpenCV's `%YAML:1.0` is not a valid YAML directive.
    let body: String = text.lines().filter(|line| !line.starts_with("%YAML")).flat_map(|line| [line, "\n"]).collect();
    let documents = yaml::load(&body, LARGEST).map_err(YamlError::NoYaml)?;
    camera_of(documents.first().ok_or(YamlError::NoCamera)?)
}

/// Removes the data from which mrcal computed a camera. It is a Python literal, which is not valid YAML: base 85, without
/// quotation marks, and often several megabytes.
fn without_optimization_inputs(text: &str) -> Cow<'_, str> {
    let parts = text.split_once("'optimization_inputs':").and_then(|(before, rest)| {
        let literal = rest.trim_start().strip_prefix("b'")?;
        Some((before, literal.split_once('\'')?.1))
    });
    match parts {
        Some((before, after)) => format!("{before}{}", after.strip_prefix(',').unwrap_or(after)).into(),
        None => text.into(),
    }
}

/// Reads a camera from the text of a JSON file of another program.
///
/// # Errors
/// [`YamlError`].
pub fn parse_json(text: &str) -> Result<CameraFile, YamlError> {
    check_size(text)?;
    camera_of(&tree::of_json(text).map_err(|error| YamlError::NoJson(error.to_string()))?)
}

/// Reads a camera from the text of an XML file.
///
/// # Errors
/// [`YamlError`].
pub fn parse_xml(text: &str) -> Result<CameraFile, YamlError> {
    check_size(text)?;
    camera_of(&tree::of_xml(text).map_err(|error| YamlError::NoXml(error.to_string()))?)
}

fn check_size(text: &str) -> Result<(), YamlError> {
    if text.len() > LARGEST { Err(YamlError::NoYaml(LoadError::TooLong(LARGEST))) } else { Ok(()) }
}

/// Reads the camera in the tree of a file of any supported program.
fn camera_of(document: &Yaml) -> Result<CameraFile, YamlError> {
    let has = |name: &str| !document[name].is_badvalue();
    if has("camera_matrix") {
        return matrix::camera(document, document);
    }
    if has("cam0") {
        return named::kalibr_camera(&document["cam0"]);
    }
    if has("value0") {
        return named::basalt_camera(&document["value0"]);
    }
    if has("cameras") {
        return named::dv_processing_camera(&document["cameras"]["C0"]);
    }
    if has("lensmodel") {
        return named::mrcal_camera(document);
    }
    if has("camera_model") && has("intrinsics") {
        return named::kalibr_camera(document);
    }
    if has("distortion_model") && (has("k") || has("K")) {
        return matrix::message_camera(document);
    }
    // DV: the camera is in a node with a name of its own, next to common settings.
    let nodes = document.as_hash().into_iter().flat_map(|hash| hash.values());
    let camera = nodes.into_iter().find(|node| !node["camera_matrix"].is_badvalue()).ok_or(YamlError::NoCamera)?;
    matrix::camera(camera, document)
}

fn unknown(camera: &str, distortion: &str, coefficients: usize) -> YamlError {
    YamlError::Model { camera: camera.to_owned(), distortion: distortion.to_owned(), coefficients }
}

/// Returns the model of OpenCV's family with these coefficients: 4, 5, 8, or 12 or 14 of which those after the eighth are zero.
/// Without any, the camera is a pinhole.
fn radtan(camera: &str, name: &str, mut coefficients: Vec<f64>) -> Result<(ModelKind, Vec<f64>), YamlError> {
    let kind = match coefficients.len() {
        0 | 4 => ModelKind::Radtan4,
        5 => ModelKind::Radtan,
        8 | 12 | 14 => ModelKind::Radtan8,
        other => return Err(unknown(camera, name, other)),
    };
    let beyond = ["s1", "s2", "s3", "s4", "tau_x", "tau_y"].iter().zip(coefficients.iter().skip(8));
    if let Some((name, value)) = beyond.into_iter().find(|(_, value)| **value != 0.0) {
        return Err(YamlError::Part(format!("a thin prism or a tilted sensor ({name} = {value})")));
    }
    coefficients.resize(kind.parameter_names().len() - 4, 0.0);
    Ok((kind, coefficients))
}

fn file(kind: ModelKind, parameters: &[f64], size: [&Yaml; 2]) -> Result<CameraFile, YamlError> {
    let camera =
        Camera::from_parameters(kind, parameters).ok_or(YamlError::Missing("parameters that its model takes"))?;
    let [width, height] =
        size.map(|size| whole(size).and_then(|size| u16::try_from(size).ok()).filter(|size| *size > 0));
    let sensor = width.zip(height).map(|(width, height)| Sensor::new(width, height));
    let sensor = sensor.ok_or(YamlError::Missing("size of the image in pixels"))?;
    Ok(CameraFile { sensor, camera: CameraDescription::new(&camera) })
}

fn numbers(list: &Yaml) -> Option<Vec<f64>> {
    list.as_vec()?.iter().map(number).collect()
}

fn number(value: &Yaml) -> Option<f64> {
    let written = || value.as_str().and_then(|text| text.parse().ok());
    value.as_f64().or_else(|| value.as_i64().map(|integer| integer as f64)).or_else(written)
}

fn whole(value: &Yaml) -> Option<i64> {
    value.as_i64().or_else(|| value.as_str()?.parse().ok())
}

#[cfg(test)]
mod tests;
