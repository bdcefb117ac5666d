//! Formats whose files need no more than a text with places for the values of a camera ([`fill`]).

use evcal_core::camera::ModelKind::{Eucm, Fov, KannalaBrandt, Omni, Radtan, Radtan4, Radtan8};

use super::content::ExportFormat;
use super::fill::fill;

/// `cameras.txt` of COLMAP and pycolmap, where the centre of the top-left pixel is (0.5, 0.5).
pub const COLMAP: ExportFormat = ExportFormat {
    name: "colmap",
    program: "COLMAP",
    file: "cameras.txt",
    models: &[Radtan4, Radtan, Radtan8, KannalaBrandt, Eucm, Fov],
    substitutes: &[Radtan, KannalaBrandt, Eucm],
    write: |content| {
        let camera = match content.model {
            Radtan4 => "OPENCV $width $height $fx $fy $cx $cy $k1 $k2 $p1 $p2",
            Radtan => "FULL_OPENCV $width $height $fx $fy $cx $cy $k1 $k2 $p1 $p2 $k3 0 0 0",
            Radtan8 => "FULL_OPENCV $width $height $fx $fy $cx $cy $k1 $k2 $p1 $p2 $k3 $k4 $k5 $k6",
            Eucm => "EUCM $width $height $fx $fy $cx $cy $alpha $beta",
            Fov => "FOV $width $height $fx $fy $cx $cy $w",
            _ => "OPENCV_FISHEYE $width $height $fx $fy $cx $cy $k1 $k2 $k3 $k4",
        };
        fill(&format!("$remarks\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {camera}\n"), content)
    },
    first_pixel: 0.5,
    front_only: true,
};

/// The camera of nerfstudio's `transforms.json`, where the centre of the top-left pixel is (0.5, 0.5). Its `k4` is the
/// coefficient of r⁸, not the one of the rational model.
pub const NERFSTUDIO: ExportFormat = ExportFormat {
    name: "nerfstudio",
    program: "nerfstudio",
    file: "transforms.json",
    models: &[Radtan4, Radtan, KannalaBrandt],
    substitutes: &[Radtan, KannalaBrandt],
    write: |content| {
        let (model, coefficients) = match content.model {
            Radtan4 => ("OPENCV", r#""k1": $k1, "k2": $k2, "k3": 0.0, "k4": 0.0, "p1": $p1, "p2": $p2"#),
            Radtan => ("OPENCV", r#""k1": $k1, "k2": $k2, "k3": $k3, "k4": 0.0, "p1": $p1, "p2": $p2"#),
            _ => ("OPENCV_FISHEYE", r#""k1": $k1, "k2": $k2, "k3": $k3, "k4": $k4"#),
        };
        let text = format!(
            r#"{{
  "comment": $comment,
  "camera_model": "{model}",
  "w": $width, "h": $height,
  "fl_x": $fx, "fl_y": $fy, "cx": $cx, "cy": $cy,
  {coefficients}
}}
"#
        );
        fill(&text, content)
    },
    first_pixel: 0.5,
    front_only: true,
};

/// The camera file of camodocal, which VINS-Mono, VINS-Fusion and programs made from them read. It counts the coefficients of
/// a fisheye from k2.
pub const VINS_FUSION: ExportFormat = ExportFormat {
    name: "vins-fusion",
    program: "VINS-Fusion",
    file: "vins-camera.yaml",
    models: &[Radtan4, KannalaBrandt, Omni],
    substitutes: &[Radtan4, KannalaBrandt, Omni],
    write: |content| {
        let (model, parameters) = match content.model {
            Radtan4 => (
                "PINHOLE",
                "distortion_parameters:\n   k1: $k1\n   k2: $k2\n   p1: $p1\n   p2: $p2\n\
                 projection_parameters:\n   fx: $fx\n   fy: $fy\n   cx: $cx\n   cy: $cy\n",
            ),
            Omni => (
                "MEI",
                "mirror_parameters:\n   xi: $xi\n\
                 distortion_parameters:\n   k1: $k1\n   k2: $k2\n   p1: $p1\n   p2: $p2\n\
                 projection_parameters:\n   gamma1: $fx\n   gamma2: $fy\n   u0: $cx\n   v0: $cy\n",
            ),
            _ => (
                "KANNALA_BRANDT",
                "projection_parameters:\n   k2: $k1\n   k3: $k2\n   k4: $k3\n   k5: $k4\n   mu: $fx\n   mv: $fy\n   u0: $cx\n   v0: $cy\n",
            ),
        };
        let first = "%YAML:1.0\n---\n$remarks\n";
        let size = "camera_name: $name\nimage_width: $width\nimage_height: $height\n";
        fill(&format!("{first}model_type: {model}\n{size}{parameters}"), content)
    },
    first_pixel: 0.0,
    front_only: false,
};

/// The camera entries of the settings of ORB-SLAM3.
pub const ORB_SLAM3: ExportFormat = ExportFormat {
    name: "orb-slam3",
    program: "ORB-SLAM3",
    file: "orb-slam3.yaml",
    models: &[Radtan4, Radtan, KannalaBrandt],
    substitutes: &[Radtan, KannalaBrandt],
    write: |content| {
        let (model, coefficients) = match content.model {
            KannalaBrandt => ("KannalaBrandt8", "Camera1.k1: $k1\nCamera1.k2: $k2\nCamera1.k3: $k3\nCamera1.k4: $k4\n"),
            Radtan => {
                ("PinHole", "Camera1.k1: $k1\nCamera1.k2: $k2\nCamera1.p1: $p1\nCamera1.p2: $p2\nCamera1.k3: $k3\n")
            }
            _ => ("PinHole", "Camera1.k1: $k1\nCamera1.k2: $k2\nCamera1.p1: $p1\nCamera1.p2: $p2\n"),
        };
        let first = "%YAML:1.0\n---\n$remarks\n\
            # The camera's part of the settings. Camera.fps and Camera.RGB are examples: set them for your images.\n\
            File.version: \"1.0\"\n";
        let matrix = "Camera1.fx: $fx\nCamera1.fy: $fy\nCamera1.cx: $cx\nCamera1.cy: $cy\n";
        let images = "Camera.width: $width\nCamera.height: $height\nCamera.fps: 30\nCamera.RGB: 1\n";
        fill(&format!("{first}Camera.type: \"{model}\"\n{matrix}{coefficients}{images}"), content)
    },
    first_pixel: 0.0,
    front_only: false,
};

/// The cameras file ("ncamera") of SVO, which Ultimate SLAM and EVO read too.
pub const SVO: ExportFormat = ExportFormat {
    name: "svo",
    program: "SVO",
    file: "svo-camera.yaml",
    models: &[Radtan4, KannalaBrandt],
    substitutes: &[Radtan4, KannalaBrandt],
    write: |content| {
        let (distortion, coefficients) = match content.model {
            KannalaBrandt => ("equidistant", "$k1, $k2, $k3, $k4"),
            _ => ("radial-tangential", "$k1, $k2, $p1, $p2"),
        };
        let text = format!(
            "$remarks
label: $name
cameras:
- camera:
    label: $name
    line-delay-nanoseconds: 0
    image_height: $height
    image_width: $width
    type: pinhole
    intrinsics:
      cols: 1
      rows: 4
      data: [$fx, $fy, $cx, $cy]
    distortion:
      type: {distortion}
      parameters:
        cols: 1
        rows: 4
        data: [{coefficients}]
  # From the camera's coordinates to those of the body (the IMU): not known here, so the body is the camera.
  T_B_C:
    cols: 4
    rows: 4
    data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
"
        );
        fill(&text, content)
    },
    first_pixel: 0.0,
    front_only: true,
};

#[cfg(test)]
mod tests {
    use evcal_core::camera::{Camera, ModelKind};
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::result::calibrated_camera::CalibratedCamera;

    fn export(format: &ExportFormat, kind: ModelKind, parameters: &[f64]) -> (String, Option<String>) {
        let camera = Camera::from_parameters(kind, parameters).unwrap();
        let exported = format.export(&CalibratedCamera::seen_everywhere(camera, Sensor::new(346, 260))).unwrap();
        (exported.text, exported.note)
    }

    #[test]
    fn every_place_has_a_value() {
        let parameters = [330.4, 331.1, 171.3, 129.4, -0.1, 0.01, 1e-3, -2e-4, 0.0, 0.0, 0.0, 0.0];
        let camera: Camera<f64> = Camera::from_parameters(Radtan8, &parameters).unwrap();
        for format in [COLMAP, NERFSTUDIO, VINS_FUSION, ORB_SLAM3, SVO] {
            for &kind in format.models {
                let camera = evcal_core::camera::refit::refit(kind, &camera, Sensor::new(346, 260)).unwrap();
                let (text, note) = export(&format, kind, &camera.parameters());
                assert!(!text.contains('$') && note.is_none(), "{}: {note:?} {text}", format.name);
            }
        }
    }

    /// The first pixel's centre is (0.5, 0.5), and the comment says so.
    #[test]
    fn the_centre_is_moved_where_pixels_have_their_corner_at_zero() {
        let parameters = [330.0, 331.0, 171.25, 129.5, -0.1, 0.01, 1e-3, -2e-4, 0.5];
        let (text, _) = export(&COLMAP, Radtan, &parameters);
        assert!(
            text.contains("1 FULL_OPENCV 346 260 330.0 331.0 171.75 130.0 -0.1 0.01 0.001 -0.0002 0.5 0 0 0\n"),
            "{text}"
        );
        assert!(text.contains("(0.5, 0.5) is the centre of the top-left pixel"), "{text}");
        let (text, _) = export(&ORB_SLAM3, Radtan, &parameters);
        assert!(text.contains("Camera1.cx: 171.25\n") && text.contains("pixel (0, 0) is the centre"), "{text}");
    }

    /// COLMAP computes nothing for points behind the camera, which this lens sees in the corners.
    #[test]
    fn a_part_of_the_sensor_that_the_program_cannot_use_is_stated() {
        let wide = [100.0, 100.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0];
        // Pixels more than 100 π/2 from the centre.
        let behind = (0..260).flat_map(|y| (0..346).map(move |x| (x, y)));
        let behind = behind.filter(|(x, y)| (f64::from(*x) - 172.5).hypot(f64::from(*y) - 129.5) > 157.08).count();
        let share = 100.0 * behind as f64 / (346.0 * 260.0);
        let (text, note) = export(&COLMAP, KannalaBrandt, &wide);
        let expected = format!("COLMAP sees nothing beyond 90 degrees from the axis: {share:.1} % of the sensor");
        assert!(note.as_deref() == Some(expected.as_str()) && text.contains(&expected), "{note:?}, not {expected}");
        assert_eq!(export(&VINS_FUSION, KannalaBrandt, &wide).1, None);
        assert_eq!(export(&SVO, KannalaBrandt, &[160.0, 160.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0]).1, None);
    }
}
