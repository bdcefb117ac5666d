//! Regression tests that need a whole calibration, one per bug. The others are in `host/evcal/tests/cli/regressions.rs`.

use std::fs;

use evcal_tests::lens::RADTAN4;
use evcal_tests::{BOARD, read_json, succeed, text};

/// Frames with longer intervals than the detection's are still one trajectory. They used to be split into segments that were too
/// short for a spline.
#[test]
fn a_circle_track_with_few_frames_is_calibrated() {
    let directory = tempfile::tempdir().unwrap();
    let circles = fs::read_to_string(RADTAN4.own_calibration().join("circles.csv")).unwrap();
    let mut kept = String::new();
    let mut frames = Vec::new();
    for line in circles.lines() {
        let frame = line.split(',').next().and_then(|field| field.parse::<u32>().ok());
        if frame.is_some_and(|frame| frame % 8 != 0) {
            continue;
        }
        frames.extend(frame);
        kept += line;
        kept.push('\n');
    }
    frames.dedup();
    assert!((30..80).contains(&frames.len()), "{} frames", frames.len());
    let (file, output) = (directory.path().join("few.csv"), directory.path().join("few"));
    fs::write(&file, kept).unwrap();
    let options =
        ["--board", BOARD, "--model", RADTAN4.model, "--sensor", "346x260", "--accept-any", "-o", text(&output)];
    succeed(&[&["calibrate", text(&file)][..], &options].concat());
    let focal = read_json(&output.join("calibration.json"))["camera"]["parameters"]["fx"].as_f64().unwrap();
    assert!((focal / 331.2 - 1.0).abs() < 0.01, "{focal}");
}

/// A calibration from frames alone has neither a trajectory nor a split-half check, so the report omits both.
#[test]
fn the_report_of_frames_alone_omits_the_trajectory() {
    let recording = RADTAN4.recording_with_frames();
    let report = |name: &str, options: &[&str]| {
        let folder = RADTAN4.calibration_with(name, &recording, options);
        fs::read_to_string(folder.join("report.html")).unwrap()
    };
    let (frames, events) = (report("frames-only", &["--frames-only"]), report("frames-cross-check", &[]));
    for part in ["Trajectory segments", "id=\"halves\""] {
        assert!(events.contains(part) && !frames.contains(part), "{part}");
    }
}
