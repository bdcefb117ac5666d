//! Interrupted recordings, and several recordings of one camera.

use std::fs;
use std::path::Path;

use evcal_tests::accuracy::Accuracy;
use evcal_tests::lens::RADTAN4;
use evcal_tests::{json, made, read_json, text};
use serde_json::Value;

fn segments(calibration: &Path) -> Vec<(u64, f64, f64)> {
    let calibration = read_json(&calibration.join("calibration.json"));
    let segment = |segment: &Value| {
        let time = |name: &str| segment[name].as_f64().unwrap();
        (segment["recording"].as_u64().unwrap(), time("start"), time("end"))
    };
    calibration["segments"].as_array().unwrap().iter().map(segment).collect()
}

/// Reads the intervals `motion.absences` or `motion.pauses` of a simulation.
fn spans(recording: &Path, name: &str) -> Vec<(f64, f64)> {
    let truth = read_json(&recording.join("truth.json"));
    let time = |span: &Value, name: &str| span[name].as_f64().unwrap();
    let spans = truth["settings"]["motion"][name].as_array().unwrap();
    spans.iter().map(|span| (time(span, "start"), time(span, "end"))).collect()
}

fn assert_accurate(calibration: &Path, truth: &Path) {
    let accuracy = Accuracy::of(calibration, truth);
    assert!(accuracy.focal <= 1e-3 && accuracy.center <= 0.5, "{accuracy:?}");
    assert!(accuracy.projection_rms <= 0.1 && accuracy.projection_max <= 0.3, "{accuracy:?}");
}

#[test]
fn pauses_and_a_board_that_leaves_the_view_split_the_trajectory() {
    let recording = RADTAN4.interrupted_recording();
    let calibration = RADTAN4.calibration("interrupted-calibration", &[&recording.join("events.aedat4")]);
    let segments = segments(&calibration);
    let interruptions = [spans(&recording, "pauses"), spans(&recording, "absences")].concat();
    assert!(interruptions.len() >= 3, "{interruptions:?}");
    // The camera sees no events while the board is still or out of view, so no segment spans such an interval.
    for &(start, end) in &interruptions {
        let across = segments.iter().find(|segment| segment.1 < start && segment.2 > end);
        assert_eq!(across, None, "interrupted from {start} to {end} s");
        assert!(segments.iter().any(|segment| segment.2 < end), "{segments:?} before {start} s");
    }
    assert!(segments.len() > interruptions.len(), "{segments:?}");
    assert_accurate(&calibration, &recording);
}

#[test]
fn several_recordings_of_one_camera_are_solved_together() {
    let (first, second) = (RADTAN4.recording(), RADTAN4.interrupted_recording());
    let events = [first.join("events.aedat4"), second.join("events.aedat4")];
    let calibration = RADTAN4.calibration("joint", &[&events[0], &events[1]]);
    let segments = segments(&calibration);
    for recording in [0, 1] {
        assert!(segments.iter().any(|segment| segment.0 == recording), "{segments:?}");
    }
    let result = read_json(&calibration.join("calibration.json"));
    let counts: Vec<u64> =
        result["stages"]["recordings"].as_array().unwrap().iter().map(|one| one["count"].as_u64().unwrap()).collect();
    let simulated = |folder: &Path| {
        let truth = read_json(&folder.join("truth.json"));
        truth["off_events"].as_u64().unwrap() + truth["on_events"].as_u64().unwrap()
    };
    assert_eq!(counts, [simulated(&first), simulated(&second)]);
    assert!(calibration.join("circles-2.csv").exists());
    assert_accurate(&calibration, &first);
    // Each recording has its own clock and trajectory.
    let [estimate, truth] = [calibration.join("trajectory-2.txt"), second.join("trajectory.txt")];
    let trajectories = ["--trajectory", text(&estimate), "--true-trajectory", text(&truth), "--json"];
    let figures = json(&[&["evaluate", text(&calibration), "--truth", text(&second)][..], &trajectories].concat());
    let error = figures["trajectory"]["best_time_shift"]["as_is_m"]["rmse"].as_f64().unwrap();
    assert!(error < 5e-3, "{error} m");
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let recording = RADTAN4.interrupted_recording().join("events.aedat4");
    let two = RADTAN4.calibration("interrupted-calibration", &[&recording]);
    let options = ["--board", evcal_tests::BOARD, "--model", RADTAN4.model, "--threads", "1", "--accept-any"];
    let one = made("interrupted-one-thread", &[&["calibrate", text(&recording)][..], &options].concat());
    let names = |folder: &Path| -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = entries.collect();
        names.sort_unstable();
        names
    };
    assert_eq!(names(&one), names(&two));
    for expected in ["calibration.json", "camera.yaml", "circles.csv", "good-frame.png", "trajectory.txt"] {
        assert!(names(&one).iter().any(|name| name == expected), "{expected}");
    }
    let (files, folders): (Vec<String>, Vec<String>) =
        names(&one).into_iter().partition(|name| one.join(name).is_file());
    let inner = folders
        .iter()
        .flat_map(|folder| names(&one.join(folder)).into_iter().map(move |name| format!("{folder}/{name}")));
    for name in files.into_iter().chain(inner) {
        let [one, two] = [&one, &two].map(|folder| fs::read(folder.join(&name)).unwrap());
        assert!(one == two, "{name} depends on the number of threads");
    }
}
