//! Calibrations in which evcal chooses the model: radtan for common lenses, another model for lenses that radtan cannot follow.

use evcal_tests::lens::{self, Lens};
use evcal_tests::{BOARD, json, made, read_json, text};
use serde_json::Value;

/// Fisheyes of 200°, 160° and 190°, and the seeds of their recordings.
const FISHEYES: [(Lens, &str); 3] = [
    (Lens { model: "kannala-brandt", parameters: "105,105,173,130,0.02,-0.005,0.001,0" }, "15"),
    (Lens { model: "double-sphere", parameters: "122.7,122.6,174.1,128.4,-0.2,0.58" }, "240"),
    (Lens { model: "eucm", parameters: "130,129.9,172.4,129.5,0.62,1.05" }, "281"),
];

/// Returns the result of `calibrate` with these `options`, and its error (px, rms) if it was compared with the truth.
fn calibrated(lens: Lens, name: &str, seed: &str, options: &[&str]) -> (Value, Option<f64>) {
    let simulation = lens.simulation(name, &["--duration", "3s", "--seed", seed]);
    let events = simulation.join("events.aedat4");
    let arguments =
        [&["calibrate", text(&events), "--board", BOARD, "--threads", "2", "--accept-any"], options].concat();
    let folder = made(&format!("{name}-{}", options.len()), &arguments);
    let evaluation = json(&["evaluate", text(&folder), "--truth", text(&simulation), "--json"]);
    let error = evaluation["projection_difference"]["rms_px"].as_f64();
    (read_json(&folder.join("calibration.json")), error)
}

#[test]
fn a_fisheye_is_calibrated_with_a_model_that_follows_it() {
    for (lens, seed) in FISHEYES {
        let (calibration, error) = calibrated(lens, &format!("fisheye-{}", lens.model), seed, &[]);
        let (verdict, error) = (&calibration["verdict"], error.expect("an error"));
        let bound = calibration["uncertainty"]["projection_rms_95"].as_f64().expect("a number");
        assert_ne!(calibration["camera"]["model"], "radtan", "{}: {verdict:#}", lens.model);
        assert_ne!(verdict["grade"], "not-good", "{}: {verdict:#}", lens.model);
        assert!(error <= bound && error < 0.05, "{}: {error} px for {bound} px", lens.model);
    }
}

/// On a lens of 220°, omni explains the events of this recording as well as the model of the lens does, and differs from it by half a
/// pixel where the board was not seen. The bound includes the difference.
#[test]
fn a_model_that_explains_the_events_as_well_is_a_part_of_the_bound() {
    let lens = Lens { model: "kannala-brandt", parameters: "108.47,108.36,174.1,128.4,0.02,-0.005,0.0006,0" };
    let (calibration, error) = calibrated(lens, "two-models", "230", &["--model", "auto"]);
    let bound = calibration["uncertainty"]["projection_rms_95"].as_f64().expect("a number");
    let error = error.expect("an error");
    assert!(error <= bound, "{error} px for {bound} px: {:#}", calibration["verdict"]);
}

/// The model that the user names is kept. It folds over at half of the pixels, so the calibration is not good, and the verdict names
/// one model, not a wavy board.
#[test]
fn a_named_model_that_folds_over_is_not_good() {
    let (lens, seed) = FISHEYES[0];
    let (calibration, _) = calibrated(lens, &format!("fisheye-{}", lens.model), seed, &["--model", "radtan"]);
    let verdict = &calibration["verdict"];
    assert_eq!((&calibration["camera"]["model"], &verdict["grade"]), (&"radtan".into(), &"not-good".into()));
    let findings = verdict["findings"].as_array().expect("findings");
    let advice = |cause: &str| {
        let finding = findings.iter().find(|finding| finding["cause"] == cause)?;
        finding["advice"].as_str()
    };
    let folded = advice("not-one-to-one").expect("a finding");
    let model = folded.strip_prefix("calibrate again with --model ").expect("a model");
    assert!(["kannala-brandt", "eucm", "double-sphere", "omni"].contains(&model), "{model}");
    assert!(advice("model-too-poor").is_none_or(|advice| advice == folded), "{verdict:#}");
}

/// Common lenses keep radtan, with or without its name.
#[test]
fn a_common_lens_is_calibrated_with_radtan() {
    let simulation = lens::RADTAN.recording();
    let events = simulation.join("events.aedat4");
    let folder = made("common-lens", &["calibrate", text(&events), "--board", BOARD, "--threads", "2"]);
    let result = read_json(&folder.join("calibration.json"));
    let named = read_json(&lens::RADTAN.own_calibration().join("calibration.json"));
    assert_eq!((&result["camera"], &result["sigma"]), (&named["camera"], &named["sigma"]));
    assert_eq!(result["verdict"]["grade"], named["verdict"]["grade"]);
}
