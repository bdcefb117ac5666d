//! Two simulated event cameras on one mount: where the second one is, how its clock goes, and mistakes named.

use std::fs;
use std::path::PathBuf;

use evcal_tests::values::{numbers, pose};
use evcal_tests::{BOARD, evcal, made, read_json, session, text};
use nalgebra::Vector3;
use serde_json::Value;

fn simulation() -> PathBuf {
    made(
        "second-camera",
        &["simulate", "--board", BOARD, "--motion", "fast", "--duration", "9s", "--seed", "32", "--second-camera"],
    )
}

fn calibration() -> PathBuf {
    let folder = simulation();
    let (first, second) = (folder.join("events.aedat4"), folder.join("second.aedat4"));
    made("second-camera-calibrated", &["calibrate", text(&first), "--with", text(&second), "--board", BOARD])
}

#[test]
fn the_second_camera_is_found_where_it_is() {
    let truth = &read_json(&simulation().join("truth.json"))["second_camera"];
    let found = &read_json(&calibration().join("calibration.json"))["second_cameras"][0];
    let (is, was) = (pose(&found["T_second_first"]), pose(&truth["T_second_first"]));
    let moved = is.translation.vector - was.translation.vector;
    let turned = (was.rotation.inverse() * is.rotation).scaled_axis();
    let bounds = [("translation_sigma", moved, 2e-4), ("rotation_sigma", turned, 0.02f64.to_radians())];
    for (name, error, bound) in bounds {
        let sigma = Vector3::from_vec(numbers(&found[name]));
        assert!(error.norm() < bound && sigma.amax() < bound, "{name}: off by {error}, σ {sigma}");
        assert!(error.component_div(&sigma).amax() < 4.5, "{name}: off by {error}, σ {sigma}");
    }
    // t_second = clock_offset + t_first (1 + drift); pixels of both answer equally late.
    let settings = &truth["settings"];
    let rate = 1e-6 * numbers(&settings["clock_drift"])[0];
    let at = numbers(&found["time_offset_at"])[0];
    let offset = at - (at - numbers(&settings["clock_offset"])[0]) / (1.0 + rate);
    let error = numbers(&found["time_offset"]["value"])[0] - offset;
    let sigma = numbers(&found["time_offset"]["sigma"])[0];
    assert!(error.abs() < 4.5 * sigma && error.abs() < 6e-5 && sigma < 6e-5, "{error} ± {sigma}");
    assert!(found["clock_rate"].is_null(), "9 s are too short to state it");
    // The lens of the second camera is another one.
    let focal = |camera: &Value| numbers(&camera["parameters"]["fx"])[0];
    let (lens, was) = (focal(&found["solved_together"][1]["camera"]), focal(&truth["camera"]));
    assert!((lens - was).abs() < 0.3, "{lens} {was}");
}

#[test]
fn what_was_found_is_in_words_and_files() {
    let folder = calibration();
    let report = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(report.contains("The second camera") && report.contains("t_second = t_first + 3.21"));
    let files = ["camchain-cameras.yaml", "stereo.yaml", "static_transforms.yaml"];
    for name in files {
        assert!(folder.join("exports").join(name).exists() && report.contains(name), "{name}");
    }
}

#[test]
fn mistakes_are_named() {
    let folder = simulation();
    let (first, second) = (folder.join("events.aedat4"), folder.join("second.aedat4"));
    let scratch = tempfile::tempdir().unwrap();
    let refused = |words: &str, arguments: &[&str]| {
        let result = scratch.path().join(words.replace([' ', ':'], "-"));
        let options = ["--board", BOARD, "--accept-any", "-o", text(&result)];
        let finished = evcal(&[&["calibrate"], arguments, &options].concat());
        assert_eq!(finished.code, Some(1), "{}", finished.stderr);
        assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
        result
    };
    refused("a camera that is there already", &[text(&first), "--with", text(&first)]);
    // Known by its events, not by its name; the first camera is calibrated all the same.
    let copy = scratch.path().join("copy.aedat4");
    fs::copy(&first, &copy).unwrap();
    let result = refused("there already: give the recording", &[text(&first), "--with", text(&copy)]);
    assert!(result.join("calibration.json").exists());
    refused("give one recording before --with", &[text(&first), text(&second), "--with", text(&second)]);
    let other = made(
        "second-camera-other",
        &["simulate", "--board", BOARD, "--motion", "fast", "--duration", "4s", "--seed", "33"],
    );
    let other = other.join("events.aedat4");
    refused("recordings of the same session", &[text(&first), "--with", text(&other)]);
}

/// Frames and events of a DAVIS have one eye.
#[test]
fn own_frames_are_where_the_events_are() {
    let recording = session().join("events.dvraw");
    let folder = made("own-frames", &["calibrate", text(&recording), "--board", BOARD, "--with-frames"]);
    let found = &read_json(&folder.join("calibration.json"))["second_cameras"][0];
    assert_eq!(found["from_identity"]["agrees"], true, "{found}");
    let pose = pose(&found["T_second_first"]);
    let [turn, place] = ["rotation_sigma", "translation_sigma"].map(|name| Vector3::from_vec(numbers(&found[name])));
    assert!(turn.amax() < 0.1f64.to_radians() && place.amax() < 1e-3, "σ {turn} {place}");
    assert!(pose.rotation.scaled_axis().component_div(&turn).amax() < 3.5, "{pose} σ {turn}");
    assert!(pose.translation.vector.component_div(&place).amax() < 3.5, "{pose} σ {place}");
}
