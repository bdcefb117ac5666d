//! Every export format projects like the calibration when the program that it is meant for reads it.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use evcal_core::camera::Camera;
use evcal_tests::lens::{self, Lens};
use evcal_tests::readers::{SYSTEM_PYTHON, ask, python};
use evcal_tests::{camera, evcal, json, succeed, text};
use nalgebra::{Vector2, Vector3};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Format, its reader, and the precision of the reader (px).
const READERS: [(&str, &str, f64); 14] = [
    ("opencv-yaml", "OpenCV", 1e-6),
    ("opencv-xml", "OpenCV", 1e-6),
    ("opencv-json", "OpenCV", 1e-6),
    ("ros", "PyYAML and OpenCV", 1e-6),
    ("kalibr", "PyYAML, Kalibr's rules", 1e-6),
    ("basalt", "JSON, basalt's rules", 1e-6),
    // dv-processing computes in single precision.
    ("dv-xml", "dv-processing", 2e-4),
    ("dv-processing", "dv-processing", 2e-4),
    ("mrcal", "mrcal", 1e-6),
    // COLMAP computes its FOV model by a series near the optical axis.
    ("colmap", "pycolmap", 1e-8),
    ("nerfstudio", "JSON, nerfstudio's projection", 1e-9),
    ("vins-fusion", "OpenCV, camodocal's rules", 1e-9),
    ("orb-slam3", "OpenCV, ORB-SLAM3's rules", 1e-9),
    ("svo", "PyYAML, vikit's rules", 1e-9),
];

/// Region in which the board was seen: the sensor without its corners.
const COVERED: [[f64; 2]; 8] =
    [[60., 0.], [285., 0.], [345., 50.], [345., 210.], [285., 259.], [60., 259.], [0., 210.], [0., 50.]];

/// Writes a calibration of `lens` and returns its path.
fn calibration(lens: &Lens, folder: &Path) -> std::path::PathBuf {
    let kind = lens.model.parse::<evcal_core::camera::ModelKind>().unwrap();
    let values = lens.parameters.split(',').map(|value| value.parse::<f64>().unwrap());
    let parameters: serde_json::Map<String, Value> =
        kind.parameter_names().iter().zip(values).map(|(name, value)| ((*name).to_owned(), value.into())).collect();
    let file = folder.join(format!("{}.json", lens.model));
    let content = json!({
        "sensor": { "width": 346, "height": 260 },
        "camera": { "model": lens.model, "parameters": parameters },
        "covered_region": COVERED,
        "residuals": { "rms": 0.21 },
        "board": evcal_tests::BOARD,
    });
    fs::write(&file, content.to_string()).unwrap();
    file
}

/// Returns pixels in the covered region and their bearings.
fn pixels_and_bearings(camera: &Camera<f64>) -> (Vec<Vector2<f64>>, Vec<Vector3<f64>>) {
    let pixels = (0..=51).flat_map(|row| (0..=69).map(move |column| Vector2::new(column as f64, row as f64) * 5.0));
    let seen = |pixel: &Vector2<f64>| {
        (0..COVERED.len()).all(|index| {
            let [from, to] = [COVERED[index], COVERED[(index + 1) % COVERED.len()]].map(Vector2::from);
            (to - from).perp(&(pixel - from)) >= 0.0
        })
    };
    pixels.filter(seen).filter_map(|pixel| Some((pixel, camera.unproject(&pixel)?))).unzip()
}

#[test]
fn every_reader_projects_the_same_pixels() {
    let folder = TempDir::new().unwrap();
    let (mut questions, mut expected) = (Vec::new(), Vec::new());
    for lens in lens::ALL {
        let file = calibration(&lens, folder.path());
        let (pixels, bearings) = pixels_and_bearings(&camera(&file));
        assert!(pixels.len() > 3000, "{} of {}", pixels.len(), lens.model);
        let bearings: Vec<[f64; 3]> = bearings.iter().map(|&bearing| bearing.into()).collect();
        let exports = folder.path().join(lens.model);
        let name = ["--camera-name", "DAVIS346_00000001"];
        let arguments = ["export", text(&file), "--format", "all", "-o", text(&exports), "--json"];
        let report = json(&[&arguments[..], &name].concat());
        assert_eq!(report["written"].as_array().unwrap().len(), READERS.len() + 1, "{report}");
        for (format, reader, precision) in READERS {
            let names = report["written"].as_array().unwrap().iter().map(|path| path.as_str().unwrap());
            let file = names.map(Path::new).find(|path| path.file_name().unwrap() == file_name(format)).unwrap();
            let refit = report["refits"].as_array().unwrap().iter().find(|refit| refit["format"] == format).cloned();
            questions.push((format, json!({ "format": format, "file": file, "points": bearings })));
            expected.push((lens.model, format, reader, precision, refit, pixels.clone()));
        }
    }
    let (mrcal, others): (Vec<_>, Vec<_>) = questions.iter().partition(|(format, _)| *format == "mrcal");
    let answers = |python: &Path, questions: Vec<&(&str, Value)>| {
        let questions = questions.into_iter().map(|(_, question)| question.clone()).collect();
        ask(python, "project.py", &Value::Array(questions)).as_array().unwrap().clone().into_iter()
    };
    let mut of_mrcal = answers(Path::new(SYSTEM_PYTHON), mrcal);
    let mut of_others = answers(&python(), others);
    let mut table = String::from("\nreader | format | calibrated model | written | worst difference / stated (px)\n");
    for (model, format, reader, precision, refit, pixels) in expected {
        let answer = if format == "mrcal" { of_mrcal.next() } else { of_others.next() }.unwrap();
        let projected: Vec<[f64; 2]> = serde_json::from_value(answer).unwrap();
        assert_eq!(projected.len(), pixels.len());
        let differences = projected.iter().zip(&pixels).map(|(found, pixel)| (Vector2::from(*found) - pixel).norm());
        let worst = differences.fold(0.0, f64::max);
        let stated = refit.as_ref().map_or(0.0, |refit| refit["max_px"].as_f64().unwrap());
        let written = refit.as_ref().map_or(model, |refit| refit["model"].as_str().unwrap());
        let _ = writeln!(table, "{reader} | {format} | {model} | {written} | {worst:.2e} / {stated:.2e}");
        assert!(worst <= stated + precision, "{format} of {model}: {worst} px, {stated} px stated: {refit:?}");
        // The stated deviation must not be too large either. The worst pixel may lie between the sampled ones, hence the factor.
        assert!(worst >= 0.5 * stated - precision, "{format} of {model}: {worst} px, {stated} px stated: {refit:?}");
    }
    println!("{table}");
}

fn file_name(format: &str) -> &str {
    match format {
        "opencv-yaml" => "camera.yaml",
        "opencv-xml" => "camera.xml",
        "opencv-json" => "camera.json",
        "ros" => "camera_info.yaml",
        "kalibr" => "camchain.yaml",
        "basalt" => "basalt.json",
        "dv-xml" => "dv.xml",
        "dv-processing" => "dv-processing.json",
        "mrcal" => "camera.cameramodel",
        "colmap" => "cameras.txt",
        "nerfstudio" => "transforms.json",
        "vins-fusion" => "vins-camera.yaml",
        "orb-slam3" => "orb-slam3.yaml",
        "svo" => "svo-camera.yaml",
        other => panic!("{other}"),
    }
}

#[test]
fn the_csv_table_contains_the_exact_parameters() {
    let folder = TempDir::new().unwrap();
    for lens in lens::ALL {
        let file = calibration(&lens, folder.path());
        let table = succeed(&["export", text(&file), "--format", "csv"]);
        let rows: Vec<Vec<&str>> =
            table.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(',').collect()).collect();
        assert_eq!(rows[0][..5], ["parameter", "value", "sigma", "unit", "covariance_fx"]);
        assert!(rows.iter().all(|row| row.len() == rows.len() + 3), "{table}");
        let values: Vec<f64> = rows[1..].iter().map(|row| row[1].parse().unwrap()).collect();
        assert_eq!(values, camera(&file).parameters().to_vec(), "{table}");
        assert!(rows[1][0] == "fx" && rows[1][3] == "px" && rows[5][3].is_empty(), "{table}");
    }
}

#[test]
fn a_format_that_cannot_contain_the_lens_is_rejected() {
    let folder = TempDir::new().unwrap();
    let wide = Lens { model: "kannala-brandt", parameters: "60,60,172.5,129.5,0,0,0,0" };
    let file = calibration(&wide, folder.path());
    // The lens sees points behind the camera, which a pinhole model cannot project.
    let failed = evcal(&["export", text(&file), "--format", "mrcal"]);
    assert_eq!(failed.code, Some(1), "{failed:?}");
    assert!(failed.stderr.contains("mrcal has no model that comes near this kannala-brandt"), "{failed:?}");
    let all = folder.path().join("all");
    let others = evcal(&["export", text(&file), "--format", "all", "-o", text(&all)]);
    assert!(others.code == Some(0) && others.stderr.contains("mrcal has no model"), "{others:?}");
    assert!(all.join("camera.yaml").exists() && !all.join("camera.cameramodel").exists());
    for (arguments, part) in [
        (&["--format", "all"][..], "-o DIR"),
        (&["--format", "rosbag"], "opencv-yaml"),
        (&["--camera-name", "x", "--c-header", "x.h"], "--format"),
        (&["--format", "ros", "--json"], "-o FILE"),
    ] {
        let rejected = evcal(&[&["export", text(&file)], arguments].concat());
        assert!(rejected.code == Some(2) && rejected.stderr.contains(part), "{arguments:?}: {rejected:?}");
    }
}
