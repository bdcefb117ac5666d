//! Kalibr's camchain, as `kalibr_common/ConfigReader.py` reads it.
//!
//! It requires exactly four coefficients of radtan (k1 k2 p1 p2) and of equidistant (k1 k2 k3 k4), one of fov (w), and
//! real numbers for intrinsics. The intrinsics begin with the shape parameters of the projection: xi for omni, alpha
//! and beta for eucm, xi and alpha for ds.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::number::{decimals, quoted};
use evcal_core::sensor::Sensor;

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
};

fn write(content: &Content) -> String {
    let Sensor { width, height } = content.calibrated.sensor;
    let (camera_model, distortion_model) = match content.model {
        ModelKind::KannalaBrandt => ("pinhole", "equidistant"),
        ModelKind::Fov => ("pinhole", "fov"),
        ModelKind::Omni => ("omni", "radtan"),
        ModelKind::Eucm => ("eucm", "none"),
        ModelKind::DoubleSphere => ("ds", "none"),
        _ => ("pinhole", "radtan"),
    };
    // In Kalibr the shape parameters of the projection are the first intrinsics.
    let shape = match camera_model {
        "pinhole" => 0,
        "omni" => 1,
        _ => 2,
    };
    let (shape, distortion) = content.distortion.split_at_checked(shape).unwrap_or((&[], content.distortion));
    let mut text = String::new();
    for remark in content.remarks() {
        let _ = writeln!(text, "# {remark}");
    }
    let _ = write!(
        text,
        "cam0:\n  cam_overlaps: []\n  camera_model: {camera_model}\n  intrinsics: [{}]\n  distortion_model: {distortion_model}\n  \
         distortion_coeffs: [{}]\n  resolution: [{width}, {height}]\n  rostopic: {}\n",
        decimals(&[shape, &content.matrix].concat()),
        decimals(distortion),
        quoted(&content.calibrated.ros_topic)
    );
    text
}
