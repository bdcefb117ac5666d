//! Every file, read by the formulas of the program for which it is made, recovers the true motion from readings.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Matrix3, Matrix4, Quaternion, Translation3, UnitQuaternion, Vector3, Vector4};
use serde_json::Value;
use yaml_rust2::{Yaml, YamlLoader};

use super::*;
use crate::export::second_camera::tests::result;
use crate::quality::verdict::Grade;
use crate::result::device_description::Uncertain;
use evcal_geometry::lens::camera_file::CameraDescription;

const DELAY: f64 = 0.002_781;
const STREAMS: &str = r#"[{"samples": 30000, "rate": 1000.0002, "missing": 0.0, "longest_gap": 0.001, "out_of_order": 0, "saturated": 0.0}]"#;

fn pose() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(-0.003, 0.0021, 0.02), Vector3::new(0.4, -1.2, 2.0))
}

fn rows(matrix: Matrix3<f64>) -> [[f64; 3]; 3] {
    matrix.transpose().into()
}

/// M and bias of the gyroscope, C, M and bias of the accelerometer.
type Model = (Matrix3<f64>, Vector3<f64>, Matrix3<f64>, Matrix3<f64>, Vector3<f64>);

fn model() -> Model {
    (
        Matrix3::new(0.99, 0.0, 0.0, 0.01, 1.02, 0.0, -0.02, 0.015, 1.01),
        Vector3::new(0.02, -0.03, 0.01),
        UnitQuaternion::new(Vector3::new(0.01, -0.02, 0.03)).to_rotation_matrix().into_inner(),
        Matrix3::new(1.02, 0.0, 0.0, -0.013, 0.97, 0.0, 0.011, 0.006, 1.01),
        Vector3::new(0.2, -0.1, 0.3),
    )
}

fn unit() -> InertialResult {
    let (gyroscope, gyroscope_bias, turn, accelerometer, accelerometer_bias) = model();
    let sensor = |matrix, bias: Vector3<f64>, delay, density: f64| SensorResult {
        delay: Uncertain { value: delay, sigma: 1e-5 },
        bias: Uncertain { value: bias.into(), sigma: [1e-3; 3] },
        matrix: rows(matrix),
        matrix_sigma: [[0.0; 3]; 3],
        delay_measured: true,
        matrix_measured: true,
        noise_density: [density, 2.0 * density, 3.0 * density],
        noise_measured: true,
        residual_rms: 0.1,
    };
    InertialResult {
        grade: Grade::Good,
        verdict: String::new(),
        imu_from_camera: Some(pose().to_homogeneous().transpose().into()),
        rotation_sigma: [1e-4; 3],
        position_in_camera: Uncertain { value: [None; 3], sigma: [None; 3] },
        gyroscope: sensor(gyroscope, gyroscope_bias, DELAY, 1e-4),
        gyroscope_from_imu: rows(turn),
        accelerometer: sensor(accelerometer, accelerometer_bias, 0.0018, 2e-3),
        gravity: [0.0, 9.81, 0.0],
        gravity_sigma: 1e-4,
        board_scale: Uncertain { value: 1.0, sigma: 3e-3 },
        clock_drift: Uncertain { value: 0.0, sigma: 1e-6 },
        clock_origin: 0.0,
        delays_at: 15.0,
        correlation: 0.99,
        used: 30_000,
        streams: serde_json::from_str(STREAMS).unwrap(),
        camera_moved: Some(0.1),
        fixed_camera: None,
        solved_together: None,
        block_scatter: 1.0,
        correlations: Vec::new(),
        findings: Vec::new(),
    }
}

fn camera() -> CalibratedCamera {
    let sensor = Sensor::new(80, 60);
    let parameters = [80.4, 80.1, 39.3, 29.4, -0.01, 0.001, 0.0, 0.0];
    let camera = Camera::from_parameters(ModelKind::KannalaBrandt, &parameters).unwrap();
    CalibratedCamera::seen_everywhere(camera, sensor)
}

fn text(name: &str) -> String {
    let files = files(&camera(), &unit(), &[]);
    assert_eq!(files.len(), FILES.len());
    files.into_iter().find(|(found, _)| *found == name).unwrap().1
}

/// As OpenCV and OpenVINS read it, without the first line that general readers reject.
fn yaml(name: &str) -> Yaml {
    let text = text(name).replace("%YAML:1.0\n", "").replace("!!opencv-matrix", "");
    YamlLoader::load_from_str(&text).unwrap().remove(0)
}

fn numbers(value: &Yaml) -> Vec<f64> {
    match value {
        Yaml::Array(values) => values.iter().flat_map(numbers).collect(),
        value => vec![value.as_f64().or(value.as_i64().map(|value| value as f64)).unwrap()],
    }
}

fn three(value: &Yaml) -> Matrix3<f64> {
    Matrix3::from_row_slice(&numbers(value))
}

fn four(value: &Yaml) -> Matrix4<f64> {
    Matrix4::from_row_slice(&numbers(value))
}

fn is_camera_to_unit(matrix: Matrix4<f64>) {
    assert!((matrix - pose().to_homogeneous()).norm() < 1e-12, "{matrix}");
}

/// True angular velocity and acceleration.
fn truth() -> [Vector3<f64>; 2] {
    [Vector3::new(1.0, -2.0, 0.7), Vector3::new(3.0, -9.0, 2.0)]
}

fn readings() -> [Vector3<f64>; 2] {
    let (gyroscope, gyroscope_bias, turn, accelerometer, accelerometer_bias) = model();
    let [w, a] = truth();
    [gyroscope * turn * w + gyroscope_bias, accelerometer * a + accelerometer_bias]
}

fn is_truth([w, a]: [Vector3<f64>; 2]) {
    assert!((w - truth()[0]).norm() < 1e-9 && (a - truth()[1]).norm() < 1e-9, "{w} {a}");
}

#[test]
fn kalibr_file_has_the_pose_of_the_imu_in_the_camera() {
    let (chain, imu) = (yaml("camchain-imucam.yaml"), yaml("imu.yaml"));
    is_camera_to_unit(four(&chain["cam0"]["T_cam_imu"]).try_inverse().unwrap());
    assert_eq!(chain["cam0"]["timeshift_cam_imu"].as_f64(), Some(DELAY));
    let imu = &imu["imu0"];
    let predicted = three(&imu["gyroscopes"]["M"]) * three(&imu["gyroscopes"]["C_gyro_i"]) * truth()[0];
    assert!((predicted + model().1 - readings()[0]).norm() < 1e-12);
    assert!((three(&imu["accelerometers"]["M"]) * truth()[1] + model().4 - readings()[1]).norm() < 1e-12);
    assert_eq!(imu["update_rate"].as_f64(), Some(1000.0));
    assert!((imu["gyroscope_noise_density"].as_f64().unwrap() - 2e-4).abs() < 1e-15);
}

/// A point of the IMU is mapped to each camera by way of the first, and a moment of the IMU is at t_imu − shift on each clock.
#[test]
fn kalibr_file_has_the_pose_of_the_imu_in_every_camera() {
    let others = [result(0), result(1)];
    let text =
        files(&camera(), &unit(), &others).into_iter().find(|(name, _)| *name == "camchain-imucam.yaml").unwrap().1;
    let chain = YamlLoader::load_from_str(&text).unwrap().remove(0);
    assert_eq!(chain.as_hash().unwrap().len(), 3);
    assert_eq!(numbers(&chain["cam0"]["cam_overlaps"]), [1.0, 2.0]);
    let mut before = four(&chain["cam0"]["T_cam_imu"]);
    is_camera_to_unit(before.try_inverse().unwrap());
    let from_unit = before;
    for (name, other) in ["cam1", "cam2"].into_iter().zip(&others) {
        let found = four(&chain[name]["T_cam_imu"]);
        assert!((found - other.pose().to_homogeneous() * from_unit).norm() < 1e-12, "{name}: {found}");
        assert!((four(&chain[name]["T_cn_cnm1"]) * before - found).norm() < 1e-12, "{name}: the chain is another way");
        before = found;
        let in_first = 12.5;
        let in_unit = in_first + DELAY;
        let in_this = in_first + other.time_offset.value;
        assert!((in_this + chain[name]["timeshift_cam_imu"].as_f64().unwrap() - in_unit).abs() < 1e-12, "{name}");
    }
}

/// The camera from the solve with the IMU is the one that matches it.
#[test]
fn the_camera_comes_from_the_solve_with_the_imu() {
    let parameters = [81.5, 80.1, 39.3, 29.4, -0.01, 0.001, 0.0, 0.0];
    let moved = Camera::from_parameters(ModelKind::KannalaBrandt, &parameters).unwrap();
    let solved_together = Some(CameraDescription::new(&moved));
    let files = files(&camera(), &InertialResult { solved_together, ..unit() }, &[]);
    let text = &files.iter().find(|(name, _)| *name == "camchain-imucam.yaml").unwrap().1;
    let focal = numbers(&YamlLoader::load_from_str(text).unwrap()[0]["cam0"]["intrinsics"])[0];
    assert!((focal - 81.5).abs() < 1e-9, "{focal}");
}

/// ω = R_IMUtoGYROᵀ Tw⁻¹ (ω_m − Tg a − b), a = R_IMUtoACCᵀ Ta⁻¹ (a_m − b); Tw and Ta are lower triangular in its model `kalibr`.
#[test]
fn openvins_recovers_the_truth_from_readings() {
    let (chain, imu) = (yaml("kalibr_imucam_chain.yaml"), yaml("kalibr_imu_chain.yaml"));
    is_camera_to_unit(four(&chain["cam0"]["T_imu_cam"]));
    assert_eq!(chain["cam0"]["timeshift_cam_imu"].as_f64(), Some(DELAY));
    assert_eq!(chain["cam0"]["distortion_model"].as_str(), Some("equidistant"));
    let imu = &imu["imu0"];
    assert_eq!(imu["model"].as_str(), Some("kalibr"));
    let undo = |turn: &str, matrix: &str, reading: Vector3<f64>, bias: Vector3<f64>| {
        let scale = three(&imu[matrix]);
        assert_eq!(scale, scale.lower_triangle(), "{matrix}");
        three(&imu[turn]).transpose() * scale.try_inverse().unwrap() * (reading - bias)
    };
    let [w, a] = readings();
    let (_, gyroscope_bias, .., accelerometer_bias) = model();
    assert_eq!(three(&imu["Tg"]), Matrix3::zeros());
    is_truth([undo("R_IMUtoGYRO", "Tw", w, gyroscope_bias), undo("R_IMUtoACC", "Ta", a, accelerometer_bias)]);
}

#[test]
fn vins_file_has_the_pose_of_the_camera_in_the_body() {
    let file = yaml("vins-fusion.yaml");
    is_camera_to_unit(four(&file["body_T_cam0"]["data"]));
    assert_eq!(file["td"].as_f64(), Some(DELAY));
    assert_eq!((file["g_norm"].as_f64(), file["image_width"].as_i64()), (Some(9.81), Some(80)));
}

/// After a second of steps as VINS takes them, covariance ← covariance + V noise Vᵀ with V of half a step for each of two
/// readings and of a step for a walk, the uncertainty of velocity, angle and biases agrees with white noise of these densities.
#[test]
fn noise_integrated_by_vins_has_the_measured_density() {
    let file = yaml("vins-fusion.yaml");
    let after_a_second = |entry: &str, parts: &[f64]| {
        let dt = 1e-3;
        let step: f64 = parts.iter().map(|part| (part * dt * file[entry].as_f64().unwrap()).powi(2)).sum();
        (1000.0 * step).sqrt()
    };
    for (entry, parts, density) in [
        ("acc_n", &[0.5, 0.5][..], 4e-3),
        ("gyr_n", &[0.5, 0.5], 2e-4),
        ("acc_w", &[1.0], ACCELEROMETER_WALK),
        ("gyr_w", &[1.0], GYROSCOPE_WALK),
    ] {
        let found = after_a_second(entry, parts);
        assert!((found / density - 1.0).abs() < 1e-9, "{entry}: {found}, not {density}");
    }
}

/// ω = (I + S) ω_m − b with S by columns; a = (I + S) a_m − b with the lower triangle by columns.
#[test]
fn basalt_recovers_the_truth_from_readings() {
    let file: Value = serde_json::from_str(&text("basalt-imu.json")).unwrap();
    let file = &file["value0"];
    let list = |name: &str| -> Vec<f64> { serde_json::from_value(file[name].clone()).unwrap() };
    let (gyroscope, accelerometer) = (list("calib_gyro_bias"), list("calib_accel_bias"));
    let scale = Matrix3::identity() + Matrix3::from_column_slice(&gyroscope[3..]);
    let w = scale * readings()[0] - Vector3::from_column_slice(&gyroscope[..3]);
    let [s1, s2, s3, s4, s5, s6] = accelerometer[3..].try_into().unwrap();
    let scale = Matrix3::identity() + Matrix3::new(s1, 0.0, 0.0, s2, s4, 0.0, s3, s5, s6);
    is_truth([w, scale * readings()[1] - Vector3::from_column_slice(&accelerometer[..3])]);
    let at = |name: &str| file["T_imu_cam"][0][name].as_f64().unwrap();
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(at("qw"), at("qx"), at("qy"), at("qz")));
    is_camera_to_unit(
        Isometry3::from_parts(Translation3::new(at("px"), at("py"), at("pz")), rotation).to_homogeneous(),
    );
    assert_eq!(file["cam_time_offset_ns"].as_i64(), Some(2_781_000));
    assert_eq!(file["intrinsics"][0]["camera_type"], "kb4");
}

#[test]
fn dv_file_has_the_pose_of_the_imu_and_an_offset_to_subtract() {
    let file: Value = serde_json::from_str(&text("dv-processing-imu.json")).unwrap();
    let unit = &file["imus"]["S0"];
    let list = |name: &str| -> Vec<f64> {
        unit[name].as_array().unwrap().iter().map(|value| value.as_str().unwrap().parse().unwrap()).collect()
    };
    is_camera_to_unit(Matrix4::from_row_slice(&list("transformationToC0")).try_inverse().unwrap());
    let stamp = 1_000_000.0 + 1e6 * DELAY;
    assert_eq!(stamp - unit["timeOffsetMicros"].as_str().unwrap().parse::<f64>().unwrap(), 1_000_000.0);
    assert_eq!(list("omegaOffsetAvg"), model().1.as_slice());
    assert_eq!(file["cameras"]["C0"]["distortionModel"], "equidistant");
}

/// The transform of the child's frame maps a point of the camera to the IMU.
#[test]
fn the_camera_is_the_child_frame_in_ros() {
    let file = yaml("static_transform.yaml");
    assert_eq!(file["header"]["frame_id"].as_str(), Some("dvs_imu"));
    assert_eq!(file["child_frame_id"].as_str(), Some("dvs_optical"));
    let at = |part: &str, name: &str| file["transform"][part][name].as_f64().unwrap();
    let rotation = ["x", "y", "z", "w"].map(|name| at("rotation", name));
    let rotation = UnitQuaternion::from_quaternion(Quaternion::from(Vector4::from(rotation)));
    let place = Translation3::from(Vector3::from(["x", "y", "z"].map(|name| at("translation", name))));
    is_camera_to_unit(Isometry3::from_parts(place, rotation).to_homogeneous());
}

#[test]
fn without_a_known_position_only_the_sensor_files_of_the_imu_are_written() {
    let files = files(&camera(), &InertialResult { imu_from_camera: None, ..unit() }, &[]);
    let names: Vec<&str> = files.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["imu.yaml", "kalibr_imu_chain.yaml"]);
}
