//! Defects that were found and mended, one test each, in the order in which they were: the test fails as the program
//! did. Those that need a whole calibration are in `tests/tests/calibration/regressions.rs`.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;
use std::process::Command;

use crate::command::{fail, stderr, succeed, text};
use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use event_recordings::aedat4::header::Compression;
use event_recordings::aedat4::write::Encoder;
use event_recordings::encode::Encode;
use event_recordings::extras::{Frame, InertialSample, OtherStreams};
use event_recordings::{Recording, RecordingOptions};
use serde_json::Value;

const BOARD: &str = "acircles:9x4:55mm:r17.5mm";

/// Ten thousand events, one each 100 µs.
fn events() -> Vec<Event> {
    let event = |index: i64| {
        let polarity = if index % 3 == 0 { Polarity::Off } else { Polarity::On };
        Event { t: 100 * index, x: (index * 7 % 346) as u16, y: (index * 11 % 260) as u16, polarity }
    };
    (0..10_000).map(event).collect()
}

fn frame(t: i64) -> Frame {
    Frame {
        t,
        exposure: Some((t - 2000, t + 2000)),
        readout: Some((t - 9000, t + 11_000)),
        size: (346, 260),
        position: (0, 0),
        channels: 1,
        pixels: vec![128; 346 * 260],
    }
}

fn sample(t: i64) -> InertialSample {
    InertialSample { t, temperature: 25.0, acceleration: [0.0, 0.0, 1.0], angular_velocity: [0.0; 3] }
}

/// Writes the events with these frames and samples as AEDAT4.
fn write_aedat4(path: &Path, frames: &[Frame], samples: &[InertialSample]) {
    let output = BufWriter::new(File::create(path).unwrap());
    let others = OtherStreams { frames: !frames.is_empty(), imu: !samples.is_empty() };
    let mut encoder =
        Encoder::with_streams(output, Compression::Lz4, Sensor::new(346, 260), "DAVIS346_00000042", others).unwrap();
    for part in events().chunks(1000) {
        encoder.write(part).unwrap();
    }
    for frame in frames {
        encoder.frame(frame).unwrap();
    }
    encoder.imu(samples).unwrap();
    encoder.finish().unwrap();
}

fn read(path: &Path) -> Vec<Event> {
    let mut reader = Recording::new(path, RecordingOptions::default()).unwrap().open().unwrap();
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    while reader.next_batch(&mut batch).unwrap() {
        all.extend_from_slice(&batch);
    }
    all
}

/// The message mentioned "the reading options", which were listed nowhere.
#[test]
fn the_advice_about_damaged_packets_contains_the_option_to_skip_them() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("damaged.aedat4");
    write_aedat4(&file, &[], &[]);
    let mut bytes = fs::read(&file).unwrap();
    // Within one of ten packets of one size.
    let middle = bytes.len() * 45 / 100;
    bytes[middle..middle + 200].fill(0x5a);
    fs::write(&file, bytes).unwrap();
    let message = fail(&["info", text(&file)]);
    let advice = message.split(['(', ')', ' ', '\n']).find(|word| word.starts_with("--")).expect("an option is named");
    let printed: Value = serde_json::from_str(&succeed(&["info", "--json", advice, text(&file)])).unwrap();
    let left = printed["events"].as_u64().unwrap();
    assert!((5000..10_000).contains(&left), "{left} of 10000 events are left");
}

/// The encoder of raw dumps received frames and samples in any order: a frame without the times of its read-out
/// came after later events, and was left out.
#[test]
fn a_frame_without_readout_times_is_written_to_the_raw_dump() {
    let directory = tempfile::tempdir().unwrap();
    let [from, to] = ["from.aedat4", "to.dvraw"].map(|name| directory.path().join(name));
    let frames: Vec<Frame> = (1..20).map(|index| Frame { readout: None, ..frame(50_000 * index) }).collect();
    write_aedat4(&from, &frames, &[sample(500), sample(600_000)]);
    let printed = succeed(&["convert", text(&from), text(&to)]);
    assert!(printed.contains("10000 events, 19 frames, 2 IMU samples"), "{printed}");
    assert_eq!(read(&to), events());
}

/// The first frame's read-out, which may begin before the first event, became the zero of all times.
#[test]
fn a_frame_that_begins_before_zero_does_not_shift_the_events() {
    let directory = tempfile::tempdir().unwrap();
    let [from, to] = ["from.aedat4", "to.dvraw"].map(|name| directory.path().join(name));
    write_aedat4(&from, &[frame(1000), frame(100_000)], &[]);
    succeed(&["convert", text(&from), text(&to)]);
    assert_eq!(read(&to), events());
}

/// A raw dump counts each 33 ms: up to a damaged time far ahead, these words filled the disk.
#[test]
fn impossible_times_are_left_out_of_a_raw_dump() {
    const HOURS: i64 = 100 * 3_600_000_000;
    let directory = tempfile::tempdir().unwrap();
    let [from, to] = ["from.aedat4", "to.dvraw"].map(|name| directory.path().join(name));
    let endless = Frame { exposure: Some((298_000, HOURS)), readout: Some((291_000, HOURS)), ..frame(300_000) };
    write_aedat4(&from, &[frame(100_000), endless], &[sample(500), sample(HOURS)]);
    let printed = succeed(&["convert", text(&from), text(&to)]);
    assert!(printed.contains("10000 events, 1 frame, 1 IMU sample\n"), "{printed}");
    assert!(
        printed.contains("more than a minute after the last event") && printed.contains("are impossible"),
        "{printed}"
    );
    let information: Value = serde_json::from_str(&succeed(&["info", "--json", text(&to)])).unwrap();
    assert_eq!(information["times_us"], serde_json::json!([0, 999_900]));
}

/// An error whose message contains that of its cause was printed twice.
#[test]
fn the_cause_of_an_error_is_printed_once() {
    let directory = tempfile::tempdir().unwrap();
    let missing = directory.path().join("missing.aedat4");
    let output = directory.path().join("output");
    for arguments in [
        vec!["info", text(&missing)],
        vec!["calibrate", text(&missing), "--board", BOARD, "-o", text(&output)],
        vec!["evaluate", text(&missing), "--truth", text(&missing)],
    ] {
        let message = fail(&arguments);
        assert_eq!(message.matches("No such file").count(), 1, "{arguments:?}: {message}");
    }
}

/// Two kinds of calibration checked for a common sensor, with different messages.
#[test]
fn recordings_of_two_sensors_are_refused_however_they_are_calibrated() {
    let directory = tempfile::tempdir().unwrap();
    let [small, large, output] = ["small.csv", "large.csv", "output"].map(|name| directory.path().join(name));
    fs::write(&small, "# sensor 346 x 260\nt_us,x,y,p\n10,1,2,1\n20,3,4,0\n").unwrap();
    fs::write(&large, "# sensor 640 x 480\nt_us,x,y,p\n10,1,2,1\n20,3,4,0\n").unwrap();
    let common = ["calibrate", text(&small), text(&large), "--board", BOARD, "-o", text(&output)];
    let messages = [&[][..], &["--frames-only"]].map(|options| fail(&[&common[..], options].concat()));
    assert_eq!(messages[0], messages[1]);
    for part in ["large.csv", "640 x 480", "346 x 260", "one camera at a time"] {
        assert!(messages[0].contains(part), "{part:?} is not in {}", messages[0]);
    }
    assert!(!output.exists());
}

/// A camera with its lens cap on was not distinguishable from a slow one.
#[cfg(target_os = "linux")]
#[test]
fn a_camera_without_events_is_reported() {
    use usb_davis::emulator::Model;
    use usb_davis::emulator::umockdev::EmulatedBus;

    let bus = EmulatedBus::start(Model::new("00000042", std::iter::empty)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let output = directory.path().join("output");
    let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
    command.args(["live", "--board", BOARD, "--duration", "2s", "-o", text(&output)]).envs(bus.environment());
    let ended = command.output().unwrap();
    let printed = String::from_utf8_lossy(&ended.stdout);
    assert!(printed.contains("no event yet: remove the lens cap"), "{printed}{}", stderr(&ended));
}

/// Milliseconds, written as microseconds, were read as nanoseconds without a message, and the error was about the board.
#[test]
fn the_assumed_unit_of_times_is_printed() {
    let directory = tempfile::tempdir().unwrap();
    let [path, output] = ["coarse.csv", "output"].map(|name| directory.path().join(name));
    let line = |index: i64| format!("{},{},{},{}\n", index / 650 * 1000, index % 346, index % 260, index % 2);
    let lines: String = (0..100_000).map(line).collect();
    fs::write(&path, format!("# sensor 346 x 260\nt,x,y,p\n{lines}")).unwrap();
    let message = fail(&["calibrate", text(&path), "--board", BOARD, "-o", text(&output)]);
    assert!(message.contains("coarse.csv: times are taken for microseconds"), "{message}");
    assert!(message.contains("no board found, and times come in steps of 1.00 ms"), "{message}");
}

/// Emulated events have coarse times; these were blamed, although another board than the stated one was in view.
#[test]
fn coarse_times_do_not_hide_another_board() {
    let directory = tempfile::tempdir().unwrap();
    let [path, output] = ["coarse.csv", "output"].map(|name| directory.path().join(name));
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/board/events.dvraw");
    let mut reader = Recording::new(fixture, RecordingOptions::default()).unwrap().open().unwrap();
    let (mut lines, mut events) = ("# sensor 346 x 260\nt_us,x,y,p\n".to_owned(), Vec::new());
    while reader.next_batch(&mut events).unwrap() {
        for Event { t, x, y, polarity } in &events {
            writeln!(lines, "{},{x},{y},{}", t / 300 * 300, polarity.index()).unwrap();
        }
    }
    fs::write(&path, lines).unwrap();
    let message = fail(&["calibrate", text(&path), "--board", "acircles:7x5:55mm:r17.5mm", "-o", text(&output)]);
    assert!(message.contains(BOARD), "{message}");
    let found = succeed(&["check", text(&path), "--board", BOARD]);
    assert!(found.contains("next: evcal calibrate"), "{found}");
}

/// Standard output, redirected to a file, was taken for that existing file, and the report was then written into it.
#[cfg(unix)]
#[test]
fn standard_output_is_a_stream_even_if_redirected_to_a_file() {
    let directory = tempfile::tempdir().unwrap();
    let [from, to] = ["from.csv", "to.csv"].map(|name| directory.path().join(name));
    let content = "t,x,y,p,us,346x260\n10,1,2,1\n20,3,4,0\n";
    fs::write(&from, content).unwrap();
    for name in ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
        command.args(["convert", text(&from), name, "--to", "csv"]).stdout(File::create(&to).unwrap());
        let printed = command.output().unwrap();
        assert_eq!(printed.status.code(), Some(0), "{}", stderr(&printed));
        assert!(stderr(&printed).contains("2 events"), "{}", stderr(&printed));
        assert_eq!(fs::read_to_string(&to).unwrap(), content);
        assert_eq!(succeed(&["convert", text(&from), name, "--to", "csv"]), content);
    }
}

/// A missing folder for temporary files was reported as a missing folder of the result.
#[cfg(unix)]
#[test]
fn a_missing_folder_for_temporary_files_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let [from, to] = ["from.csv", "to.npz"].map(|name| directory.path().join(name));
    fs::write(&from, "# sensor 346 x 260\nt_us,x,y,p\n10,1,2,1\n20,3,4,0\n").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
    let printed = command.args(["convert", text(&from), text(&to)]).env("TMPDIR", "/missing").output().unwrap();
    assert!(stderr(&printed).contains("/missing (TMPDIR)"), "{}", stderr(&printed));
}

/// Names of cameras and files, and lines of settings, moved the cursor and changed the colours and the title of the terminal.
#[cfg(unix)]
#[test]
fn control_characters_of_inputs_are_escaped() {
    let directory = tempfile::tempdir().unwrap();
    let recording = directory.path().join("a\n\u{1b}[2Jb.raw");
    let header = "% serial_number \u{1b}]0;PWNED\u{7}\u{1b}[31m\n% evt 3.0\n% geometry 346x260\n";
    let words: [u16; 4] = [0x80f4, 0x6240, 0x0007, 0x2805];
    fs::write(&recording, [header.as_bytes(), &words.map(u16::to_le_bytes).concat()].concat()).unwrap();
    let settings = directory.path().join("settings.toml");
    fs::write(&settings, "a = \"\u{1b}]0;PWNED\u{7}\u{9b}31mred\"\n").unwrap();
    let output = directory.path().join("output");
    let is_plain = |output: &[u8]| {
        let text = String::from_utf8(output.to_vec()).unwrap();
        assert!(!text.chars().any(|letter| letter.is_control() && letter != '\n'), "{text:?}");
        text
    };
    let printed = crate::command::evcal(&["info", text(&recording)]);
    let information = is_plain(&printed.stdout);
    assert!(
        information.contains("\\u001b]0;PWNED") && information.contains("a\\u000a\\u001b[2Jb.raw"),
        "{information}"
    );
    is_plain(&printed.stderr);
    for arguments in [
        vec!["calibrate", text(&recording), "--board", BOARD, "-o", text(&output), "--settings", text(&settings)],
        vec!["calibrate", text(&recording), "--board", BOARD, "-o", text(&output)],
        vec!["convert", text(&recording), "/missing\u{1b}[31m/b.csv"],
    ] {
        let printed = crate::command::evcal(&arguments);
        assert_eq!(printed.status.code(), Some(1), "{arguments:?}");
        is_plain(&printed.stdout);
        assert!(!is_plain(&printed.stderr).contains("a\n"), "{arguments:?}");
    }
}
/// 4600 events, one per 0.9 s, took half a minute: each needed the spectrum of a second.
#[test]
fn sparse_events_are_analysed_quickly() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("sparse.csv");
    let line = |index: i64| format!("{},{},{},1\n", index * 900_000, index % 346, index % 260);
    let lines: String = (0..20_000).map(line).collect();
    fs::write(&path, format!("# sensor 346 x 260\nt_us,x,y,p\n{lines}")).unwrap();
    // The defect took minutes.
    let printed = succeed(&["info", text(&path)]);
    assert!(printed.contains("20000, 100.0 % ON"), "{printed}");
}
