//! Damaged or wrong input, and recordings of another board: exit code and message. Data before the damage is used.

use std::fs;
use std::path::{Path, PathBuf};

use evcal_tests::lens::RADTAN4;
use evcal_tests::{BOARD, Finished, evcal, read_json, succeed, text};
use tempfile::TempDir;

/// Returns the path of a recording of one second.
fn recording() -> PathBuf {
    RADTAN4.simulation("second", &["--motion", "fast", "--duration", "1s"]).join("events.aedat4")
}

/// Returns the same events as text.
fn recording_as_text() -> String {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("events.csv");
    succeed(&["convert", text(&recording()), text(&file)]);
    fs::read_to_string(file).unwrap()
}

/// Returns the folder of the calibration from this recording.
fn reference() -> PathBuf {
    RADTAN4.calibration("second-calibration", &[&recording()])
}

fn calibrate(events: &Path, board: &str, output: &Path) -> Finished {
    evcal(&["calibrate", text(events), "--board", board, "--model", RADTAN4.model, "--accept-any", "-o", text(output)])
}

/// Writes text to a file and calibrates from it.
fn calibrate_text(directory: &TempDir, name: &str, content: &str) -> (Finished, PathBuf) {
    let (events, output) = (directory.path().join(format!("{name}.csv")), directory.path().join(name));
    fs::write(&events, content).unwrap();
    (calibrate(&events, BOARD, &output), output)
}

/// Checks that the run failed with a message that contains these words, and wrote nothing.
fn assert_rejected(finished: &Finished, output: &Path, words: &[&str]) {
    assert_failed(finished, words);
    assert!(!output.exists(), "{} was written", output.display());
}

fn assert_failed(finished: &Finished, words: &[&str]) {
    assert_eq!(finished.code, Some(1), "{finished:?}");
    for word in words {
        assert!(finished.stderr.contains(word), "{word:?} is not in {}", finished.stderr);
    }
    assert!(!finished.stderr.contains("panicked"), "{}", finished.stderr);
    assert_eq!(finished.stdout, "");
}

/// Reads the camera, and the camera before the joint solve.
fn cameras(calibration: &Path) -> [serde_json::Value; 2] {
    let mut result = read_json(&calibration.join("calibration.json"));
    ["camera", "initial_camera"].map(|name| result[name].take())
}

fn focal_length(calibration: &Path) -> f64 {
    cameras(calibration)[0]["parameters"]["fx"].as_f64().unwrap()
}

fn events_read(calibration: &Path) -> u64 {
    read_json(&calibration.join("calibration.json"))["stages"]["recordings"][0]["count"].as_u64().unwrap()
}

#[test]
fn a_truncated_recording_is_calibrated_from_the_rest() {
    let directory = tempfile::tempdir().unwrap();
    let bytes = fs::read(recording()).unwrap();
    let (cut, output) = (directory.path().join("cut.aedat4"), directory.path().join("cut"));
    fs::write(&cut, &bytes[..bytes.len() * 7 / 10]).unwrap();
    let finished = calibrate(&cut, BOARD, &output);
    assert_eq!(finished.code, Some(0), "{finished:?}");
    assert!(finished.stdout.contains("cut off: from byte"), "{}", finished.stdout);
    let (kept, whole) = (events_read(&output), events_read(&reference()));
    assert!(whole * 6 / 10 < kept && kept < whole * 8 / 10, "{kept} of {whole} events");
    assert!((focal_length(&output) / 331.2 - 1.0).abs() < 0.01, "{}", focal_length(&output));
}

#[test]
fn text_gives_the_same_camera_as_the_binary_recording_and_events_outside_the_sensor_change_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let mut events = String::new();
    let mut strays = 0;
    for (number, line) in recording_as_text().lines().enumerate() {
        events += line;
        events += "\n";
        if number > 100 && number % 1000 == 0 {
            let time = line.split(',').next().unwrap();
            events += &format!("{time},346,100,1\n{time},20,260,0\n{time},30000,30000,1\n");
            strays += 3;
        }
    }
    let (finished, output) = calibrate_text(&directory, "strays", &events);
    assert_eq!(finished.code, Some(0), "{finished:?}");
    assert!(
        strays > 1000 && finished.stdout.contains(&format!("{strays} events lie outside the sensor")),
        "{finished:?}"
    );
    assert_eq!(cameras(&output), cameras(&reference()));
    assert_eq!(events_read(&output), events_read(&reference()));
}

#[test]
fn events_before_an_invalid_line_are_used() {
    let directory = tempfile::tempdir().unwrap();
    let whole = recording_as_text();
    let lines: Vec<&str> = whole.split_inclusive('\n').collect();
    let kept = lines.len() * 7 / 10;
    let before = lines[..kept].concat();
    let after = lines[kept..].concat();
    let (undamaged, before_output) = calibrate_text(&directory, "before", &before);
    assert_eq!(undamaged.code, Some(0), "{undamaged:?}");
    let (damaged, output) = calibrate_text(&directory, "nan", &format!("{before}nan,12,34,1\n{after}"));
    assert_eq!(damaged.code, Some(0), "{damaged:?}");
    let named = damaged.stdout.contains("nan.csv") && damaged.stdout.contains(&format!("line {}", kept + 1));
    assert!(named, "{}", damaged.stdout);
    assert_eq!(cameras(&output), cameras(&before_output));
}

#[test]
fn files_without_usable_events_are_rejected() {
    let directory = tempfile::tempdir().unwrap();
    let head = "# sensor 346 x 260\nt_us,x,y,p\n";
    for (name, content, words) in [
        ("empty", String::new(), &["empty.csv", "is empty"][..]),
        ("bare", head.to_owned(), &["bare.csv", "no events"]),
        ("first", format!("{head}nan,1,2,1\n"), &["first.csv", "line 3"]),
        ("infinite", format!("{head}10,1,2,1\ninf,1,2,1\n20,3,4,0\n"), &["infinite.csv", "line 4"]),
        ("negative", format!("{head}10,-1,2,1\n"), &["negative.csv", "below 0", "--columns"]),
        ("polarity", format!("{head}10,1,2,7\n"), &["polarity.csv", "line 3"]),
        ("sizeless", "t_us,x,y,p\n10,1,2,1\n20,3,4,0\n".to_owned(), &["sizeless.csv", "--sensor"]),
    ] {
        let (finished, output) = calibrate_text(&directory, name, &content);
        assert_rejected(&finished, &output, words);
    }
}

#[test]
fn unsorted_events_are_rejected() {
    let directory = tempfile::tempdir().unwrap();
    let whole = recording_as_text();
    let (head, events): (Vec<&str>, Vec<&str>) =
        whole.split_inclusive('\n').partition(|line| !line.starts_with(|first: char| first.is_ascii_digit()));
    // Steps of a prime number that does not divide the count visit every line once.
    let count = (0..events.len()).rev().find(|count| count % 7919 != 0).unwrap();
    let shuffled: String = (0..count).map(|index| events[index * 7919 % count]).collect();
    let (finished, output) = calibrate_text(&directory, "shuffled", &(head.concat() + &shuffled));
    assert_rejected(&finished, &output, &["shuffled.csv", "not in order", "sorted by time"]);
}

#[test]
fn a_board_that_is_not_in_the_recording_is_not_found() {
    let directory = tempfile::tempdir().unwrap();
    let output = directory.path().join("never");
    for board in ["circles:9x4:55mm:r17.5mm", "acircles:7x3:55mm:r17.5mm", "acircles:11x5:55mm:r17.5mm"] {
        let finished = calibrate(&recording(), board, &output);
        assert_failed(&finished, &["no pattern found", "--board", "failure.txt", "failure.png"]);
        assert!(output.join("failure.txt").exists() && !output.join("calibration.json").exists());
    }
}

/// The uncertainty would be too small, as if there were twice as many events.
#[test]
fn a_recording_given_twice_is_rejected() {
    let directory = tempfile::tempdir().unwrap();
    let text_form = directory.path().join("again.csv");
    fs::write(&text_form, recording_as_text()).unwrap();
    let output = directory.path().join("output");
    let once = recording();
    let finished = evcal(&["calibrate", text(&once), text(&text_form), "--board", BOARD, "-o", text(&output)]);
    assert_rejected(&finished, &output, &["again.csv", "the same events as", "give each recording once"]);
}

#[test]
fn a_circle_track_calibrates_like_its_recording() {
    let directory = tempfile::tempdir().unwrap();
    let circles = directory.path().join("circles.csv");
    succeed(&["detect", text(&recording()), "--board", BOARD, "-o", text(&circles)]);
    assert_eq!(fs::read(&circles).unwrap(), fs::read(reference().join("circles.csv")).unwrap());
    let options = ["--board", BOARD, "--model", RADTAN4.model, "--sensor", "346x260"];
    let output = directory.path().join("from-circles");
    succeed(&[&["calibrate", text(&circles)][..], &options, &["--accept-any", "-o", text(&output)]].concat());
    assert!((focal_length(&output) / 331.2 - 1.0).abs() < 0.01, "{}", focal_length(&output));
}

#[test]
fn settings_out_of_range_are_rejected_before_anything_is_read() {
    let directory = tempfile::tempdir().unwrap();
    let (settings, output) = (directory.path().join("settings.toml"), directory.path().join("never"));
    fs::write(&settings, "[detection.cluster]\nepsilon = 6.0\n").unwrap();
    let arguments = ["calibrate", "missing.aedat4", "--board", BOARD, "--settings", text(&settings)];
    let finished = evcal(&[&arguments[..], &["-o", text(&output)]].concat());
    assert_rejected(&finished, &output, &["settings.toml", "epsilon is 6", "from 1 to 4.99 px"]);
}
