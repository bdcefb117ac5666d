//! Camera files: the part of `calibration.json` and `truth.json` that describes the lens, and the camera files of other
//! programs ([`yaml`]).

mod parameters;
mod tree;
pub mod yaml;

use std::io;
use std::path::{Path, PathBuf};

use evcal_core::camera::{Camera, ModelKind};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};

pub use self::parameters::Parameters;
use evcal_core::sensor::Sensor;

/// A camera model with its parameters by name. Pixel (0, 0) is the centre of the top-left pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraDescription {
    /// Name of the model, for example `radtan`.
    pub model: String,
    /// Parameters by name, in the model's order: `fx`, `fy`, `cx`, `cy` in pixels and the distortion coefficients. A
    /// file may list them in any order.
    pub parameters: Parameters,
}

/// The part of a JSON file that this module reads; other keys are ignored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraFile {
    /// Size of the sensor.
    pub sensor: Sensor,
    /// The lens.
    pub camera: CameraDescription,
}

/// Layout version that is written, and the latest that can be read.
pub const LATEST_VERSION: u32 = 1;

/// Largest size of a camera file in bytes. mrcal writes all its observations into its files: megabytes.
const LARGEST: u64 = 64 << 20;

/// Example of a camera file, shown in errors.
pub const CAMERA_FORM: &str = r#"{"sensor": {"width": 346, "height": 260}, "camera": {"model": "radtan4", "parameters": {"fx": 250.1, "fy": 250.3, "cx": 172.5, "cy": 129.8, "k1": -0.35, "k2": 0.12, "p1": 0.0, "p2": 0.0}}}"#;

/// Files of a folder that describe its camera, in order of preference.
const CAMERA_FILES: [&str; 2] = ["calibration.json", "truth.json"];

/// Returns the camera file for `path`: the file itself, or the camera file in the folder of a calibration or
/// simulation.
pub fn camera_path(path: &Path) -> PathBuf {
    if !path.is_dir() {
        return path.to_owned();
    }
    let candidates = CAMERA_FILES.map(|name| path.join(name));
    let found = candidates.iter().find(|candidate| candidate.exists()).or(candidates.first());
    found.cloned().unwrap_or_else(|| path.to_owned())
}

/// Reason why a camera could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CameraFileError {
    /// The file could not be read.
    #[error("{file}: {error}; name the calibration.json of a calibration, or its folder")]
    Read {
        /// The file.
        file: String,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// The text is not JSON of the expected structure.
    #[error("{file} is not a camera file ({error}): write it as {}", CAMERA_FORM)]
    Parse {
        /// The file.
        file: String,
        /// The problem, with line and column.
        error: serde_json::Error,
    },
    /// The text is not a camera file of a supported program.
    #[error("{}", not_usable(file, error))]
    Yaml {
        /// The file.
        file: String,
        /// The problem.
        error: yaml::YamlError,
    },
    /// The model is unknown or its parameters are incomplete.
    #[error("{file}: {error}")]
    Model {
        /// The file.
        file: String,
        /// The problem.
        error: DescriptionError,
    },
    /// The size of the sensor is impossible.
    #[error(
        "{file}: the sensor has {sensor} pixels; state its true size, 1 to {} pixels a side",
        Sensor::MOST_PIXELS_A_SIDE
    )]
    SensorSize {
        /// The file.
        file: String,
        /// The size in the file.
        sensor: Sensor,
    },
    /// The file was written by a later version of evcal.
    #[error("{file}: this file has layout version {version}; this evcal reads up to {known}: update evcal")]
    Version {
        /// The file.
        file: String,
        /// Layout version of the file.
        version: u32,
        /// Latest version that can be read.
        known: u32,
    },
}

impl evcal_files::remedy::Remedy for CameraFileError {}

fn not_usable(file: &str, error: &yaml::YamlError) -> String {
    use yaml::YamlError::{NoCamera, NoJson, NoXml, NoYaml};
    match error {
        NoCamera | NoJson(_) | NoXml(_) | NoYaml(_) => {
            format!("{file} is not a camera file: {error}; write one as {CAMERA_FORM}")
        }
        _ => format!("{file} is a camera file that evcal cannot use: {error}"),
    }
}

/// Reason why a description is not a valid camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// No model has this name.
    #[error("unknown camera model {0:?}; known are {known}", known = model_names())]
    UnknownModel(String),
    /// A parameter is missing.
    #[error("camera parameter {0} is missing")]
    MissingParameter(&'static str),
    /// A parameter is out of its range.
    #[error("invalid parameters for model {0}: all must be finite, the focal lengths positive")]
    Refused(ModelKind),
}

fn model_names() -> String {
    ModelKind::ALL.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", ")
}

impl CameraDescription {
    /// Creates the description of `camera`.
    pub fn new(camera: &Camera<f64>) -> Self {
        Self::of_values(camera.kind(), camera.parameters())
    }

    /// Creates a description from one value per parameter of cameras of this `kind`, in their order.
    pub fn of_values(kind: ModelKind, values: impl IntoIterator<Item = f64>) -> Self {
        let parameters = Parameters::new(kind.parameter_names().iter().copied().zip(values));
        Self { model: kind.name().to_owned(), parameters }
    }

    /// Returns the described camera.
    ///
    /// # Errors
    /// [`DescriptionError`] if the model is unknown, or a parameter is missing or out of range.
    pub fn camera(&self) -> Result<Camera<f64>, DescriptionError> {
        let kind =
            ModelKind::from_name(&self.model).ok_or_else(|| DescriptionError::UnknownModel(self.model.clone()))?;
        let names = kind.parameter_names().iter().copied();
        let value = |name| self.parameters.get(name).ok_or(DescriptionError::MissingParameter(name));
        let values = names.map(value).collect::<Result<Vec<f64>, _>>()?;
        Camera::from_parameters(kind, &values).ok_or(DescriptionError::Refused(kind))
    }
}

/// Reads sensor size and camera from a file, or from the camera file of a folder ([`camera_path`]).
///
/// # Errors
/// [`CameraFileError`].
pub fn read(path: &Path) -> Result<(Camera<f64>, Sensor), CameraFileError> {
    let path = camera_path(path);
    let parsed: CameraFile = match parse(&path) {
        Ok(parsed) => parsed,
        Err(error) => flat(&path).ok_or(error)?,
    };
    check_size(&path, parsed.sensor)?;
    let camera = parsed.camera.camera().map_err(|error| wrong(&path, error))?;
    Ok((camera, parsed.sensor))
}

/// A camera whose values are not in `parameters`, a form used by other simulators.
#[derive(Deserialize)]
struct Flat {
    camera: FlatCamera,
}

/// Camera of [`Flat`].
#[derive(Deserialize)]
struct FlatCamera {
    model: String,
    width: u16,
    height: u16,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    dist: Parameters,
}

fn flat(path: &Path) -> Option<CameraFile> {
    let Flat { camera } = serde_json::from_str(&text_of(path).ok()?).ok()?;
    let FlatCamera { model, width, height, fx, fy, cx, cy, dist } = camera;
    let model = if model == "kb4" { ModelKind::KannalaBrandt.name().to_owned() } else { model };
    let parameters = dist.and_before([("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)]);
    Some(CameraFile { sensor: Sensor::new(width, height), camera: CameraDescription { model, parameters } })
}

/// The layout version of a file.
#[derive(Deserialize)]
struct Layout {
    version: Option<u32>,
}

/// Returns the layout version of a camera file; `None` for files without one, such as `truth.json`.
///
/// # Errors
/// [`CameraFileError`] if the file is not a camera file.
pub fn version(path: &Path) -> Result<Option<u32>, CameraFileError> {
    Ok(parse_any::<Layout>(path)?.version)
}

/// Reads a JSON file that contains a [`CameraFile`] and more.
///
/// # Errors
/// [`CameraFileError`].
pub fn parse<T: DeserializeOwned>(path: &Path) -> Result<T, CameraFileError> {
    match version(path)? {
        Some(version) if version > LATEST_VERSION => {
            Err(CameraFileError::Version { file: path.display().to_string(), version, known: LATEST_VERSION })
        }
        _ => parse_any(path),
    }
}

fn parse_any<T: DeserializeOwned>(path: &Path) -> Result<T, CameraFileError> {
    let file = path.display().to_string();
    let text = text_of(path).map_err(|error| CameraFileError::Read { file: file.clone(), error })?;
    // A converted camera becomes text again too, because each other kind of input would add a copy of the parser to the
    // program.
    let json = match of_other_program(&text) {
        None => Ok(text),
        Some(camera) => {
            let camera = camera.map_err(|error| CameraFileError::Yaml { file: file.clone(), error })?;
            serde_json::to_string(&camera)
        }
    };
    let json = json.map_err(|error| CameraFileError::Parse { file: file.clone(), error })?;
    let parsed = serde_json::from_str(&json).map_err(|error| CameraFileError::Parse { file, error })?;
    // An impossible sensor size invalidates every part of the file.
    match serde_json::from_str::<SizeOnly>(&json) {
        Ok(SizeOnly { sensor }) => check_size(path, sensor).map(|()| parsed),
        Err(_) => Ok(parsed),
    }
}

/// Reads a file of up to [`LARGEST`] bytes.
fn text_of(path: &Path) -> io::Result<String> {
    evcal_files::text::read(path, LARGEST)
}

/// The sensor of a camera file.
#[derive(Deserialize)]
struct SizeOnly {
    sensor: Sensor,
}

fn check_size(path: &Path, sensor: Sensor) -> Result<(), CameraFileError> {
    let sides = 1..=Sensor::MOST_PIXELS_A_SIDE;
    match sides.contains(&sensor.width) && sides.contains(&sensor.height) {
        true => Ok(()),
        false => Err(CameraFileError::SensorSize { file: path.display().to_string(), sensor }),
    }
}

/// Key that distinguishes evcal's own files from other files.
#[derive(Deserialize)]
struct Own {
    camera: Option<IgnoredAny>,
}

/// Reads the camera of a text that is not in evcal's own form.
fn of_other_program(text: &str) -> Option<Result<CameraFile, yaml::YamlError>> {
    let mut first = text.chars().filter(|character| !character.is_whitespace());
    match (first.next(), first.next()) {
        (Some('<'), _) => Some(yaml::parse_xml(text)),
        (Some('{'), Some('"' | '}') | None) => match serde_json::from_str::<Own>(text) {
            Ok(Own { camera: Some(_) }) => None,
            // JSON of an unknown form is parsed as evcal's own, so that the error describes that form.
            Ok(_) => Some(yaml::parse_json(text)).filter(|camera| *camera != Err(yaml::YamlError::NoCamera)),
            Err(_) => Some(yaml::parse(text)).filter(Result::is_ok),
        },
        // mrcal's dictionaries also begin with a brace, and are not JSON.
        _ => Some(yaml::parse(text)),
    }
}

/// Returns the error for an invalid camera.
pub fn wrong(path: &Path, error: DescriptionError) -> CameraFileError {
    CameraFileError::Model { file: path.display().to_string(), error }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The form that other simulators use for their ground truth: values next to the model, the size within the camera.
    #[test]
    fn a_camera_with_its_values_next_to_the_model_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.json");
        let text = |model: &str, dist: &str| {
            format!(
                r#"{{"camera": {{"model": "{model}", "width": 346, "height": 260, "fx": 331.6, "fy": 331.1, "cx": 176.9, "cy": 134.2, "dist": {dist}}}}}"#
            )
        };
        std::fs::write(&path, text("radtan", r#"{"k1": -0.352, "k2": 0.149, "p1": -4e-4, "p2": 5e-4, "k3": -0.03}"#))
            .unwrap();
        let (camera, sensor) = read(&path).unwrap();
        assert_eq!(sensor, Sensor::new(346, 260));
        assert_eq!(camera.kind(), ModelKind::Radtan);
        assert_eq!(camera.parameters(), [331.6, 331.1, 176.9, 134.2, -0.352, 0.149, -4e-4, 5e-4, -0.03]);
        std::fs::write(&path, text("kb4", r#"{"k1": -0.018, "k2": 0.006, "k3": -0.003, "k4": 6e-4}"#)).unwrap();
        assert_eq!(read(&path).unwrap().0.kind(), ModelKind::KannalaBrandt);
        std::fs::write(&path, text("radtan", r#"{"k1": -0.352}"#)).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("k2"), "{error}");
    }
}
