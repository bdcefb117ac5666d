//! Boards of squares: the estimated lens is close to the simulated one with every kind of board.

use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;

use evcal_core::event::Polarity;
use evcal_tests::accuracy::Accuracy;
use evcal_tests::{evcal, made, read_json, text};
use event_recordings::{Recording, RecordingOptions};

const SHEET: &str = "apriltags:3x4:60mm:0.25";

/// Returns the folder of a recording of three seconds of a hand-moved `board`.
fn recording_of(name: &str, board: &str) -> PathBuf {
    let lens = ["--model", "radtan4", "--parameters", "332,332,173.3,128.6,-0.35,0.15,0,0"];
    let simulated = [&["simulate", "--board", board, "--motion", "fast", "--duration", "3s"][..], &lens].concat();
    made(&format!("squares-{name}"), &simulated)
}

/// Checks the calibration from this recording.
fn calibrates(name: &str, board: &str) {
    let recording = recording_of(name, board);
    let events = recording.join("events.aedat4");
    let calibration = made(
        &format!("squares-calibration-{name}"),
        &["calibrate", text(&events), "--board", board, "--model", "radtan4", "--threads", "2", "--accept-any"],
    );
    let accuracy = Accuracy::of(&calibration, &recording);
    assert!(accuracy.focal <= 1e-3, "{board}: {accuracy:?}");
    assert!(accuracy.projection_rms <= 0.1, "{board}: {accuracy:?}");
    let result = read_json(&calibration.join("calibration.json"));
    let bound = result["uncertainty"]["projection_rms_95"].as_f64().unwrap();
    assert!(accuracy.projection_rms <= bound, "{board}: {accuracy:?}, reported bound {bound}");
}

#[test]
fn checkerboard() {
    calibrates("checkerboard", "checkerboard:6x9:25mm");
}

#[test]
fn aprilgrid() {
    calibrates("aprilgrid", "aprilgrid:4x4:50mm:0.3");
}

#[test]
fn sheet_of_apriltags() {
    calibrates("apriltags", SHEET);
}

/// Corners of tags in frames depended on the size of the tags, so fx was wrong by 22 of its σ.
#[test]
fn corners_of_tags_in_frames_are_not_biased() {
    let board = "apriltags:3x4:45mm:0.25";
    let lens = ["--model", "radtan4", "--parameters", "332,332,173.3,128.6,-0.35,0.15,0,0"];
    let simulated = ["simulate", "--board", board, "--motion", "slow", "--duration", "2s", "--frames", "20"];
    let recording = made("squares-frames", &[&simulated[..], &["--seed", "7"], &lens].concat());
    let events = recording.join("events.aedat4");
    let only = ["--frames-only", "--model", "radtan4", "--threads", "2", "--accept-any"];
    let calibration =
        made("squares-frames-only", &[&["calibrate", text(&events), "--board", board][..], &only].concat());
    let accuracy = Accuracy::of(&calibration, &recording);
    let result = read_json(&calibration.join("calibration.json"));
    let bound = result["uncertainty"]["projection_rms_95"].as_f64().unwrap();
    assert!(accuracy.projection_rms <= bound.min(0.03), "{accuracy:?}, reported bound {bound}");
    assert!(accuracy.focal <= 4e-4, "{accuracy:?}");
}

/// The error was that too few frames show the board, after a search of a minute.
#[test]
fn mirrored_and_inverted_tags_are_named() {
    let path = recording_of("apriltags", SHEET).join("events.aedat4");
    let mut reader = Recording::new(&path, RecordingOptions::default()).unwrap().open().unwrap();
    let head = "# sensor 346 x 260\nt_us,x,y,p\n".to_owned();
    let (mut mirrored, mut inverted, mut events) = (head.clone(), head, Vec::new());
    while reader.next_batch(&mut events).unwrap() {
        for event in events.iter().filter(|event| event.t < 1_000_000) {
            let is_on = event.polarity == Polarity::On;
            writeln!(mirrored, "{},{},{},{}", event.t, 345 - event.x, event.y, u8::from(is_on)).unwrap();
            writeln!(inverted, "{},{},{},{}", event.t, event.x, event.y, u8::from(!is_on)).unwrap();
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let [file, output] = ["events.csv", "output"].map(|name| folder.path().join(name));
    for (lines, cause) in [(mirrored, "mirrored"), (inverted, "dark and light are exchanged in")] {
        fs::write(&file, lines).unwrap();
        let finished = evcal(&["calibrate", text(&file), "--board", SHEET, "-o", text(&output)]);
        assert_eq!(finished.code, Some(1), "{finished:?}");
        assert!(finished.stderr.contains(cause), "{finished:?}");
    }
}

#[test]
fn charuco() {
    calibrates("charuco", "charuco:5x7:40mm:30mm:DICT_4X4_50");
}
