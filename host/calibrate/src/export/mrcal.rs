//! mrcal's `.cameramodel`: a Python dictionary.
//!
//! It contains the region in which the board was seen as `valid_intrinsics_region`. It has no `optimization_inputs`, so mrcal
//! shows no uncertainty of its own.

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::fill::fill;
use super::number::decimal;

/// `camera.cameramodel`.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "mrcal",
    program: "mrcal",
    file: "camera.cameramodel",
    models: &[ModelKind::Radtan4, ModelKind::Radtan, ModelKind::Radtan8],
    substitutes: &[ModelKind::Radtan, ModelKind::Radtan8],
    write,
    first_pixel: 0.0,
    front_only: false,
};

fn write(content: &Content) -> String {
    let corners = content.calibrated.covered.corners();
    // A closed contour.
    let contour: Vec<String> = corners
        .iter()
        .chain(corners.first())
        .map(|corner| format!("[ {}, {} ],", decimal(corner.x), decimal(corner.y)))
        .collect();
    let (count, contour) = (content.distortion.len(), contour.join(" "));
    let text = format!(
        "$remarks
{{
    'lensmodel':  'LENSMODEL_OPENCV{count}',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ $matrix, $distortion,],

    'valid_intrinsics_region': [ {contour}],

    'extrinsics': [ 0, 0, 0, 0, 0, 0,],

    'imagersize': [ $width, $height,],
}}
"
    );
    fill(&text, content)
}
