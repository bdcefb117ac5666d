//! Defects that were found and mended, one test each, in the order in which they were: the test fails as the program
//! did. Here are those that need a whole calibration; the others are in `host/evcal/tests/cli/regressions.rs`.

use std::fs;

use evcal_tests::lens::RADTAN4;
use evcal_tests::{BOARD, read_json, succeed, text};

/// Frames farther apart than those of the detection are still one trajectory: files of circles from elsewhere fell apart
/// into segments too short for any spline.
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

/// A calibration from frames alone has no trajectory: its report spoke of 0 segments, and of halves that could not be.
#[test]
fn the_report_of_frames_alone_leaves_out_what_they_do_not_have() {
    let recording = RADTAN4.recording_with_frames();
    let report = |name: &str, options: &[&str]| {
        let folder = RADTAN4.calibration_with(name, &recording, options);
        fs::read_to_string(folder.join("report.html")).unwrap()
    };
    let (frames, events) = (report("frames-only", &["--frames-only"]), report("frames-witness", &[]));
    for part in ["Trajectory segments", "id=\"halves\""] {
        assert!(events.contains(part) && !frames.contains(part), "{part}");
    }
}
