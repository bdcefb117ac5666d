//! Kalibr's camchain, as `kalibr_common/ConfigReader.py` reads it.
//!
//! It asks for exactly four coefficients of radtan (k1 k2 p1 p2) and of equidistant (k1 k2 k3 k4), and for real
//! numbers where a focal length or principal point stands.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use super::format::{Content, Format};
use super::number::decimals;
use super::ros::quoted;

/// `camchain.yaml` of one camera.
pub const FORMAT: Format = Format {
    name: "kalibr",
    file: "camchain.yaml",
    models: &[ModelKind::Radtan4, ModelKind::KannalaBrandt],
    substitutes: &[ModelKind::Radtan4, ModelKind::KannalaBrandt],
    write,
};

fn write(content: &Content) -> String {
    let (width, height) = content.calibrated.sensor;
    let distortion_model = if content.model == ModelKind::KannalaBrandt { "equidistant" } else { "radtan" };
    let mut text = String::new();
    for remark in content.remarks() {
        let _ = writeln!(text, "# {remark}");
    }
    let _ = write!(
        text,
        "cam0:\n  cam_overlaps: []\n  camera_model: pinhole\n  intrinsics: [{}]\n  distortion_model: {distortion_model}\n  \
         distortion_coeffs: [{}]\n  resolution: [{width}, {height}]\n  rostopic: {}\n",
        decimals(&content.matrix),
        decimals(content.distortion),
        quoted(&content.calibrated.ros_topic)
    );
    text
}
