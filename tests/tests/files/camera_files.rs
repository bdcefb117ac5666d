//! evcal reads camera files that other programs wrote, and projects as these programs do.

use std::path::Path;

use evcal_geometry::lens::camera_file;
use evcal_tests::readers::{SYSTEM_PYTHON, ask, python};
use nalgebra::{Vector2, Vector3};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Compares every file of a program, and returns the names of the files.
fn agrees(interpreter: &Path, program: &str, precision: f64) -> Vec<String> {
    let folder = TempDir::new().unwrap();
    let question = json!({ "program": program, "folder": folder.path() });
    let answer = ask(interpreter, "cameras.py", &question);
    let check = |written: &Value| {
        let file = Path::new(written["file"].as_str().unwrap());
        let (camera, sensor) = camera_file::read(file).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((sensor.width, sensor.height), (346, 260), "{}", file.display());
        let points: Vec<[f64; 3]> = serde_json::from_value(written["points"].clone()).unwrap();
        let pixels: Vec<[f64; 2]> = serde_json::from_value(written["pixels"].clone()).unwrap();
        assert!(points.len() > 50 && points.len() == pixels.len());
        let distance = |(point, pixel): (&[f64; 3], &[f64; 2])| {
            (camera.project(&Vector3::from(*point)).unwrap() - Vector2::from(*pixel)).norm()
        };
        let worst = points.iter().zip(&pixels).map(distance).fold(0.0, f64::max);
        let name = file.file_name().unwrap().to_string_lossy().into_owned();
        println!("{program} | {name} | {} | {worst:.2e} px", camera.kind());
        assert!(worst < precision, "{name}, read as {}: {worst} px", camera.kind());
        name
    };
    answer.as_array().unwrap().iter().map(check).collect()
}

/// Fisheyes and omnidirectional cameras of OpenCV's samples were read as `radtan4`, results of its rational model and files above
/// 64 KiB not at all.
#[test]
fn files_of_opencv() {
    assert_eq!(agrees(&python(), "opencv", 1e-9).len(), 15);
}

/// Every camera that mrcal calibrated has its observations in the file, and was not read.
#[test]
fn files_of_mrcal() {
    let names = agrees(Path::new(SYSTEM_PYTHON), "mrcal", 1e-9);
    assert_eq!(names, ["calibrated.cameramodel", "pinhole.cameramodel", "rational.cameramodel"]);
}
