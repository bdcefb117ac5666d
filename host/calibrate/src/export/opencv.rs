//! OpenCV's `FileStorage`: `camera_matrix` and `distortion_coefficients`, as its calibration sample writes them.
//!
//! Coefficients are in OpenCV's order: the order of `cv::fisheye` for a Kannala-Brandt camera, and the order of
//! `cv::omnidir` for an omnidirectional one, with `xi` as a separate entry. `distortion_model` is `radtan`, `fisheye`
//! or `omnidir`.

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::file_storage::{self, Entry, Value, entry};
use evcal_core::sensor::Sensor;

const MODELS: &[ModelKind] =
    &[ModelKind::Radtan4, ModelKind::Radtan, ModelKind::Radtan8, ModelKind::KannalaBrandt, ModelKind::Omni];

/// Radtan with eight coefficients is excluded: outside the observed region, a rational function may have poles.
const SUBSTITUTES: &[ModelKind] = &[ModelKind::Radtan, ModelKind::KannalaBrandt];

/// YAML, which only OpenCV reads.
pub const YAML: ExportFormat = ExportFormat {
    name: "opencv-yaml",
    program: "OpenCV",
    file: "camera.yaml",
    models: MODELS,
    substitutes: SUBSTITUTES,
    write: |content| file_storage::yaml(&content.remarks(), &entries(content)),
    first_pixel: 0.0,
    front_only: false,
};

/// XML.
pub const XML: ExportFormat = ExportFormat {
    name: "opencv-xml",
    program: "OpenCV",
    file: "camera.xml",
    models: MODELS,
    substitutes: SUBSTITUTES,
    write: |content| file_storage::xml(&content.remarks(), &entries(content)),
    first_pixel: 0.0,
    front_only: false,
};

/// JSON.
pub const JSON: ExportFormat = ExportFormat {
    name: "opencv-json",
    program: "OpenCV",
    file: "camera.json",
    models: MODELS,
    substitutes: SUBSTITUTES,
    write: |content| file_storage::json(&content.remarks(), &entries(content)),
    first_pixel: 0.0,
    front_only: false,
};

fn entries(content: &Content) -> Vec<Entry> {
    let Sensor { width, height } = content.calibrated.sensor;
    let (model, xi, distortion) = match (content.model, content.distortion) {
        (ModelKind::Omni, [xi, distortion @ ..]) => ("omnidir", Some(*xi), distortion),
        (ModelKind::KannalaBrandt, distortion) => ("fisheye", None, distortion),
        (_, distortion) => ("radtan", None, distortion),
    };
    let mut entries = vec![
        entry("image_width", Value::Integer(width.into())),
        entry("image_height", Value::Integer(height.into())),
        entry("distortion_model", Value::Word(model.to_owned())),
        entry("camera_matrix", Value::Matrix { rows: 3, values: content.camera_matrix().to_vec() }),
        entry("distortion_coefficients", Value::row(distortion)),
    ];
    entries.extend(xi.map(|xi| entry("xi", Value::Real(xi))));
    if let Some(rms) = content.calibrated.residual_rms {
        entries.push(entry("residual_rms", Value::Real(rms)));
    }
    if let Some(refit) = content.refit {
        entries.push(entry("refit_from", Value::Word(refit.from.to_string())));
        entries.push(entry("refit_error_rms", Value::Real(refit.covered.rms)));
        entries.push(entry("refit_error_max", Value::Real(refit.covered.largest)));
    }
    entries
}
