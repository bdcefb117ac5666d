//! `calibration.json` is one type: a file that is read and written again is identical, and exports need nothing else.

use std::fs;
use std::path::{Path, PathBuf};

use evcal_calibrate::result::calibration_file::{CalibrationFile, FramesResult};
use evcal_tests::{BOARD, evcal, made, session_calibration, text};

fn recording() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("fixtures").join("board/events.dvraw")
}

/// Reads the file and checks that writing it again yields the same bytes.
fn round_trip(folder: &Path) -> CalibrationFile {
    let written = fs::read_to_string(folder.join("calibration.json")).unwrap();
    let read: CalibrationFile = serde_json::from_str(&written).unwrap();
    assert_eq!(serde_json::to_string_pretty(&read).unwrap(), written);
    read
}

#[test]
fn a_calibration_with_a_cross_check_survives_a_round_trip() {
    let file = round_trip(&session_calibration());
    assert!(matches!(file.frames, Some(FramesResult::CrossCheck(_))));
    assert!(file.residual_pattern.is_some() && file.stages.detection.is_some() && !file.event_classes.is_empty());
    // From the header of the recording.
    assert_eq!(file.camera_name.as_deref(), Some("DAVIS346_evcalsim"));
    let yaml = fs::read_to_string(session_calibration().join("camera.yaml")).unwrap();
    let comments: Vec<&str> = yaml.lines().filter(|line| line.starts_with("# ")).collect();
    let version = concat!("evcal ", env!("CARGO_PKG_VERSION"));
    for part in [version, "camera DAVIS346_evcalsim", &file.verdict.sentence.replace('±', "+-")] {
        assert!(comments.iter().any(|line| line.contains(part)), "{part}: {comments:?}");
    }
    let report = fs::read_to_string(session_calibration().join("report.html")).unwrap();
    assert!(report.contains("<title>DAVIS346_evcalsim: radtan calibration</title>"));
    assert!(file.stages.trajectory.is_some_and(|stages| !stages.rounds.is_empty()));
}

#[test]
fn a_calibration_from_frames_alone_has_no_stages_of_events() {
    let folder = made("pictures-only", &["calibrate", text(&recording()), "--board", BOARD, "--frames-only"]);
    let file = round_trip(&folder);
    assert!(matches!(file.frames, Some(FramesResult::Only(_))));
    assert!(file.stages.detection.is_none() && file.stages.trajectory.is_none() && file.residual_pattern.is_none());
}

#[test]
fn a_calibration_from_circles_contains_the_choice_of_the_model() {
    let circles = session_calibration().join("circles.csv");
    let arguments = ["calibrate", text(&circles), "--board", BOARD, "--sensor", "346x260", "--model", "auto"];
    let file = round_trip(&made("circles-auto", &arguments));
    assert!(file.stages.model_choice.is_some() && file.event_classes.is_empty() && file.frames.is_none());
}

#[test]
fn an_export_of_the_file_equals_the_export_of_the_calibration() {
    let folder = session_calibration();
    let calibration = folder.join("calibration.json");
    for (format, file) in
        [("opencv-yaml", "camera.yaml"), ("ros", "exports/camera_info.yaml"), ("kalibr", "exports/camchain.yaml")]
    {
        // Kalibr does not have the model, which is noted on standard error.
        let exported = evcal(&["export", text(&calibration), "--format", format]);
        assert_eq!(exported.code, Some(0), "{}", exported.stderr);
        assert_eq!(exported.stdout, fs::read_to_string(folder.join(file)).unwrap(), "{format}");
    }
}
