//! The fixtures, which are raw dumps of a DAVIS346 (see `fixtures/README.md`), are read like any other recording.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use evcal_core::event::{Event, Polarity};
use evcal_tests::{BOARD, all_events, program, session, session_calibration};
use event_recordings::{Recording, RecordingOptions};
use serde_json::Value;
use tempfile::TempDir;

const CRADLE: &str = "newtons-cradle.dvraw";

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("fixtures")
}

/// Runs a command, which must succeed, and returns its output.
fn succeed(command: &mut Command) -> String {
    let output = command.stderr(Stdio::piped()).output().expect("it starts");
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("it prints text")
}

/// Runs evcal, which must succeed, and returns its output.
fn evcal(arguments: &[&dyn AsRef<OsStr>]) -> String {
    succeed(Command::new(program()).args(arguments.iter().map(|argument| argument.as_ref())))
}

/// Reads all files below a folder, by name.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut files = BTreeMap::new();
    for entry in entries {
        let path = entry.expect("an entry can be read").path();
        if path.is_dir() {
            files.extend(self::files(&path));
        } else {
            let name = path.file_name().expect("it has a name").to_string_lossy().into_owned();
            files.insert(name, std::fs::read(&path).expect("a file can be read"));
        }
    }
    files
}

/// Checks that both folders contain the same files.
fn assert_same(left: &BTreeMap<String, Vec<u8>>, right: &BTreeMap<String, Vec<u8>>) {
    assert!(!left.is_empty());
    assert!(left.keys().eq(right.keys()), "{:?} and {:?}", left.keys(), right.keys());
    for (name, content) in left {
        let differs = content.iter().zip(&right[name]).position(|(a, b)| a != b);
        assert!(*content == right[name], "{name} differs, first at byte {differs:?}");
    }
}

fn events(path: &Path) -> Vec<Event> {
    let recording = Recording::new(path, RecordingOptions::default()).expect("it is known");
    let mut reader = recording.open().expect("it can be read");
    let events = all_events(&mut reader);
    let report = reader.report();
    assert_eq!((report.damaged_packets, report.steps_back, report.out_of_range), (0, 0, 0));
    events
}

#[test]
fn the_simulated_session_is_reproduced_byte_for_byte() {
    let directory = TempDir::new().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("tools").join("fixtures/make.sh");
    succeed(Command::new("sh").arg(script).env("EVCAL", program()).env("FIXTURES", directory.path()));
    assert_same(&files(&directory.path().join("board")), &files(&session()));
}

/// Runs `evcal simulate` and returns the exit code and standard error.
fn simulate(arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(program()).arg("simulate").args(arguments).output().expect("it starts");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn data_that_a_davis346_cannot_send_is_rejected() {
    let directory = TempDir::new().unwrap();
    let output = directory.path().join("out");
    let to = ["-o", output.to_str().unwrap()];
    for (arguments, code, words) in [
        (["--format", "csv", "--imu"].as_slice(), 2, "need --format aedat4 or dvraw"),
        (&["--format", "dvraw", "--frames", "60"], 1, "frames.interval"),
        (&["--format", "dvraw", "--frames=-1"], 2, "0.1 to 1000"),
        (&["--format", "dvraw", "--sensor", "320x240"], 1, "346x260"),
    ] {
        let (found, message) = simulate(&[arguments, &to].concat());
        assert_eq!(found, Some(code), "{arguments:?}: {message}");
        assert!(message.contains(words), "{arguments:?}: {message}");
    }
    assert!(!output.join("events.dvraw").exists());
}

#[test]
fn a_dump_and_its_conversion_to_aedat4_have_the_same_calibration() {
    let directory = TempDir::new().unwrap();
    let at = |name: &str| directory.path().join(name);
    // The conversion keeps the frames, which both calibrations use as a cross-check.
    evcal(&[&"convert", &session().join("events.dvraw"), &at("events.aedat4")]);
    evcal(&[&"calibrate", &at("events.aedat4"), &"--board", &BOARD, &"--accept-any", &"-o", &at("from-aedat4")]);
    let from_dump = session_calibration();
    let [dump_files, aedat4_files] = [&from_dump, &at("from-aedat4")].map(|folder| {
        let mut files = files(folder);
        // The report and calibration.json name the recording and the command line.
        files.remove("report.html").expect("calibrate writes a report");
        let json = files.get_mut("calibration.json").expect("calibrate writes calibration.json");
        let mut value: Value = serde_json::from_slice(json).unwrap();
        let named = ["command", "input_files"].map(|key| value.as_object_mut().unwrap().remove(key).is_some());
        assert_eq!(named, [true; 2]);
        *json = value.to_string().into_bytes();
        files
    });
    assert_same(&dump_files, &aedat4_files);

    // The calibration is also correct.
    let evaluation = evcal(&[&"evaluate", &from_dump, &"--truth", &session(), &"--json"]);
    let evaluation: Value = serde_json::from_str(&evaluation).unwrap();
    for (name, tolerance) in [("fx", 1e-3 * 332.16), ("fy", 1e-3 * 332.16), ("cx", 0.5), ("cy", 0.5)] {
        let difference = evaluation["intrinsics"]["parameters"][name]["difference"].as_f64().unwrap();
        assert!(difference.abs() < tolerance, "{name} is wrong by {difference} px");
    }
}

/// Returns the 64-bit FNV-1a hash of the events: time in µs since the first one (i64), x, y (u16), ON (u8), all little-endian.
fn digest(events: &[Event]) -> u64 {
    let first = events.first().map_or(0, |event| event.t);
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for event in events {
        let on = u8::from(event.polarity == Polarity::On);
        let (t, x, y) = ((event.t - first).to_le_bytes(), event.x.to_le_bytes(), event.y.to_le_bytes());
        for byte in t.into_iter().chain(x).chain(y).chain([on]) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    hash
}

/// Number and digest of the events that iniVation's dv-processing 2.0.4 reads from the original recording.
const ORIGINAL: (usize, u64) = (319_512, 0x4910_52a0_4e81_de6b);

#[test]
fn the_real_recording_has_the_events_of_the_original() {
    let events = events(&fixtures().join(CRADLE));
    assert_eq!((events.len(), digest(&events)), ORIGINAL);
}

/// The balls have one size, hang in a row and cannot overlap, so the centres of neighbours are one diameter apart.
#[test]
fn the_balls_of_the_real_recording_are_found() {
    let directory = TempDir::new().unwrap();
    let output = directory.path().join("circles.csv");
    let settings = fixtures().join("newtons-cradle.toml");
    evcal(&[&"detect", &fixtures().join(CRADLE), &"--settings", &settings, &"-o", &output]);

    let text = std::fs::read_to_string(&output).unwrap();
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let index = |name: &str| names.iter().position(|other| *other == name).unwrap();
    let columns = ["frame", "x_px", "y_px", "radius_px"].map(index);
    let mut windows: BTreeMap<u32, Vec<[f64; 2]>> = BTreeMap::new();
    let mut circles = 0;
    for line in lines {
        let fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        let [frame, x, y, radius] = columns.map(|column| fields[column]);
        circles += 1;
        // Circles with the radius of the balls, in their row of the image.
        if (radius - 20.0).abs() < 2.0 && (y - 157.0).abs() < 10.0 {
            windows.entry(frame as u32).or_default().push([x, y]);
        }
    }
    let balls: usize = windows.values().map(Vec::len).sum();
    assert!(balls >= 90 && 10 * balls >= 6 * circles, "{balls} of {circles} circles are balls");
    assert!(windows.len() >= 50, "balls in {} windows", windows.len());
    let mut neighbours = 0;
    for balls in windows.values_mut() {
        balls.sort_by(|a, b| a[0].total_cmp(&b[0]));
        for pair in balls.windows(2) {
            let distance = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
            assert!(distance > 40.0, "two balls {distance} px apart overlap");
            neighbours += usize::from(distance < 48.0);
        }
    }
    assert!(neighbours >= 20, "{neighbours} pairs of neighbours");
}
