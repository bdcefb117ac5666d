//! Calibration JSON, version 2, of dv-processing. It is written by a property tree, so every scalar is a string.

use evcal_core::camera::ModelKind;
use evcal_core::pattern::Layout;
use evcal_geometry::board::Board;
use serde_json::json;

use super::content::{Content, ExportFormat};
use super::number::decimal;
use evcal_core::sensor::Sensor;

/// `dv-processing.json`. The library computes in single precision.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "dv-processing",
    program: "dv-processing",
    file: "dv-processing.json",
    models: &[ModelKind::Radtan4, ModelKind::Radtan, ModelKind::KannalaBrandt],
    substitutes: &[ModelKind::Radtan, ModelKind::KannalaBrandt],
    write,
    first_pixel: 0.0,
    front_only: false,
};

fn write(content: &Content) -> String {
    let calibrated = content.calibrated;
    let Sensor { width, height } = calibrated.sensor;
    let [fx, fy, cx, cy] = content.matrix.map(decimal);
    let coefficients: Vec<String> = content.distortion.iter().map(|value| decimal(*value)).collect();
    let model = if content.model == ModelKind::KannalaBrandt { "equidistant" } else { "radialTangential" };
    let identity: Vec<&str> = (0..16).map(|index| if index % 5 == 0 { "1" } else { "0" }).collect();
    let mut camera = json!({
        "name": calibrated.name,
        "position": "left",
        "master": "true",
        "resolution": [width.to_string(), height.to_string()],
        "principalPoint": [cx, cy],
        "focalLength": [fx, fy],
        "distortionCoefficients": coefficients,
        "distortionModel": model,
        "transformationToC0": identity,
    });
    if let (Some(board), Some(object)) = (calibrated.board.as_ref().and_then(Board::circles), camera.as_object_mut()) {
        let shape = [board.pattern.columns.to_string(), board.pattern.rows.to_string()];
        let pattern_type = match board.pattern.layout {
            Layout::Asymmetric => "asymmetricCirclesGrid",
            Layout::Symmetric => "circlesGrid",
        };
        let mut metadata = json!({
            "patternShape": shape,
            "internalPatternShape": shape,
            "patternType": pattern_type,
            "patternSize": decimal(board.spacing),
            "patternSpacing": "0",
            "calibrationTime": "",
            "quality": "",
            "comment": content.remarks().join("; "),
        });
        if let (Some(rms), Some(metadata)) = (calibrated.residual_rms, metadata.as_object_mut()) {
            metadata.insert("calibrationError".to_owned(), decimal(rms).into());
        }
        object.insert("metadata".to_owned(), metadata);
    }
    let text = json!({ "version": "2.0", "cameras": { "C0": camera }, "comment": content.remarks().join("; ") });
    format!("{text:#}\n")
}
