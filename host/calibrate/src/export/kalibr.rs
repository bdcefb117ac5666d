//! Kalibr's camchain, as `kalibr_common/ConfigReader.py` reads it.
//!
//! It requires exactly four coefficients of radtan (k1 k2 p1 p2) and of equidistant (k1 k2 k3 k4), one of fov (w), and
//! real numbers for intrinsics. The intrinsics begin with the shape parameters of the projection: xi for omni, alpha
//! and beta for eucm, xi and alpha for ds.

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::fill::fill;

/// `camchain.yaml` of one camera.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "kalibr",
    program: "Kalibr",
    file: "camchain.yaml",
    models: &[
        ModelKind::Radtan4,
        ModelKind::KannalaBrandt,
        ModelKind::Omni,
        ModelKind::Eucm,
        ModelKind::DoubleSphere,
        ModelKind::Fov,
    ],
    substitutes: &[ModelKind::Radtan4, ModelKind::KannalaBrandt, ModelKind::Eucm, ModelKind::DoubleSphere],
    write,
    first_pixel: 0.0,
    front_only: false,
};

fn write(content: &Content) -> String {
    // In Kalibr the shape parameters of the projection are the first intrinsics.
    let (camera_model, shape, distortion_model, coefficients) = match content.model {
        ModelKind::KannalaBrandt => ("pinhole", "", "equidistant", "$distortion"),
        ModelKind::Fov => ("pinhole", "", "fov", "$distortion"),
        ModelKind::Omni => ("omni", "$xi, ", "radtan", "$k1, $k2, $p1, $p2"),
        ModelKind::Eucm => ("eucm", "$alpha, $beta, ", "none", ""),
        ModelKind::DoubleSphere => ("ds", "$xi, $alpha, ", "none", ""),
        _ => ("pinhole", "", "radtan", "$distortion"),
    };
    let text = format!(
        "$remarks
cam0:
  cam_overlaps: []
  camera_model: {camera_model}
  intrinsics: [{shape}$matrix]
  distortion_model: {distortion_model}
  distortion_coeffs: [{coefficients}]
  resolution: [$width, $height]
  rostopic: $topic
"
    );
    fill(&text, content)
}
