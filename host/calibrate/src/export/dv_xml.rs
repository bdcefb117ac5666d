//! The calibration XML of DV: OpenCV's, with the camera in a node of its own name.

use evcal_core::camera::ModelKind;
use evcal_core::pattern::Layout;
use evcal_geometry::board::Board;

use super::content::{Content, ExportFormat};
use super::file_storage::{self, Entry, Value, entry, valid_name};
use evcal_core::sensor::Sensor;

/// `dv.xml`. Distortion is a column of five, or of four for a fisheye.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "dv-xml",
    program: "DV",
    file: "dv.xml",
    models: &[ModelKind::Radtan, ModelKind::KannalaBrandt],
    substitutes: &[ModelKind::Radtan, ModelKind::KannalaBrandt],
    write: |content| file_storage::xml(&content.remarks(), &entries(content)),
    first_pixel: 0.0,
    front_only: false,
};

fn entries(content: &Content) -> Vec<Entry> {
    let calibrated = content.calibrated;
    let Sensor { width, height } = calibrated.sensor;
    let fisheye = content.model == ModelKind::KannalaBrandt;
    let camera = vec![
        entry("camera_matrix", Value::Matrix { rows: 3, values: content.camera_matrix().to_vec() }),
        entry("distortion_coefficients", Value::column(content.distortion)),
        entry("image_width", Value::Integer(width.into())),
        entry("image_height", Value::Integer(height.into())),
    ];
    let distortion_model = if fisheye { "Equidistant" } else { "RadialTangential" };
    let mut entries = vec![
        entry(valid_name(&calibrated.name), Value::Map(camera)),
        entry("use_fisheye_model", Value::Integer(fisheye.into())),
        entry("type", Value::Word("camera".to_owned())),
        entry("distortion_model", Value::Word(distortion_model.to_owned())),
    ];
    if let Some(board) = calibrated.board.as_ref().and_then(Board::circles) {
        let (columns, rows) = (i64::from(board.pattern.columns), i64::from(board.pattern.rows));
        let pattern_type = match board.pattern.layout {
            Layout::Asymmetric => "asymmetricCirclesGrid",
            Layout::Symmetric => "circlesGrid",
        };
        entries.extend([
            entry("pattern_width", Value::Integer(columns)),
            entry("pattern_height", Value::Integer(rows)),
            entry("pattern_type", Value::Word(pattern_type.to_owned())),
            entry("board_width", Value::Integer(columns)),
            entry("board_height", Value::Integer(rows)),
            // In centimetres, as DV requires.
            entry("square_size", Value::Real(board.spacing * 100.0)),
        ]);
    }
    if let Some(rms) = calibrated.residual_rms {
        entries.push(entry("calibration_error", Value::Real(rms)));
    }
    entries
}
