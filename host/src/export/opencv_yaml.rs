//! OpenCV's `FileStorage` YAML.
//!
//! The dialect is OpenCV's own: the header `%YAML:1.0` and the tag `!!opencv-matrix` are what its
//! reader asks for; general YAML readers refuse both.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use super::opencv_camera::OpencvCamera;

/// The camera as an OpenCV YAML file: `camera_matrix`, `distortion_coefficients` (OpenCV's order;
/// for a Kannala-Brandt camera those of `cv::fisheye`), `image_width`, `image_height`. Pixel (0, 0)
/// is the centre of the top-left pixel. Where the calibrated model is another one, `refit_from` names
/// it, and `refit_error_rms` and `refit_error_max` say in pixels what the replacement costs up to
/// `refit_radius` pixels from the principal point.
pub fn opencv_yaml(camera: &OpencvCamera, sensor: (u16, u16), residual_rms: f64) -> Option<String> {
    let parameters = camera.camera.parameters();
    let (&[fx, fy, cx, cy], distortion) = parameters.split_first_chunk::<4>()?;
    let model = if camera.camera.kind() == ModelKind::KannalaBrandt { "fisheye" } else { "radtan" };
    let mut text = String::from("%YAML:1.0\n---\n");
    let _ = writeln!(text, "image_width: {}", sensor.0);
    let _ = writeln!(text, "image_height: {}", sensor.1);
    let _ = writeln!(text, "distortion_model: {model}");
    matrix(&mut text, "camera_matrix", 3, 3, &[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    matrix(&mut text, "distortion_coefficients", 1, distortion.len(), distortion);
    let _ = writeln!(text, "avg_reprojection_error: {residual_rms:?}");
    if let Some(refit) = &camera.refit {
        let _ = writeln!(text, "refit_from: \"{}\"", refit.from);
        let _ = writeln!(text, "refit_radius: {:?}", refit.radius);
        let _ = writeln!(text, "refit_error_rms: {:?}", refit.difference.root_mean_square);
        let _ = writeln!(text, "refit_error_max: {:?}", refit.difference.largest);
    }
    Some(text)
}

fn matrix(text: &mut String, name: &str, rows: usize, columns: usize, values: &[f64]) {
    let values: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
    let _ = write!(
        text,
        "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {} ]\n",
        values.join(", ")
    );
}
