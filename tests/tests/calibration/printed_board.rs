//! Boards that differ from their nominal dimensions, flat boards, and parameters that the user fixes.

use std::path::Path;

use evcal_tests::accuracy::Accuracy;
use evcal_tests::lens::RADTAN;
use evcal_tests::{BOARD, evcal, json, read_json, text};
use serde_json::Value;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

/// Checks that a parameter of the board was estimated, within 4 σ of the truth and with σ below `largest_sigma`.
fn assert_estimated(calibration: &Path, name: &str, truth: f64, largest_sigma: f64) {
    let board = &read_json(&calibration.join("calibration.json"))["printed_board"];
    let parameter = &board[name];
    assert_eq!(parameter["estimated"], true, "{board}");
    let (value, sigma) = (number(&parameter["value"]), number(&parameter["sigma"]));
    assert!((value - truth).abs() < 4.0 * sigma && sigma < largest_sigma, "{name}: {parameter}, true {truth}");
}

#[test]
fn a_bent_board_printed_unevenly_is_estimated_with_the_camera() {
    let options = ["--motion", "fast", "--duration", "4s", "--bend=2mm,-1mm", "--print-ratio", "1.003"];
    let recording = RADTAN.simulation("bent-board", &options);
    let calibration = RADTAN.calibration_with("bent-board-calibration", &recording, &[]);
    assert_estimated(&calibration, "bend_x", 2e-3, 5e-5);
    assert_estimated(&calibration, "bend_y", -1e-3, 5e-5);
    assert_estimated(&calibration, "print_ratio", 1.003, 3e-4);
    // With the nominal board the focal length would be wrong by more than 0.2 %.
    let result = read_json(&calibration.join("calibration.json"));
    let board = &result["printed_board"];
    assert_eq!(board["radius"]["estimated"], false, "{board}");
    let focal = number(&result["camera"]["parameters"]["fx"]);
    assert!((number(&board["camera_as_stated"]["parameters"]["fx"]) / focal - 1.0).abs() > 2e-3, "{board}");
    let accuracy = Accuracy::of(&calibration, &recording);
    assert!(accuracy.focal <= 1e-3 && accuracy.projection_rms <= 0.1 && accuracy.position <= 2e-3, "{accuracy:?}");
    // The verdict reports the bend.
    let findings = result["verdict"]["findings"].as_array().unwrap();
    let finding = findings.iter().find(|finding| finding["cause"] == "board-not-as-stated").unwrap();
    assert!(
        finding["reason"].as_str().is_some_and(|reason| reason.starts_with("the board is bent by 2.0")),
        "{finding}"
    );
    let evaluation = json(&["evaluate", text(&calibration), "--truth", text(&recording), "--json"]);
    assert_eq!(evaluation["board"]["bend_x"]["truth"], 2e-3, "{evaluation}");
}

#[test]
fn circles_of_another_radius_are_estimated() {
    let options = ["--motion", "fast", "--duration", "4s", "--printed-radius", "16.8mm"];
    let recording = RADTAN.simulation("small-circles", &options);
    let calibration = RADTAN.calibration_with("small-circles-calibration", &recording, &[]);
    assert_estimated(&calibration, "radius", 16.8e-3, 3e-4);
    let accuracy = Accuracy::of(&calibration, &recording);
    assert!(accuracy.focal <= 1e-3 && accuracy.projection_rms <= 0.1, "{accuracy:?}");
}

#[test]
fn a_flat_board_keeps_its_nominal_dimensions() {
    let calibration = RADTAN.own_calibration();
    let board = &read_json(&calibration.join("calibration.json"))["printed_board"];
    for name in ["print_ratio", "bend_x", "bend_y", "radius"] {
        assert_eq!(board[name]["estimated"], false, "{board}");
    }
    assert!(board["camera_as_stated"].is_null());
    // The estimate that the bend would have if it were estimated is reported as well.
    assert!(number(&board["bend_x"]["if_free"]["sigma"]) < 5e-5, "{board}");
}

#[test]
fn fixed_parameters_stay_and_freed_parameters_are_estimated() {
    let recording = RADTAN.recording();
    let options = ["--fix", "k3=0", "--fix", "radius=17.4mm", "--free", "bend-y"];
    let calibration = RADTAN.calibration_with("fixed-and-free", &recording, &options);
    let result = read_json(&calibration.join("calibration.json"));
    assert_eq!(number(&result["camera"]["parameters"]["k3"]), 0.0);
    assert_eq!(number(&result["sigma"]["parameters"]["k3"]), 0.0);
    let board = &result["printed_board"];
    assert_eq!((number(&board["radius"]["value"]), &board["radius"]["estimated"]), (0.0174, &Value::Bool(false)));
    assert_estimated(&calibration, "bend_y", 0.0, 1e-4);
}

#[test]
fn the_message_about_an_unknown_parameter_lists_all_parameters() {
    let events = RADTAN.recording().join("events.aedat4");
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    for option in [["--fix", "k9=0"], ["--free", "bend"]] {
        let options = ["calibrate", text(&events), "--board", BOARD, "-o", text(&output)];
        let finished = evcal(&[&options[..], &option].concat());
        assert_eq!(finished.code, Some(2), "{finished:?}");
        let named = finished.stderr.contains("k1, k2, p1, p2, k3, print-ratio, bend-x, bend-y, radius");
        assert!(named, "{}", finished.stderr);
    }
    assert!(!output.exists());
}
