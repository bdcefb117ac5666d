//! The camera's own frames: calibration from frames alone, cross-check of the events, and joint calibration with the events.

use std::path::Path;

use evcal_tests::accuracy::Accuracy;
use evcal_tests::lens::{Lens, RADTAN4};
use evcal_tests::{BOARD, evcal, made, read_json, text};
use serde_json::Value;

const LENS: Lens = RADTAN4;
/// A lens with a focal length 1 % longer and another principal point.
const WRONG_LENS: &str = "334.5,334.0,175.6,126.4,-0.33,0.12,0.0006,-0.0004";

fn cross_check(calibration: &Path) -> Value {
    read_json(&calibration.join("calibration.json"))["frames"]["cross-check"].clone()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

#[test]
fn frames_and_events_of_one_recording_agree_within_their_uncertainty() {
    let recording = LENS.recording_with_frames();
    let check = cross_check(&LENS.calibration_with("frames-cross-check", &recording, &[]));
    assert_eq!(check["agreement"], "agrees", "{check}");
    assert!(number(&check["ratio"]) <= 2.0, "{check}");
    // The cross-check is precise enough to show a disagreement.
    assert!(number(&check["expected"]["rms"]) < 0.2, "{check}");
    // The errors are within the reported uncertainty.
    let truth = read_json(&recording.join("truth.json"));
    for parameter in check["parameters"].as_array().unwrap() {
        let name = parameter["name"].as_str().unwrap();
        let error = number(&parameter["frames"]) - number(&truth["camera"]["parameters"][name]);
        assert!(error.abs() <= 4.0 * number(&parameter["frames_sigma"]), "{name} is off by {error}: {parameter}");
    }
}

/// The lens took up the bend of the board: its error was ten times the stated bound, without a word.
#[test]
fn a_bent_board_in_frames_is_named_and_the_bound_contains_its_effect() {
    let board = "checkerboard:6x9:25mm";
    let simulated = ["simulate", "--board", board, "--duration", "2s", "--frames", "20", "--seed", "8"];
    for (name, bend) in [("flat", "0mm,0mm"), ("bent", "0.3mm,0.1mm")] {
        let recording = made(&format!("frames-{name}"), &[&simulated[..], &["--bend", bend]].concat());
        let events = recording.join("events.aedat4");
        let only = ["--board", board, "--frames-only", "--accept-any"];
        let calibration = made(&format!("frames-{name}-only"), &[&["calibrate", text(&events)][..], &only].concat());
        let result = read_json(&calibration.join("calibration.json"));
        let bound = number(&result["uncertainty"]["projection_rms_95"]);
        let error = Accuracy::of(&calibration, &recording).projection_rms;
        assert!(error <= bound, "{name}: {error} px, stated {bound} px");
        let names_it = result["verdict"]["sentence"].as_str().unwrap().contains("the board is not as described");
        assert_eq!(names_it, name == "bent", "{name}: {}", result["verdict"]);
    }
}

#[test]
fn frames_through_another_lens_disagree() {
    let options = ["--motion", "fast", "--duration", "4s", "--frames", "--frame-lens", WRONG_LENS];
    let recording = LENS.simulation("frames-wrong-lens", &options);
    let calibration = LENS.calibration_with("frames-wrong-lens-cross-check", &recording, &[]);
    let check = cross_check(&calibration);
    assert_eq!(check["agreement"], "disagrees", "{check}");
    assert!(number(&check["ratio"]) > 5.0, "{check}");
    let stages = std::fs::read_to_string(calibration.join("stages.txt")).unwrap();
    assert!(stages.contains("DISAGREE"), "{stages}");
    // The calibration from events is not affected.
    assert!(Accuracy::of(&calibration, &recording).projection_rms <= 0.1);
}

#[test]
fn frames_alone_calibrate_the_camera() {
    let recording = LENS.recording_with_frames();
    let calibration = LENS.calibration_with("frames-only", &recording, &["--frames-only"]);
    let accuracy = Accuracy::of(&calibration, &recording);
    assert!(accuracy.focal <= 1e-3 && accuracy.center <= 0.5, "{accuracy:?}");
    assert!(accuracy.projection_rms <= 0.1 && accuracy.projection_max <= 0.3, "{accuracy:?}");
    // Each frame has its own pose, in the middle of its exposure.
    assert!(accuracy.position <= 2e-3, "{accuracy:?}");
    for file in ["camera.yaml", "circles.csv", "settings.toml", "stages.txt", "trajectory.txt"] {
        assert!(calibration.join(file).exists(), "{file}");
    }
    let report = &read_json(&calibration.join("calibration.json"))["frames"]["only"]["report"];
    let (read, used) = (number(&report["detection"]["frames"]), number(&report["used"]));
    assert!((99.0..=100.0).contains(&read) && used >= 0.5 * read, "{report}");
}

#[test]
fn frames_and_events_are_solved_together() {
    let recording = LENS.recording_with_frames();
    let calibration = LENS.calibration_with("joint-frames", &recording, &["--joint-frames"]);
    let accuracy = Accuracy::of(&calibration, &recording);
    assert!(accuracy.focal <= 1e-3 && accuracy.center <= 0.5, "{accuracy:?}");
    assert!(accuracy.projection_rms <= 0.1 && accuracy.projection_max <= 0.3, "{accuracy:?}");
    let joint = &read_json(&calibration.join("calibration.json"))["joint_frames"];
    assert!(number(&joint["dots"]) > 1000.0, "{joint}");
    // Because of the pixel latency, events lag behind the frames.
    let (offset, sigma) = (number(&joint["time_offset"]), number(&joint["time_offset_sigma"]));
    assert!(offset > 0.0 && offset < 3e-3 && sigma < 1e-4, "{joint}");
}

#[test]
fn a_recording_without_frames_is_rejected() {
    let events = LENS.recording().join("events.aedat4");
    for option in ["--frames-only", "--joint-frames"] {
        let folder = tempfile::tempdir().unwrap();
        let output = text(folder.path());
        let finished = evcal(&["calibrate", text(&events), "--board", BOARD, option, "-o", output]);
        assert_eq!(finished.code, Some(1), "{option}: {}", finished.stderr);
        assert!(finished.stderr.contains("contains no frames"), "{option}: {}", finished.stderr);
    }
}
