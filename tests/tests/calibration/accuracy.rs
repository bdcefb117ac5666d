//! Simulates, calibrates and evaluates with each camera model: the estimated camera is close to the simulated one.

use evcal_tests::accuracy::Accuracy;
use evcal_tests::lens::{self, Lens};
use evcal_tests::{BOARD, json, made, read_json, text};

/// Checks the calibration from four seconds of a hand-moved board with the default settings.
fn calibrates(lens: Lens) {
    let accuracy = Accuracy::of(&lens.own_calibration(), &lens.recording());
    let model = lens.model;
    assert!(accuracy.focal <= 1e-3, "{model}: {accuracy:?}");
    assert!(accuracy.center <= 0.5, "{model}: {accuracy:?}");
    assert!(accuracy.projection_rms <= 0.1, "{model}: {accuracy:?}");
    assert!(accuracy.projection_max <= 0.3, "{model}: {accuracy:?}");
    // Only the wide lens, which is closer to the board, stays below 1 mm.
    assert!(accuracy.position <= 2e-3, "{model}: {accuracy:?}");
}

#[test]
fn radtan4() {
    calibrates(lens::RADTAN4);
}

#[test]
fn radtan() {
    calibrates(lens::RADTAN);
}

#[test]
fn radtan8() {
    calibrates(lens::RADTAN8);
}

#[test]
fn kannala_brandt() {
    calibrates(lens::KANNALA_BRANDT);
}

#[test]
fn inverse_radial() {
    calibrates(lens::INVERSE_RADIAL);
}

#[test]
fn double_sphere() {
    calibrates(lens::DOUBLE_SPHERE);
}

#[test]
fn omni() {
    calibrates(lens::OMNI);
}

#[test]
fn a_suitable_model_is_chosen_for_a_fisheye_lens() {
    let recording = lens::KANNALA_BRANDT.recording();
    let events = recording.join("events.aedat4");
    let calibration =
        made("auto", &["calibrate", text(&events), "--board", BOARD, "--model", "auto", "--threads", "2"]);
    let result = read_json(&calibration.join("calibration.json"));
    let model = result["camera"]["model"].as_str().unwrap();
    let choice = &result["stages"]["model_choice"];
    assert_eq!(choice["chosen"], model);
    assert!(choice["candidates"].as_array().is_some_and(|candidates| candidates.len() >= 9), "{choice}");
    assert!(!model.starts_with("radtan"), "{choice}");
    let projection =
        json(&["evaluate", text(&calibration), "--truth", text(&recording), "--json"])["projection_difference"].clone();
    assert!(projection["rms_px"].as_f64().is_some_and(|rms| rms <= 0.1), "{choice}: {projection}");
}
