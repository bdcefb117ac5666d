//! mrcal's `.cameramodel`: a Python dictionary.
//!
//! It contains the region in which the board was seen as `valid_intrinsics_region`. It has no `optimization_inputs`, so mrcal
//! shows no uncertainty of its own.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::number::{decimal, decimals};
use evcal_core::sensor::Sensor;

/// `camera.cameramodel`.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "mrcal",
    program: "mrcal",
    file: "camera.cameramodel",
    models: &[ModelKind::Radtan4, ModelKind::Radtan, ModelKind::Radtan8],
    substitutes: &[ModelKind::Radtan, ModelKind::Radtan8],
    write,
};

fn write(content: &Content) -> String {
    let Sensor { width, height } = content.calibrated.sensor;
    let mut text = String::new();
    for remark in content.remarks() {
        let _ = writeln!(text, "# {remark}");
    }
    let corners = content.calibrated.covered.corners();
    // A closed contour.
    let contour: Vec<String> = corners
        .iter()
        .chain(corners.first())
        .map(|corner| format!("[ {}, {} ],", decimal(corner.x), decimal(corner.y)))
        .collect();
    let _ = write!(
        text,
        "{{\n    'lensmodel':  'LENSMODEL_OPENCV{}',\n\n    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....\n    \
         'intrinsics': [ {}, {},],\n\n    'valid_intrinsics_region': [ {}],\n\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n    \
         'imagersize': [ {width}, {height},],\n}}\n",
        content.distortion.len(),
        decimals(&content.matrix),
        decimals(content.distortion),
        contour.join(" ")
    );
    text
}
