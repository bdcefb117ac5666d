//! Every file, read by the formulas of the program for which it is made, maps a point to its position in the second camera.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::{Matrix3, Matrix4, Point3, Quaternion, Translation3, UnitQuaternion, Vector2, Vector3};
use yaml_rust2::{Yaml, YamlLoader};

use super::*;
use crate::quality::verdict::Grade;
use crate::result::device_description::Uncertain;
use evcal_geometry::lens::camera_file::CameraDescription;

const SENSOR: Sensor = Sensor::new(80, 60);
/// A point in the frame of the first camera.
const POINT: Point3<f64> = Point3::new(0.11, -0.05, 0.8);

fn poses() -> [Isometry3<f64>; 2] {
    [
        Isometry3::new(Vector3::new(-0.1, 0.004, 0.007), Vector3::new(0.02, 0.1, -0.03)),
        Isometry3::new(Vector3::new(0.02, -0.09, 0.01), Vector3::new(-0.05, 0.01, 0.2)),
    ]
}

fn lens(shift: f64) -> Camera<f64> {
    let parameters = [80.4 + shift, 80.1, 39.3, 29.4 + shift, -0.1, 0.01, 1e-3, -2e-3, 1e-3];
    Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap()
}

/// The second or third camera of a mount.
pub(in crate::export) fn result(index: usize) -> SecondCameraResult {
    let of = |shift: f64| CameraDescription::new(&lens(shift));
    let solved = |shift: f64| SolvedCamera { sensor: SENSOR, camera: of(shift) };
    SecondCameraResult {
        recording: "second.aedat4".to_owned(),
        sensor: SENSOR,
        camera: of(3.0),
        sigma: of(0.0),
        covered_region: CoveredRegion::whole(SENSOR).corners().iter().map(|&corner| corner.into()).collect(),
        lens_grade: None,
        lens_verdict: String::new(),
        grade: Grade::Good,
        verdict: "Good: known to 0.001°.".to_owned(),
        second_from_first: poses()[index].to_homogeneous().transpose().into(),
        rotation_sigma: [1e-5; 3],
        translation_sigma: [1e-5; 3],
        baseline: Uncertain { value: 0.1, sigma: 1e-5 },
        time_offset: Uncertain { value: 3.214, sigma: 1e-6 },
        time_offset_at: 1.0,
        clock_rate: None,
        correlations: [[0.0; 8]; 8],
        solved_together: [solved(0.0), solved(2.0)],
        cameras_moved: [Some(0.1); 2],
        fixed: [false; 2],
        seconds: 9.0,
        used: 1000,
        left_out: 0.0,
        correlation: Some(0.99),
        inflation: 4.0,
        looseness: Some(1.0),
        from_identity: None,
        frames: None,
        findings: Vec::new(),
    }
}

fn texts() -> Vec<(String, String)> {
    files(&CalibratedCamera::seen_everywhere(lens(0.0), SENSOR), &[result(0), result(1)]).unwrap()
}

/// As each program reads it, without the first line that general readers reject.
fn documents(name: &str) -> Vec<Yaml> {
    let text = texts().into_iter().find(|(found, _)| found == name).unwrap().1;
    YamlLoader::load_from_str(&text.replace("%YAML:1.0\n", "").replace("!!opencv-matrix", "")).unwrap()
}

fn numbers(value: &Yaml) -> Vec<f64> {
    match value {
        Yaml::Array(values) => values.iter().flat_map(numbers).collect(),
        value => vec![value.as_f64().or(value.as_i64().map(|value| value as f64)).unwrap()],
    }
}

fn matrix3(value: &Yaml) -> Matrix3<f64> {
    Matrix3::from_row_slice(&numbers(&value["data"]))
}

#[test]
fn exported_files_are_recognised_by_name() {
    let names: Vec<String> = texts().into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["camchain-cameras.yaml", "static_transforms.yaml", "stereo.yaml", "stereo-2.yaml"]);
    assert!(names.iter().all(|name| is_file(name)));
    assert!(!is_file("stereo-mine.yaml") && !is_file("camchain.yaml"));
}

/// `CameraChainParameters.getExtrinsicsLastCamToHere`: from the previous camera to this one; their products map from the first
/// camera to any other.
#[test]
fn the_chain_of_kalibr_maps_from_camera_to_camera() {
    let [chain] = documents("camchain-cameras.yaml").try_into().unwrap();
    let mut point = POINT;
    for (index, pose) in poses().into_iter().enumerate() {
        let camera = &chain[format!("cam{}", index + 1).as_str()];
        let matrix = Matrix4::from_row_slice(&numbers(&camera["T_cn_cnm1"]));
        point = matrix.transform_point(&point);
        assert!((point - pose * POINT).norm() < 1e-9, "cam{}", index + 1);
        assert_eq!(numbers(&camera["resolution"]), [80.0, 60.0]);
        assert!((numbers(&camera["intrinsics"])[0] - 82.4).abs() < 0.2);
        assert!(camera["timeshift_cam_imu"].is_badvalue());
    }
    assert_eq!(numbers(&chain["cam0"]["cam_overlaps"]), [1.0, 2.0]);
    assert!(chain["cam0"]["T_cn_cnm1"].is_badvalue());
}

/// OpenCV: x₂ = R x₁ + T, E = [T]ₓ R, m₂ᵀ F m₁ = 0.
#[test]
fn a_pair_of_opencv_projects_as_both_cameras_do() {
    for (index, name) in ["stereo.yaml", "stereo-2.yaml"].into_iter().enumerate() {
        let [pair] = documents(name).try_into().unwrap();
        let translation = Vector3::from_vec(numbers(&pair["T"]["data"]));
        let in_second = matrix3(&pair["R"]) * POINT.coords + translation;
        assert!((in_second - (poses()[index] * POINT).coords).norm() < 1e-9);
        let pixel = |number: usize, point: &Vector3<f64>| {
            let matrix = matrix3(&pair[format!("cameraMatrix{number}").as_str()]);
            let [k1, k2, p1, p2, k3] = numbers(&pair[format!("distCoeffs{number}").as_str()]["data"])[..] else {
                panic!("five coefficients");
            };
            let (x, y) = (point.x / point.z, point.y / point.z);
            let r2 = x * x + y * y;
            let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
            let distorted = Vector3::new(
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                1.0,
            );
            ((matrix * distorted).xy(), matrix * Vector3::new(x, y, 1.0))
        };
        let ((one, straight_one), (two, straight_two)) = (pixel(1, &POINT.coords), pixel(2, &in_second));
        assert!((one - lens(0.0).project(&POINT.coords).unwrap()).norm() < 1e-9);
        assert!((two - lens(2.0).project(&in_second).unwrap()).norm() < 1e-9);
        let fundamental = matrix3(&pair["F"]);
        let off = straight_two.dot(&(fundamental * straight_one)) / (fundamental * straight_one).xy().norm();
        assert!(off.abs() < 1e-9, "{off}");
        let off = in_second.dot(&(matrix3(&pair["E"]) * POINT.coords));
        assert!(off.abs() < 1e-12, "{off}");
        let size: Vector2<f64> = Vector2::new(numbers(&pair["image_width1"])[0], numbers(&pair["image_height2"])[0]);
        assert_eq!(size, Vector2::new(80.0, 60.0));
    }
}

/// tf: the transform of a child in its parent maps the child's coordinates to the parent's.
#[test]
fn transforms_of_ros_map_from_the_second_camera_to_the_first() {
    let documents = documents("static_transforms.yaml");
    assert_eq!(documents.len(), 2);
    for (index, (document, pose)) in documents.iter().zip(poses()).enumerate() {
        assert_eq!(document["header"]["frame_id"].as_str(), Some("dvs_optical"));
        assert_eq!(document["child_frame_id"].as_str(), Some(format!("dvs{}_optical", index + 1).as_str()));
        let at = |part: &str, axis: &str| numbers(&document["transform"][part][axis])[0];
        let translation = ["x", "y", "z"].map(|axis| at("translation", axis));
        let rotation = |axis| at("rotation", axis);
        let rotation = Quaternion::new(rotation("w"), rotation("x"), rotation("y"), rotation("z"));
        let parent_child = Isometry3::from_parts(
            Translation3::from(Vector3::from(translation)),
            UnitQuaternion::from_quaternion(rotation),
        );
        assert!((parent_child * (pose * POINT) - POINT).norm() < 1e-9);
    }
}
