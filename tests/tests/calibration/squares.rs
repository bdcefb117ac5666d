//! Boards of squares: the estimated lens is close to the simulated one with every kind of board.

use evcal_tests::accuracy::Accuracy;
use evcal_tests::{made, read_json, text};

/// Checks the calibration from three seconds of a hand-moved `board`.
fn calibrates(name: &str, board: &str) {
    let lens = ["--model", "radtan4", "--parameters", "332,332,173.3,128.6,-0.35,0.15,0,0"];
    let simulated = [&["simulate", "--board", board, "--motion", "fast", "--duration", "3s"][..], &lens].concat();
    let recording = made(&format!("squares-{name}"), &simulated);
    let events = recording.join("events.aedat4");
    let calibration = made(
        &format!("squares-calibration-{name}"),
        &["calibrate", text(&events), "--board", board, "--model", "radtan4", "--threads", "2", "--accept-any"],
    );
    let accuracy = Accuracy::of(&calibration, &recording);
    assert!(accuracy.focal <= 1e-3, "{board}: {accuracy:?}");
    assert!(accuracy.projection_rms <= 0.1, "{board}: {accuracy:?}");
    let result = read_json(&calibration.join("calibration.json"));
    let bound = result["uncertainty"]["projection_rms_95"].as_f64().unwrap();
    assert!(accuracy.projection_rms <= bound, "{board}: {accuracy:?}, reported bound {bound}");
}

#[test]
fn checkerboard() {
    calibrates("checkerboard", "checkerboard:6x9:25mm");
}

#[test]
fn aprilgrid() {
    calibrates("aprilgrid", "aprilgrid:4x4:50mm:0.3");
}

#[test]
fn sheet_of_apriltags() {
    calibrates("apriltags", "apriltags:3x4:60mm:0.25");
}

#[test]
fn charuco() {
    calibrates("charuco", "charuco:5x7:40mm:30mm:DICT_4X4_50");
}
