//! Comparison with simulated motion capture: the pose of the marker body on the camera and the reported error of the
//! trajectory are close to the truth.

use std::fs;
use std::path::{Path, PathBuf};

use evcal_tests::values::{numbers, pose};
use evcal_tests::{BOARD, evcal, json, made, one_axis, read_json, text};
use nalgebra::Vector3;
use serde_json::Value;

fn simulation() -> PathBuf {
    made(
        "motion-capture",
        &["simulate", "--board", BOARD, "--motion", "fast", "--duration", "12s", "--seed", "31", "--motion-capture"],
    )
}

fn calibration() -> PathBuf {
    let events = simulation().join("events.aedat4");
    made("motion-capture-calibrated", &["calibrate", text(&events), "--board", BOARD, "--model", "radtan4"])
}

fn compared(capture: &Path) -> Value {
    json(&["evaluate", text(&calibration()), "--motion-capture", text(capture), "--json"])
}

#[test]
fn the_pose_of_the_marker_body_is_estimated_correctly() {
    let folder = simulation();
    let truth = &read_json(&folder.join("truth.json"))["motion_capture"];
    let found = compared(&folder.join("motion_capture.txt"));
    for (name, position, angle) in [("T_camera_body", 3e-4, 0.03f64), ("T_mocap_world", 1e-3, 0.05)] {
        let (is, was) = (pose(&found[name]["matrix"]), pose(&truth[name]));
        let shift = is.translation.vector - was.translation.vector;
        let rotation = (was.rotation.inverse() * is.rotation).scaled_axis();
        let pairs = [("translation_sigma", shift, position), ("rotation_sigma", rotation, angle.to_radians())];
        for (sigma, error, bound) in pairs {
            let sigma = Vector3::from_vec(numbers(&found[name][sigma]));
            assert!(error.amax() < bound, "{name}: off by {error}, σ {sigma}");
            assert!(
                error.component_div(&sigma).amax() < 4.5 && sigma.amax() < bound,
                "{name}: off by {error}, σ {sigma}"
            );
        }
    }
    // t_mocap = clock_offset + t (1 + drift), minus the pixel latency, here 0.1 to 0.2 ms.
    let settings = &truth["settings"];
    let clock = |t: f64| numbers(&settings["clock_offset"])[0] + t * 1e-6 * numbers(&settings["clock_drift"])[0];
    let offset = numbers(&found["offset"]["value"])[0] - clock(6.0);
    assert!((-2.5e-4..0.5e-4).contains(&offset), "{offset}");
    assert!(numbers(&found["offset"]["sigma"])[0] < 1e-4);
    assert!((numbers(&found["scale"]["value"])[0] - 1.0).abs() < 2e-3, "{}", found["scale"]);
    assert!(numbers(&found["rate"])[0].round() == 120.0, "{}", found["rate"]);
}

/// The held-out error, without the noise of the capture, is the error against the ground truth after alignment and the best time
/// shift, neither of which motion capture can determine.
#[test]
fn the_held_out_error_is_the_true_error() {
    let folder = simulation();
    let found = &compared(&folder.join("motion_capture.txt"))["held_out"]["position"];
    let against = json(&["evaluate", text(&calibration()), "--truth", text(&folder), "--json"]);
    let truth = numbers(&against["trajectory"]["best_time_shift"]["aligned_m"]["rmse"])[0];
    let (error, sigma) = (numbers(&found["error"]["value"])[0], numbers(&found["error"]["sigma"])[0]);
    assert!((error / truth - 1.0).abs() < 0.1, "{error} ± {sigma}, truth {truth}");
    assert!(sigma < 0.2 * truth, "{sigma} {truth}");
    // The noise is 0.3 mm along each axis, plus 0.2 degrees times the distance of the markers.
    let noise = numbers(&found["noise"])[0];
    assert!((5.0e-4..7.0e-4).contains(&noise), "{noise}");
    assert!(numbers(&found["sizes"]["rmse"])[0] > 1.5 * truth);
}

#[test]
fn wrong_units_orders_and_clocks_are_rejected() {
    let folder = simulation();
    let capture = fs::read_to_string(folder.join("motion_capture.txt")).unwrap();
    let scratch = tempfile::tempdir().unwrap();
    let rejected = |words: &str, change: fn(&[f64]) -> Vec<f64>| {
        let lines = capture.lines().filter(|line| !line.starts_with('#')).map(|line| {
            let fields: Vec<f64> = line.split(' ').map(|field| field.parse().unwrap()).collect();
            change(&fields).iter().map(f64::to_string).collect::<Vec<_>>().join(" ") + "\n"
        });
        let file = scratch.path().join("changed.txt");
        fs::write(&file, lines.collect::<String>()).unwrap();
        let finished = evcal(&["evaluate", text(&calibration()), "--motion-capture", text(&file)]);
        assert_eq!(finished.code, Some(1), "{}", finished.stderr);
        assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
    };
    rejected("in millimetres", |f| vec![f[0], 1e3 * f[1], 1e3 * f[2], 1e3 * f[3], f[4], f[5], f[6], f[7]]);
    rejected("w first", |f| vec![f[0], f[1], f[2], f[3], f[7], f[4], f[5], f[6]]);
    rejected("times in seconds", |f| vec![1e3 * f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7]]);
    // A clock that accelerates does not belong to any recording of the camera.
    rejected("recordings of the same session", |f| {
        vec![(f[0] - 12.3).powi(2) / 12.0, f[1], f[2], f[3], f[4], f[5], f[6], f[7]]
    });
}

/// The tests of `evcal-solve` cover other such motions.
#[test]
fn a_motion_that_does_not_determine_the_marker_body_is_rejected() {
    let simulation = one_axis();
    let events = simulation.join("events.aedat4");
    let options = ["--board", BOARD, "--model", "radtan4", "--accept-any"];
    let calibration = made("one-axis-calibrated", &[&["calibrate", text(&events)], &options[..]].concat());
    let capture = simulation.join("motion_capture.txt");
    let finished = evcal(&["evaluate", text(&calibration), "--motion-capture", text(&capture)]);
    assert_eq!(finished.code, Some(1), "{}", finished.stdout);
    let words = "the camera rotated about one axis only, its y axis";
    assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
}
