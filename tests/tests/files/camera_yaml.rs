//! OpenCV reads `camera.yaml` and projects like the camera in `calibration.json`.

use std::fs;
use std::path::Path;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_geometry::lens::covered_region::CoveredRegion;
use evcal_tests::lens::{INVERSE_RADIAL, KANNALA_BRANDT, Lens, RADTAN, RADTAN4, RADTAN8};
use evcal_tests::readers::{ask, python};
use evcal_tests::{camera, read_json};
use nalgebra::{Vector2, Vector3};
use serde_json::json;

/// Returns the distances between `pixels` and OpenCV's projections of their bearings with the camera in `file`.
fn distances(file: &Path, camera: &Camera<f64>, pixels: impl Iterator<Item = Vector2<f64>>) -> Vec<f64> {
    let (pixels, bearings): (Vec<Vector2<f64>>, Vec<Vector3<f64>>) =
        pixels.filter_map(|pixel| Some((pixel, camera.unproject(&pixel)?))).unzip();
    let bearings: Vec<&[f64]> = bearings.iter().map(|bearing| bearing.as_slice()).collect();
    let question = json!([{ "format": "opencv-yaml", "file": file, "points": bearings }]);
    let answer = ask(&python(), "project.py", &question);
    let projected: Vec<[f64; 2]> = serde_json::from_value(answer[0].clone()).unwrap();
    assert_eq!(projected.len(), pixels.len());
    projected.iter().zip(&pixels).map(|(projected, pixel)| (Vector2::from(*projected) - pixel).norm()).collect()
}

fn pixels() -> impl Iterator<Item = Vector2<f64>> {
    (0..=10).flat_map(|row| (0..=10).map(move |column| Vector2::new(34.5 * f64::from(column), 25.9 * f64::from(row))))
}

fn agrees(lens: Lens) {
    let folder = lens.own_calibration();
    let camera = camera(&folder.join("calibration.json"));
    let distances = distances(&folder.join("camera.yaml"), &camera, pixels());
    assert!(distances.len() == 121, "{} of 121 pixels have a bearing", distances.len());
    let largest = distances.iter().copied().fold(0.0, f64::max);
    assert!(largest < 1e-6, "{}: {largest} px", lens.model);
}

#[test]
fn radtan4() {
    agrees(RADTAN4);
}

#[test]
fn radtan() {
    agrees(RADTAN);
}

#[test]
fn radtan8() {
    agrees(RADTAN8);
}

#[test]
fn kannala_brandt() {
    agrees(KANNALA_BRANDT);
}

/// OpenCV does not have this model: the file contains the closest OpenCV model and its deviation.
#[test]
fn inverse_radial() {
    let folder = INVERSE_RADIAL.own_calibration();
    let yaml = folder.join("camera.yaml");
    let text = fs::read_to_string(&yaml).unwrap();
    let value = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": ")).unwrap();
    assert_eq!(value("refit_from"), "\"inverse-radial\"");
    let file = folder.join("calibration.json");
    let corners: Vec<[f64; 2]> = serde_json::from_value(read_json(&file)["covered_region"].clone()).unwrap();
    let region = CoveredRegion::around(corners.into_iter().map(Vector2::from), Sensor::new(346, 260));
    let [rms, max] = ["refit_error_rms", "refit_error_max"].map(|name| value(name).parse::<f64>().unwrap());
    let pixels = (0..26).flat_map(|row| (0..35).map(move |column| Vector2::new(column as f64, row as f64) * 10.0));
    let distances = distances(&yaml, &camera(&file), pixels.filter(|pixel| region.contains(pixel)));
    assert!(distances.len() > 500 && max < 0.1, "{} pixels, {max} px", distances.len());
    let largest = distances.iter().copied().fold(0.0, f64::max);
    let mean_square = distances.iter().map(|distance| distance * distance).sum::<f64>() / distances.len() as f64;
    // The file states the deviation over all pixels; the test uses every tenth.
    assert!(largest <= max && mean_square.sqrt() < 1.2 * rms, "{largest} and {} px", mean_square.sqrt());
}
