//! Boards of squares whose description is wrong: every command uses the board in view, and says so.

use std::path::PathBuf;

use evcal_tests::{evcal, made, read_json, text};

/// Printed boards, seeds, and wrong descriptions of them: tags turned by half a turn as OpenCV draws them, numbered from the top row,
/// with a border of one module, with another first id, and a ChArUco board of the older layout.
const STATED: [(&str, &str, &str); 5] = [
    ("aprilgrid:4x5:45mm:0.3:turned180", "31", "aprilgrid:4x5:45mm:0.3"),
    ("apriltags:3x4:60mm:0.25:down:turned180", "32", "apriltags:3x4:60mm:0.25"),
    ("aprilgrid:4x5:45mm:0.3:border1", "33", "aprilgrid:4x5:45mm:0.3"),
    ("aprilgrid:4x4:50mm:0.3:first7:turned90", "34", "aprilgrid:4x4:50mm:0.3"),
    ("charuco:6x5:50mm:37mm:DICT_4X4_100:legacy", "35", "charuco:6x5:50mm:37mm:DICT_4X4_100"),
];

fn simulated(board: &str, seed: &str) -> PathBuf {
    let options = ["simulate", "--board", board, "--duration", "2s", "--seed", seed, "--frames", "10"];
    made(&format!("stated-board-{seed}"), &options).join("events.aedat4")
}

/// Returns the result of a calibration from frames.
fn calibrated(board: &str, seed: &str, stated: &str) -> serde_json::Value {
    let events = simulated(board, seed);
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("result");
    let only = ["--frames-only", "--threads", "2", "--accept-any"];
    let finished = evcal(&[&["calibrate", text(&events), "--board", stated, "-o", text(&output)][..], &only].concat());
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    read_json(&output.join("calibration.json"))
}

/// The board in view used to be refused as another one, or, with a wrong layout or first id, the trajectory was one square off.
#[test]
fn a_check_and_calibrations_from_frames_use_the_board_in_view() {
    for (board, seed, stated) in STATED {
        assert_eq!(calibrated(board, seed, stated)["board"], board, "frames of {board}");
        let events = simulated(board, seed);
        let checked = evcal(&["check", text(&events), "--board", stated]);
        assert!(checked.stderr.contains(&format!("shows the board {board}, not {stated}: ")), "{board}: {checked:?}");
        assert!(checked.stdout.contains(&format!("{board} seen in")), "{board}: {checked:?}");
    }
}

/// No corner was found in frames, and the advice was to record longer.
#[test]
fn markers_have_the_size_that_frames_show() {
    let [.., (board, seed, _)] = STATED;
    assert_eq!(calibrated(board, seed, "charuco:6x5:50mm:30mm:DICT_4X4_100:legacy")["board"], board);
}

/// The difference was a line on standard error, and the verdict blamed the residuals that it caused on the lens.
#[test]
fn a_gap_that_is_not_the_printed_one_is_in_the_verdict() {
    let [(board, seed, _), ..] = STATED;
    let verdict = &calibrated(board, seed, "aprilgrid:4x5:45mm:0.25:turned180")["verdict"];
    let findings = verdict["findings"].as_array().expect("findings");
    let finding = findings.iter().find(|finding| finding["cause"] == "lengths-disagree").expect("a finding");
    assert!(finding["advice"].as_str().is_some_and(|advice| advice.contains(board)), "{finding:#}");
    assert_ne!(verdict["grade"], "good");
}
