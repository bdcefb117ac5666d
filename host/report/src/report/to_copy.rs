//! The camera in the formats of other programs, to copy.

use std::fmt::Write as _;

use evcal_core::camera::{Camera, ModelKind};
use maud::{Markup, html};

use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::export::{kalibr, opencv, ros};
use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_geometry::board::Board;

/// Returns K and D for OpenCV in Python, and the camera files for ROS and Kalibr, each folded.
pub fn forms(calibrated: &Calibrated, board: &Board) -> Markup {
    let camera = CalibratedCamera::new(calibrated, board);
    let opencv = opencv::YAML.export(&camera).ok().map(|exported| python(&exported.camera));
    let file = |format: evcal_calibrate::export::content::ExportFormat| {
        format.export(&camera).ok().map(|exported| exported.text)
    };
    let forms = [
        ("OpenCV, in Python", opencv),
        ("ROS: camera_info.yaml", file(ros::FORMAT)),
        ("Kalibr: camchain.yaml", file(kalibr::FORMAT)),
    ];
    html! {
        @for (name, text) in forms {
            @if let Some(text) = text { details.screen { summary { "To copy: " (name) } pre { (text) } } }
        }
    }
}

/// Returns K and D as NumPy arrays.
pub fn python(camera: &Camera<f64>) -> String {
    let parameters = camera.parameters();
    let Some(([fx, fy, cx, cy], distortion)) = parameters.split_first_chunk() else { return String::new() };
    let (module, distortion) = match (camera.kind(), distortion) {
        (ModelKind::KannalaBrandt, distortion) => ("cv2.fisheye", distortion),
        (ModelKind::Omni, [_, distortion @ ..]) => ("cv2.omnidir", distortion),
        (_, distortion) => ("cv2", distortion),
    };
    let numbers: Vec<String> = distortion.iter().map(ToString::to_string).collect();
    let mut text = format!(
        "import numpy as np\n# for {module}\nK = np.array([[{fx}, 0, {cx}], [0, {fy}, {cy}], [0, 0, 1]])\nD = np.array([{}])\n",
        numbers.join(", ")
    );
    if let (ModelKind::Omni, Some(xi)) = (camera.kind(), parameters.get(4)) {
        let _ = writeln!(text, "xi = {xi}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn python_has_the_coefficients_of_its_module() {
        let camera = |kind, parameters: &[f64]| Camera::from_parameters(kind, parameters).unwrap();
        let radtan = python(&camera(ModelKind::Radtan, &[300.0, 301.0, 172.5, 129.5, -0.3, 0.1, 0.0, 0.0, 0.02]));
        assert!(radtan.contains("# for cv2\nK = np.array([[300, 0, 172.5], [0, 301, 129.5], [0, 0, 1]])"), "{radtan}");
        assert!(radtan.contains("D = np.array([-0.3, 0.1, 0, 0, 0.02])"), "{radtan}");
        let omni = python(&camera(ModelKind::Omni, &[300.0, 301.0, 172.5, 129.5, 0.9, -0.3, 0.1, 0.0, 0.0]));
        assert!(omni.contains("# for cv2.omnidir") && omni.contains("D = np.array([-0.3, 0.1, 0, 0])"), "{omni}");
        assert!(omni.contains("xi = 0.9"), "{omni}");
    }
}
