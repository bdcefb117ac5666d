//! A camera as JSON: the part of `calibration.json` and `truth.json` that describes the lens.

mod parameters;

use std::path::Path;

use evcal_core::camera::{Camera, ModelKind};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

pub use self::parameters::Parameters;
use evcal_core::sensor::Sensor;

/// A camera model with its parameters by name. Pixel (0, 0) is the centre of the top-left pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraDescription {
    /// Name of the model, for example `radtan`.
    pub model: String,
    /// Parameters by name, in the model's order: `fx`, `fy`, `cx`, `cy` in pixels and the distortion
    /// coefficients. A file may give them in any order.
    pub parameters: Parameters,
}

/// The part of a JSON file that this module reads; other keys are left alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraFile {
    /// Size of the sensor.
    pub sensor: Sensor,
    /// The lens.
    pub camera: CameraDescription,
}

/// Why a camera could not be read from JSON.
#[derive(Debug, thiserror::Error)]
pub enum CameraFileError {
    /// The file could not be read.
    #[error("{file}: {error}")]
    Read {
        /// The file.
        file: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// The text is not JSON of the expected shape.
    #[error(
        "{file}: {error}; a camera file is JSON with \"sensor\": {{\"width\", \"height\"}} and \"camera\": {{\"model\", \"parameters\"}}, such as calibration.json"
    )]
    Parse {
        /// The file.
        file: String,
        /// What is wrong, with line and column.
        error: serde_json::Error,
    },
    /// The model is unknown or its parameters are incomplete.
    #[error("{file}: {error}")]
    Model {
        /// The file.
        file: String,
        /// What is wrong.
        error: NoCamera,
    },
    /// The file is of a later program.
    #[error(
        "{file}: the layout of this calibration is version {version}, known are up to {known}: it was written by a later evcal, update this one"
    )]
    Version {
        /// The file.
        file: String,
        /// Its version.
        version: u32,
        /// The latest version that can be read.
        known: u32,
    },
}

/// Why a description is that of no camera.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoCamera {
    /// There is no such model.
    #[error("unknown camera model {0:?}; known are {known}", known = known_models())]
    UnknownModel(String),
    /// A parameter of the model is not there.
    #[error("camera parameter {0} is missing")]
    MissingParameter(&'static str),
    /// The model does not take the parameters.
    #[error("model {0} refuses its parameters")]
    Refused(String),
}

fn known_models() -> String {
    let names: Vec<&str> = ModelKind::ALL.iter().map(|kind| kind.name()).collect();
    names.join(", ")
}

impl CameraDescription {
    /// Describes `camera`.
    pub fn new(camera: &Camera<f64>) -> Self {
        let names = camera.kind().parameter_names().iter().copied();
        let parameters = Parameters::new(names.zip(camera.parameters()));
        Self { model: camera.kind().name().to_owned(), parameters }
    }

    /// The camera described.
    ///
    /// # Errors
    /// [`NoCamera`] says which model or parameter is missing.
    pub fn camera(&self) -> Result<Camera<f64>, NoCamera> {
        let kind = ModelKind::from_name(&self.model).ok_or_else(|| NoCamera::UnknownModel(self.model.clone()))?;
        let mut values = Vec::new();
        for name in kind.parameter_names() {
            values.push(self.parameters.get(name).ok_or(NoCamera::MissingParameter(name))?);
        }
        Camera::from_parameters(kind, &values).ok_or_else(|| NoCamera::Refused(self.model.clone()))
    }
}

/// Reads sensor size and camera from a JSON file.
///
/// # Errors
/// [`CameraFileError`].
pub fn read(path: &Path) -> Result<(Camera<f64>, Sensor), CameraFileError> {
    let parsed: CameraFile = parse(path)?;
    let camera = parsed.camera.camera().map_err(|error| wrong(path, error))?;
    Ok((camera, parsed.sensor))
}

/// Reads a JSON file that holds a [`CameraFile`] and more.
///
/// # Errors
/// [`CameraFileError`].
pub fn parse<T: DeserializeOwned>(path: &Path) -> Result<T, CameraFileError> {
    let file = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|error| CameraFileError::Read { file: file.clone(), error })?;
    serde_json::from_str(&text).map_err(|error| CameraFileError::Parse { file, error })
}

/// The error for a camera that is none.
pub fn wrong(path: &Path, error: NoCamera) -> CameraFileError {
    CameraFileError::Model { file: path.display().to_string(), error }
}
