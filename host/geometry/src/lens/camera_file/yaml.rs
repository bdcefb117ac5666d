//! Camera files of other programs: OpenCV's `FileStorage`, ROS's `camera_info`, DV's XML, the first camera of Kalibr's
//! camchain, JSON of basalt and dv-processing, and mrcal's `.cameramodel`, which is valid YAML.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use yaml_rust2::Yaml;

use super::{CameraDescription, CameraFile, tree};
use evcal_files::yaml::{self, LoadError};

/// Largest size of a file in bytes.
const LARGEST: usize = 1 << 16;

/// Reason why a file of another program is not a camera.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum YamlError {
    /// The text is not YAML.
    #[error("it cannot be read as JSON or YAML: {0}")]
    NoYaml(String),
    /// The text is not XML.
    #[error("it cannot be read as XML: {0}")]
    NoXml(String),
    /// The file contains no camera.
    #[error("it is not a camera of OpenCV, ROS (camera_matrix), Kalibr (cam0 with intrinsics), basalt, DV or mrcal")]
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
}

/// Reads a camera from the text of a YAML file.
///
/// # Errors
/// [`YamlError`].
pub fn parse(text: &str) -> Result<CameraFile, YamlError> {
    // OpenCV's `%YAML:1.0` is not a valid YAML directive.
    let body: String = text.lines().filter(|line| !line.starts_with("%YAML")).flat_map(|line| [line, "\n"]).collect();
    let documents = yaml::load(&body, LARGEST).map_err(|error| match error {
        LoadError::Syntax(error) => YamlError::NoYaml(error),
        // No camera file is larger, deeper or more repetitive.
        _ => YamlError::NoCamera,
    })?;
    camera_of(documents.first().ok_or(YamlError::NoCamera)?)
}

/// Reads a camera from the text of a JSON file of another program.
///
/// # Errors
/// [`YamlError`].
pub fn parse_json(text: &str) -> Result<CameraFile, YamlError> {
    camera_of(&tree::of_json(text).map_err(|error| YamlError::NoYaml(error.to_string()))?)
}

/// Reads a camera from the text of an XML file.
///
/// # Errors
/// [`YamlError`].
pub fn parse_xml(text: &str) -> Result<CameraFile, YamlError> {
    camera_of(&tree::of_xml(text).map_err(|error| YamlError::NoXml(error.to_string()))?)
}

/// Reads the camera in the tree of a file of any supported program.
fn camera_of(document: &Yaml) -> Result<CameraFile, YamlError> {
    let has = |name: &str| !document[name].is_badvalue();
    if has("camera_matrix") {
        return matrix_camera(document, document["distortion_model"].as_str().unwrap_or("radtan"));
    }
    if has("cam0") {
        return kalibr_camera(&document["cam0"]);
    }
    if has("value0") {
        return basalt_camera(&document["value0"]);
    }
    if has("cameras") {
        return dv_processing_camera(&document["cameras"]["C0"]);
    }
    if has("lensmodel") {
        return mrcal_camera(document);
    }
    // DV: the camera is in a node with a name of its own, next to common settings.
    let nodes = document.as_hash().into_iter().flat_map(|hash| hash.values());
    let camera = nodes.into_iter().find(|node| !node["camera_matrix"].is_badvalue()).ok_or(YamlError::NoCamera)?;
    let is_fisheye = document["use_fisheye_model"].as_i64() == Some(1);
    matrix_camera(camera, if is_fisheye { "fisheye" } else { "radtan" })
}

/// Reads the form of OpenCV and ROS.
fn matrix_camera(document: &Yaml, name: &str) -> Result<CameraFile, YamlError> {
    let matrix = numbers(&document["camera_matrix"]["data"]).ok_or(YamlError::Missing("camera_matrix with data"))?;
    let &[fx, _, cx, _, fy, cy, ..] = matrix.as_slice() else {
        return Err(YamlError::Missing("camera_matrix of 9 numbers"));
    };
    let coefficients = numbers(&document["distortion_coefficients"]["data"]);
    let mut coefficients = coefficients.ok_or(YamlError::Missing("distortion_coefficients with data"))?;
    let kind = match (name, coefficients.len()) {
        ("radtan" | "plumb_bob", 4) => Some(ModelKind::Radtan4),
        ("radtan" | "plumb_bob", 5) => Some(ModelKind::Radtan),
        ("radtan" | "rational_polynomial", 8) => Some(ModelKind::Radtan8),
        ("fisheye" | "equidistant", 4) => Some(ModelKind::KannalaBrandt),
        ("omnidir", 4) => Some(ModelKind::Omni),
        _ => None,
    };
    let kind = kind.ok_or_else(|| unknown("pinhole", name, coefficients.len()))?;
    if kind == ModelKind::Omni {
        coefficients.insert(0, number(&document["xi"]).ok_or(YamlError::Missing("xi"))?);
    }
    let size = [&document["image_width"], &document["image_height"]];
    file(kind, &[&[fx, fy, cx, cy], coefficients.as_slice()].concat(), size)
}

/// Reads Kalibr's form: the shape of the projection precedes its focal lengths.
fn kalibr_camera(camera: &Yaml) -> Result<CameraFile, YamlError> {
    let intrinsics = numbers(&camera["intrinsics"]).ok_or(YamlError::Missing("intrinsics in numbers"))?;
    let distortion = numbers(&camera["distortion_coeffs"]).unwrap_or_default();
    let projection = camera["camera_model"].as_str().unwrap_or("pinhole");
    let name = camera["distortion_model"].as_str().unwrap_or("none");
    let (kind, shape) = match (projection, name, distortion.len()) {
        ("pinhole", "radtan", 4) => (ModelKind::Radtan4, 0),
        ("pinhole", "equidistant", 4) => (ModelKind::KannalaBrandt, 0),
        ("pinhole", "fov", 1) => (ModelKind::Fov, 0),
        ("omni", "radtan", 4) => (ModelKind::Omni, 1),
        ("eucm", "none", 0) => (ModelKind::Eucm, 2),
        ("ds", "none", 0) => (ModelKind::DoubleSphere, 2),
        _ => return Err(unknown(projection, name, distortion.len())),
    };
    let (shape, matrix) = intrinsics.split_at_checked(shape).ok_or(YamlError::Missing("intrinsics of its model"))?;
    file(kind, &[matrix, shape, &distortion].concat(), [&camera["resolution"][0], &camera["resolution"][1]])
}

/// Reads basalt's form: parameters by name.
fn basalt_camera(value: &Yaml) -> Result<CameraFile, YamlError> {
    let camera = &value["intrinsics"][0];
    let name = camera["camera_type"].as_str().ok_or(YamlError::Missing("camera_type"))?;
    let kind = match name {
        "kb4" => ModelKind::KannalaBrandt,
        "ucm" => ModelKind::Ucm,
        "eucm" => ModelKind::Eucm,
        "ds" => ModelKind::DoubleSphere,
        "fov" => ModelKind::Fov,
        _ => return Err(unknown(name, "none", 0)),
    };
    let named = kind.parameter_names().iter().map(|name| number(&camera["intrinsics"][*name]));
    let parameters = named.collect::<Option<Vec<f64>>>().ok_or(YamlError::Missing("intrinsics of its model"))?;
    file(kind, &parameters, [&value["resolution"][0][0], &value["resolution"][0][1]])
}

/// Reads dv-processing's form: every number is text.
fn dv_processing_camera(camera: &Yaml) -> Result<CameraFile, YamlError> {
    let list = |name: &str, missing| numbers(&camera[name]).ok_or(YamlError::Missing(missing));
    let focal = list("focalLength", "cameras.C0 with focalLength")?;
    let center = list("principalPoint", "principalPoint")?;
    let coefficients = list("distortionCoefficients", "distortionCoefficients")?;
    let name = camera["distortionModel"].as_str().unwrap_or_default();
    let kind = match (name, coefficients.len()) {
        ("radialTangential", 4) => ModelKind::Radtan4,
        ("radialTangential", 5) => ModelKind::Radtan,
        ("equidistant", 4) => ModelKind::KannalaBrandt,
        _ => return Err(unknown("pinhole", name, coefficients.len())),
    };
    file(kind, &[focal, center, coefficients].concat(), [&camera["resolution"][0], &camera["resolution"][1]])
}

/// Reads mrcal's form.
fn mrcal_camera(document: &Yaml) -> Result<CameraFile, YamlError> {
    let intrinsics = numbers(&document["intrinsics"]).ok_or(YamlError::Missing("intrinsics in numbers"))?;
    let name = document["lensmodel"].as_str().unwrap_or_default();
    let kind = match name {
        "LENSMODEL_OPENCV4" => ModelKind::Radtan4,
        "LENSMODEL_OPENCV5" => ModelKind::Radtan,
        "LENSMODEL_OPENCV8" => ModelKind::Radtan8,
        _ => return Err(unknown(name, "none", intrinsics.len().saturating_sub(4))),
    };
    file(kind, &intrinsics, [&document["imagersize"][0], &document["imagersize"][1]])
}

fn unknown(camera: &str, distortion: &str, coefficients: usize) -> YamlError {
    YamlError::Model { camera: camera.to_owned(), distortion: distortion.to_owned(), coefficients }
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
mod tests {
    use super::*;

    fn read(text: &str) -> (String, Vec<f64>, Sensor) {
        let CameraFile { sensor, camera } = parse(text).unwrap();
        (camera.model.clone(), camera.camera().unwrap().parameters().to_vec(), sensor)
    }

    /// The form of `cv::FileStorage`.
    const OPENCV: &str = "%YAML:1.0\n---\nimage_width: 346\nimage_height: 260\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   \
        cols: 3\n   dt: d\n   data: [ 250.5, 0., 172., 0., 251., 129.5, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   \
        rows: 1\n   cols: 5\n   dt: d\n   data: [ -3.5e-01, 1.2e-01, 1.0e-03, -2.0e-03,\n       4.0e-02 ]\n";

    #[test]
    fn the_files_of_opencv_ros_and_kalibr_are_cameras() {
        let parameters = vec![250.5, 251.0, 172.0, 129.5, -0.35, 0.12, 0.001, -0.002, 0.04];
        assert_eq!(read(OPENCV), ("radtan".to_owned(), parameters, Sensor::new(346, 260)));
        let ros = "image_width: 640\nimage_height: 480\ncamera_name: dvs\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
            data: [300, 0, 320, 0, 301, 240, 0, 0, 1]\ndistortion_model: equidistant\ndistortion_coefficients:\n  rows: 1\n  \
            cols: 4\n  data: [0.1, 0.02, 0, -0.003]\n";
        let parameters = vec![300.0, 301.0, 320.0, 240.0, 0.1, 0.02, 0.0, -0.003];
        assert_eq!(read(ros), ("kannala-brandt".to_owned(), parameters, Sensor::new(640, 480)));
        let kalibr = "cam0:\n  camera_model: ds\n  intrinsics: [-0.2, 0.6, 157.0, 158.0, 172.0, 129.0]\n  \
            distortion_model: none\n  distortion_coeffs: []\n  resolution: [346, 260]\n  rostopic: /dvs\n";
        let parameters = vec![157.0, 158.0, 172.0, 129.0, -0.2, 0.6];
        assert_eq!(read(kalibr), ("double-sphere".to_owned(), parameters, Sensor::new(346, 260)));
    }

    #[test]
    fn missing_parts_are_named() {
        for (text, part) in [
            ("a: 1\n", "not a camera of OpenCV, ROS"),
            ("", "not a camera of OpenCV, ROS"),
            ("a: [1, 2\n", "cannot be read as JSON or YAML"),
            (&OPENCV.replace("image_width: 346\n", ""), "size of the image"),
            (&OPENCV.replace("distortion_coefficients", "other"), "distortion_coefficients"),
            (&OPENCV.replace("-2.0e-03,\n       4.0e-02", "0, 0, 0"), "of 6 coefficients"),
            (&OPENCV.replace("250.5", "-250.5"), "parameters that its model takes"),
            ("cam0: {intrinsics: [1], camera_model: ds}\n", "intrinsics of its model"),
            ("value0: {intrinsics: [{camera_type: ds, intrinsics: {fx: 1}}]}\n", "intrinsics of its model"),
            ("value0: {}\n", "camera_type"),
            ("cameras: {}\n", "focalLength"),
            ("lensmodel: LENSMODEL_SPLINED_STEREOGRAPHIC\nintrinsics: [1, 1, 1, 1]\n", "LENSMODEL_SPLINED"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn excessive_nesting_and_repetition_are_rejected() {
        let bomb: String =
            (1..20).map(|level| format!("a{level}: &a{level} [{}]\n", format!("*a{},", level - 1).repeat(9))).collect();
        assert_eq!(parse(&format!("a0: &a0 1\n{bomb}")), Err(YamlError::NoCamera));
        for nested in ["[", "{a: ", "- ", "? "] {
            assert!(parse(&nested.repeat(LARGEST / nested.len() - 1)).is_err());
        }
    }

    #[test]
    fn truncated_files_do_not_panic() {
        for end in 0..OPENCV.len() {
            let _ = parse(&OPENCV[..end]);
        }
    }
}
