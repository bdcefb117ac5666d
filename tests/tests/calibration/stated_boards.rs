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

/// Returns the board of a calibration.
fn calibrated(board: &str, seed: &str, stated: &str, options: &[&str]) -> String {
    let events = simulated(board, seed);
    let arguments =
        [&["calibrate", text(&events), "--board", stated, "--threads", "2", "--accept-any"], options].concat();
    let folder = tempfile::tempdir().expect("a folder");
    let finished = evcal(&[&arguments[..], &["-o", text(&folder.path().join("result"))]].concat());
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    let result = read_json(&folder.path().join("result/calibration.json"));
    result["board"].as_str().expect("a board").to_owned()
}

/// The board in view used to be refused as another one, or, with a wrong layout or first id, the trajectory was one square off.
#[test]
fn a_check_and_calibrations_from_frames_use_the_board_in_view() {
    for (board, seed, stated) in STATED {
        assert_eq!(calibrated(board, seed, stated, &["--frames-only"]), board, "frames of {board}");
        let events = simulated(board, seed);
        let checked = evcal(&["check", text(&events), "--board", stated]);
        assert!(checked.stderr.contains(&format!("shows the board {board}, not {stated}: ")), "{board}: {checked:?}");
        assert!(checked.stdout.contains(&format!("{board} seen in")), "{board}: {checked:?}");
    }
}
