//! Calibrations in which each frame is a view with its own pose: images without events, and points that another program found.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use evcal_tests::accuracy::Accuracy;
use evcal_tests::lens::RADTAN4;
use evcal_tests::values::numbers;
use evcal_tests::{BOARD, evcal, made, read_json, succeed, text};
use serde_json::Value;

use crate::second_camera::frame_simulation;

fn calibrated(name: &str, input: &Path, options: &[&str]) -> Value {
    let arguments = [&["calibrate", text(input), "--board", BOARD, "--accept-any"], options].concat();
    read_json(&made(name, &arguments).join("calibration.json"))
}

/// A folder with timestamps, and one with nothing but images.
#[test]
fn a_folder_of_images_calibrates_its_camera() {
    let simulation = frame_simulation();
    let table = calibrated("images-with-table", &simulation.join("second"), &["--frames-only"]);
    let truth = &read_json(&simulation.join("truth.json"))["second_camera"]["camera"];
    for name in ["fx", "fy", "cx", "cy"] {
        let value = |camera: &Value| numbers(&camera["parameters"][name])[0];
        let (error, sigma) = (value(&table["camera"]) - value(truth), numbers(&table["sigma"]["parameters"][name])[0]);
        assert!(error.abs() < 4.0 * sigma && error.abs() < 0.5, "{name} is off by {error} ± {sigma}");
    }
    let images = calibrated("images-alone", &simulation.join("second/data"), &["--frames-only"]);
    assert_eq!((&images["camera"], &images["sigma"]), (&table["camera"], &table["sigma"]));
    let second = simulation.join("second");
    let without = evcal(&["calibrate", text(&second), "--board", BOARD, "-o", text(&simulation.join("unused"))]);
    assert!(without.code == Some(1) && without.stderr.contains("--frames-only"), "{}", without.stderr);
}

/// The dots of a recording's frames, with numbers of frames instead of times.
#[test]
fn points_without_times_calibrate_their_camera() {
    let recording = RADTAN4.recording_with_frames();
    let calibration = RADTAN4.calibration_with("frames-only", &recording, &["--frames-only"]);
    let circles = fs::read_to_string(calibration.join("circles.csv")).unwrap();
    let mut lines = circles.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let wanted = ["frame", "x_px", "y_px", "column", "row"];
    let places = wanted.map(|name| names.iter().position(|other| *other == name).unwrap());
    let mut points = wanted.join(",") + "\n";
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        writeln!(points, "{}", places.map(|place| fields[place]).join(",")).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("points.csv");
    fs::write(&file, points).unwrap();
    let result = folder.path().join("result");
    let given = ["calibrate", text(&file), "--sensor", "346x260", "--board", BOARD, "--model", RADTAN4.model];
    succeed(&[&given[..], &["--accept-any", "--fix", "p1=0", "-o", text(&result)]].concat());
    let accuracy = Accuracy::of(&result, &recording);
    assert!(accuracy.focal <= 1e-3 && accuracy.projection_rms <= 0.2, "{accuracy:?}");
    let found = read_json(&result.join("calibration.json"));
    assert!(found["frames"]["only"].is_object() && found["camera"]["parameters"]["p1"] == 0.0, "{found:#}");
    let unused = folder.path().join("unused");
    let refused = evcal(&[&given[..], &["--fix", "bend-x=0mm", "-o", text(&unused)]].concat());
    assert!(
        refused.code == Some(1) && refused.stderr.contains("leave out --fix and --free of the board"),
        "{}",
        refused.stderr
    );
}
