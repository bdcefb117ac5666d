//! The lens of a simulated camera.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;

/// Error: a model rejects the parameters.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "model {kind} takes {} parameters {}, all finite, with positive focal lengths; {given} were given",
    .kind.parameter_names().len(),
    .kind.parameter_names().join(",")
)]
pub struct LensError {
    kind: ModelKind,
    given: usize,
}

impl evcal_files::remedy::Remedy for LensError {}

/// Creates the lens with these parameters.
///
/// # Errors
/// [`LensError`] if there are too few or too many parameters, or one is out of range.
pub fn lens(kind: ModelKind, parameters: &[f64]) -> Result<Camera<f64>, LensError> {
    Camera::from_parameters(kind, parameters).ok_or(LensError { kind, given: parameters.len() })
}

/// Returns a radtan lens with a horizontal field of view of about 60 degrees and visible barrel distortion.
///
/// # Errors
/// [`LensError`] for a sensor without pixels.
pub fn usual_lens(sensor: Sensor) -> Result<Camera<f64>, LensError> {
    let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
    let focal = 0.96 * width;
    let center = [0.5 * (width - 1.0), 0.5 * (height - 1.0)];
    lens(ModelKind::Radtan, &[focal, focal, center[0], center[1], -0.35, 0.15, 0.0, 0.0, 0.0])
}
