//! Compares pixels and derivatives of the camera models with OpenCV's `projectPoints` and `fisheye::projectPoints`. All points
//! are in front of the camera, because OpenCV's fisheye model is defined only there.

use evcal_core::camera::{Camera, ModelKind};
use evcal_tests::readers::{ask, python};
use nalgebra::{Vector2, Vector3};
use serde_json::{Value, json};

fn cameras() -> Vec<Camera<f64>> {
    let sets: &[(ModelKind, f64, &[f64])] = &[
        (ModelKind::Radtan4, 345.0, &[-0.3, 0.1, 0.001, -0.0005]),
        (ModelKind::Radtan4, 345.0, &[0.2, 0.05, -0.003, 0.002]),
        (ModelKind::Radtan, 345.0, &[-0.37, 0.16, 0.0001, -0.0002, -0.03]),
        (ModelKind::Radtan, 345.0, &[0.1, -0.1, 0.002, 0.001, 0.3]),
        (ModelKind::Radtan8, 345.0, &[0.5, 0.1, 0.0005, -0.0003, 0.02, 0.8, 0.3, 0.05]),
        (ModelKind::Radtan8, 345.0, &[3.0, 1.5, 1e-4, 2e-4, 0.1, 3.4, 2.3, 0.4]),
        (ModelKind::KannalaBrandt, 140.0, &[0.0, 0.0, 0.0, 0.0]),
        (ModelKind::KannalaBrandt, 140.0, &[-0.02, 0.01, -0.005, 0.001]),
        (ModelKind::KannalaBrandt, 140.0, &[0.1, 0.02, 0.01, 0.002]),
    ];
    sets.iter()
        .map(|&(kind, focal, coefficients)| {
            let parameters: Vec<f64> =
                [focal, focal * 0.99, 170.3, 127.8].iter().chain(coefficients).copied().collect();
            Camera::from_parameters(kind, &parameters).unwrap()
        })
        .collect()
}

/// A point in camera coordinates and the pixel that sees it.
struct Seen {
    pixel: Vector2<f64>,
    point: Vector3<f64>,
}

/// Returns points at depths from 0.5 to 1.5 whose pixels cover a DAVIS346.
fn points(camera: &Camera<f64>) -> Vec<Seen> {
    (0..=25)
        .flat_map(|row| (0..=34).map(move |column| Vector2::new(f64::from(column) * 10.0, f64::from(row) * 10.0)))
        .filter_map(|pixel| {
            let bearing = camera.unproject(&pixel)?;
            let depth = 0.5 + (pixel.x * 0.37 + pixel.y * 0.73).fract();
            (bearing.z > 0.05).then(|| Seen { pixel, point: bearing * (depth / bearing.z) })
        })
        .collect()
}

fn question(camera: &Camera<f64>, points: &[Seen]) -> Value {
    let parameters = camera.parameters();
    let [fx, fy, cx, cy] = parameters[..4] else { panic!("four parameters come first") };
    json!({
        "matrix": [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        "distortion": parameters[4..].to_vec(),
        "fisheye": camera.kind() == ModelKind::KannalaBrandt,
        "points": points.iter().map(|seen| seen.point.as_slice()).collect::<Vec<_>>(),
    })
}

#[test]
fn pixels_and_derivatives_agree_with_opencv() {
    let cameras = cameras();
    let points: Vec<Vec<Seen>> = cameras.iter().map(points).collect();
    let questions = cameras.iter().zip(&points).map(|(camera, points)| question(camera, points)).collect();
    let answers = ask(&python(), "derivatives.py", &questions);
    for ((camera, points), answer) in cameras.iter().zip(&points).zip(answers.as_array().unwrap()) {
        let pixels: Vec<[f64; 2]> = serde_json::from_value(answer["pixels"].clone()).unwrap();
        let derivatives: Vec<[Vec<f64>; 2]> = serde_json::from_value(answer["derivatives"].clone()).unwrap();
        assert!(points.len() > 800 && pixels.len() == points.len(), "{camera:?}: {} points", points.len());
        for ((Seen { pixel, point }, opencv), derivatives) in points.iter().zip(pixels).zip(derivatives) {
            let projection = camera.project_with_jacobians(point).unwrap();
            let opencv = Vector2::from(opencv);
            assert!((projection.pixel - opencv).norm() < 1e-10, "{camera:?} {point} {opencv}");
            // `unproject` inverts the projection.
            assert!((pixel - opencv).norm() < 1e-9, "{camera:?} {pixel} {opencv}");
            for (row, opencv) in derivatives.iter().enumerate() {
                let (by_point, by_parameters) = (projection.by_point.row(row), projection.by_parameters.row(row));
                assert_eq!(opencv.len(), by_point.len() + camera.parameters().len());
                let pairs = by_point.iter().chain(by_parameters.iter()).zip(opencv);
                for (column, (own, opencv)) in pairs.enumerate() {
                    let difference = (own - opencv).abs();
                    assert!(difference < 1e-9 * (1.0 + opencv.abs()), "{camera:?} {point} {column}: {own} {opencv}");
                }
            }
        }
    }
}
