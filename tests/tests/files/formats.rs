//! Recordings that other programs write or read.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use evcal_tests::readers::{ask, python};
use evcal_tests::{all_events, evcal, text};
use event_recordings::aedat4::header::Compression;
use event_recordings::aedat4::write::Encoder;
use event_recordings::encode::Encode;
use event_recordings::extras::{Extra, Frame, InertialSample, OtherStreams};
use event_recordings::{Recording, RecordingOptions};
use serde_json::{Value, json};
use tempfile::TempDir;

const SENSOR: Sensor = Sensor::new(346, 260);
/// 10 September 2026 in µs.
const UNIX_TIME: i64 = 1_789_000_000_000_000;

/// Returns events in bursts of several events per microsecond, with pauses.
fn events(start: i64) -> Vec<Event> {
    let mixed = |index: i64| (index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
    (0..20_000)
        .map(|index| Event {
            t: start + index / 3 * 17 + index / 1000 * 30_000,
            x: (mixed(index) % 346) as u16,
            y: (mixed(index) / 346 % 260) as u16,
            polarity: if mixed(index) & 0x40_0000 == 0 { Polarity::Off } else { Polarity::On },
        })
        .collect()
}

fn rows(events: &[Event]) -> Value {
    events.iter().map(|event| json!([event.t, event.x, event.y, event.polarity.index()])).collect()
}

fn read(path: &Path, options: RecordingOptions) -> Vec<Event> {
    let mut reader = Recording::new(path, options).unwrap().open().unwrap();
    all_events(&mut reader)
}

/// Lets these programs write `events` to files with these extensions.
fn written_by(programs: &[(&str, &str)], events: &[Event]) -> (TempDir, Vec<PathBuf>) {
    let folder = TempDir::new().unwrap();
    let path = |(program, extension): &(&str, &str)| folder.path().join(format!("{program}.{extension}"));
    let paths: Vec<PathBuf> = programs.iter().map(path).collect();
    let task =
        |((program, _), path): (&(&str, &str), &PathBuf)| json!({"action": "write", "program": program, "path": path});
    let tasks: Vec<Value> = programs.iter().zip(&paths).map(task).collect();
    ask(&python(), "recordings.py", &json!({"tasks": tasks, "events": rows(events), "size": [346, 260]}));
    (folder, paths)
}

#[test]
fn bags_and_numpy_arrays_of_other_programs_are_read() {
    let programs = [
        ("rosbags-none", "bag"),
        ("rosbags-bz2", "bag"),
        ("rosbags-lz4", "bag"),
        ("rosbags-db3", "db3"),
        ("rosbags-mcap", "mcap"),
        ("numpy-padded", "npy"),
        ("numpy-table", "npy"),
        ("numpy-fortran", "npy"),
        ("numpy-stored", "npz"),
        ("numpy-deflated", "npz"),
    ];
    let expected = events(UNIX_TIME);
    let (_folder, paths) = written_by(&programs, &expected);
    for path in paths {
        assert!(read(&path, RecordingOptions::default()) == expected, "{}", path.display());
    }
}

#[test]
fn hdf5_of_all_layouts_and_compressions_is_read() {
    let programs = [
        "dsec",
        "m3ed",
        "mvsec",
        "metavision",
        "matlab",
        "across",
        "unnamed",
        "plain",
        "gzip",
        "blosclz",
        "blosclz-bits",
        "lz4-bits",
        "zlib",
        "zstd-bits",
        "lz4-filter",
        "zstd-filter",
    ]
    .map(|program| format!("hdf5-{program}"));
    let programs: Vec<(&str, &str)> = programs.iter().map(|program| (program.as_str(), "h5")).collect();
    let expected = events(UNIX_TIME);
    let (_folder, paths) = written_by(&programs, &expected);
    for path in paths {
        assert!(read(&path, RecordingOptions::default()) == expected, "{}", path.display());
        let name = path.file_stem().unwrap().to_str().unwrap();
        let sensor = Recording::new(&path, RecordingOptions::default()).unwrap().open().unwrap().information().sensor;
        assert_eq!(sensor, Some(SENSOR).filter(|_| name != "hdf5-dsec"), "{name}");
        if name == "hdf5-m3ed" {
            let right = RecordingOptions { stream: Some("prophesee/right".to_owned()), ..RecordingOptions::default() };
            assert!(read(&path, right) == expected[..100]);
        }
    }
}

#[test]
fn unsupported_compressions_of_hdf5_are_named() {
    let programs = [
        ("hdf5-blosc2", "Blosc 2 (filter 32026)"),
        ("hdf5-bitshuffle", "Bitshuffle (filter 32008)"),
        ("hdf5-snappy", "Blosc with Snappy"),
    ];
    let (_folder, paths) = written_by(&programs.map(|(program, _)| (program, "h5")), &events(0));
    for (path, (_, name)) in paths.iter().zip(programs) {
        let error = Recording::new(path, RecordingOptions::default()).unwrap().open().err().unwrap().to_string();
        assert!(error.contains(name), "{error}");
        let failed = evcal(&["info", text(path)]).stderr;
        assert!(failed.contains(name) && failed.contains("h5repack"), "{failed}");
    }
}

#[test]
fn frames_and_samples_of_mvsec_are_read() {
    let (folder, paths) = written_by(&[("hdf5-mvsec", "h5")], &events(UNIX_TIME));
    let recording = Recording::new(&paths[0], RecordingOptions::default()).unwrap();
    let mut extras = recording.open_extras().unwrap();
    assert_eq!(extras.streams(), OtherStreams { frames: true, imu: true });
    let found: Vec<Extra> = std::iter::from_fn(|| extras.next_until(i64::MAX, &mut Vec::new())).collect();
    let close = |t: i64, milliseconds: i64| (t - UNIX_TIME - 1000 * milliseconds).abs() <= 1;
    let [Extra::Inertial(first), Extra::Frame(frame), Extra::Inertial(_), Extra::Frame(last), Extra::Inertial(_)] =
        &found[..]
    else {
        panic!("{} frames and samples", found.len())
    };
    assert!(close(first.t, 10) && close(frame.t, 20) && close(last.t, 50));
    assert_eq!((first.acceleration, first.angular_velocity), ([0.0, 1.0, -0.5], [180.0, 0.0, -90.0]));
    assert_eq!((frame.size, frame.channels, frame.pixels.len()), ((346, 260), 1, 346 * 260));
    assert!(frame.pixels.iter().enumerate().all(|(index, pixel)| usize::from(*pixel) == index % 251));
    let report = converted(&paths[0], &folder.path().join("target.aedat4"));
    assert!(report.contains("20000 events, 2 frames, 3 IMU samples") && !report.contains("not kept"), "{report}");
    let report = converted(&paths[0], &folder.path().join("target.csv"));
    assert!(report.contains("not kept: 2 frames") && report.contains("not kept: 3 IMU samples"), "{report}");
}

#[test]
fn files_of_faery_are_read() {
    // Times in faery's files begin at 0.
    let expected = events(0);
    let (_folder, paths) = written_by(&[("faery", "es"), ("faery", "dat")], &expected);
    for path in paths {
        assert!(read(&path, RecordingOptions::default()) == expected, "{}", path.display());
    }
}

fn frame(t: i64, seed: usize) -> Frame {
    Frame {
        t,
        exposure: Some((t - 2000, t + 2000)),
        readout: Some((t - 9000, t + 11_000)),
        size: (346, 260),
        position: (0, 0),
        channels: 1,
        pixels: (0..346 * 260).map(|index| ((index * 7 + seed * 31) % 256) as u8).collect(),
    }
}

fn sample(t: i64) -> InertialSample {
    InertialSample { t, temperature: 31.0, acceleration: [1.0, -0.25, 0.0], angular_velocity: [90.0, -180.0, 0.5] }
}

/// Writes a recording with events, frames and IMU samples.
fn recording(path: &Path, start: i64) {
    let others = OtherStreams { frames: true, imu: true };
    let output = BufWriter::new(File::create(path).unwrap());
    let mut encoder = Encoder::with_streams(output, Compression::Lz4, SENSOR, "DAVIS346_7", others).unwrap();
    encoder.write(&events(start)).unwrap();
    (0..5).for_each(|index| encoder.frame(&frame(start + 20_000 + 100_000 * index, index as usize)).unwrap());
    let samples: Vec<InertialSample> = (0..50).map(|index| sample(start + 10_000 * index)).collect();
    encoder.imu(&samples).unwrap();
    encoder.finish().unwrap();
}

fn converted(source: &Path, target: &Path) -> String {
    let finished = evcal(&["convert", text(source), text(target)]);
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    finished.stdout
}

/// Reads the file at `path` with `program` and returns the content that it reports.
fn read_by(program: &str, path: &Path) -> Value {
    let tasks = json!([{"action": "read", "program": program, "path": path}]);
    ask(&python(), "recordings.py", &json!({"tasks": tasks, "events": [], "size": [346, 260]}))[0].take()
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn written_bags_are_read_by_rosbags_and_mcap_with_frames_and_samples() {
    let folder = TempDir::new().unwrap();
    let source = folder.path().join("source.aedat4");
    recording(&source, UNIX_TIME);
    for (program, extension) in [("rosbags", "bag"), ("mcap", "mcap")] {
        let target = folder.path().join(format!("target.{extension}"));
        let report = converted(&source, &target);
        assert!(report.contains("20000 events, 5 frames, 50 IMU samples") && report.contains("exposures"), "{report}");
        assert_eq!(read(&target, RecordingOptions::default()), events(UNIX_TIME));
        let found = read_by(program, &target);
        assert!(found["events"] == rows(&events(UNIX_TIME)), "{program}");
        let frames: Value = (0..5)
            .map(|index| frame(UNIX_TIME + 20_000 + 100_000 * index, index as usize))
            .map(|frame| json!([frame.t, 346, 260, hexadecimal(&frame.pixels)]))
            .collect();
        assert_eq!(found["frames"], frames, "{program}");
        let samples = found["samples"].as_array().unwrap();
        assert_eq!((samples.len(), &samples[49][0]), (50, &json!(UNIX_TIME + 490_000)));
        let half_turn = std::f64::consts::PI;
        for (number, expected) in
            [(1, [half_turn / 2.0, -half_turn, half_turn / 360.0]), (2, [9.806_65, -9.806_65 / 4.0, 0.0])]
        {
            let values: [f64; 3] = serde_json::from_value(samples[0][number].clone()).unwrap();
            assert!(
                values.iter().zip(expected).all(|(value, expected)| (value - expected).abs() < 1e-12),
                "{values:?}"
            );
        }
        // Converting back keeps the whole content of the bag.
        let again = folder.path().join(format!("{extension}.aedat4"));
        assert!(converted(&target, &again).contains("20000 events, 5 frames, 50 IMU samples"));
        assert_eq!(read(&again, RecordingOptions::default()), events(UNIX_TIME));
    }
}

#[test]
fn written_archives_are_read_by_numpy() {
    let folder = TempDir::new().unwrap();
    let (source, target) = (folder.path().join("source.aedat4"), folder.path().join("target.npz"));
    recording(&source, UNIX_TIME);
    assert!(converted(&source, &target).contains("not kept"));
    let expected = events(UNIX_TIME);
    assert_eq!(read(&target, RecordingOptions::default()), expected);
    assert_eq!(read_by("numpy", &target), json!({"events": rows(&expected), "size": [346, 260]}));
}

#[test]
fn written_hdf5_is_read_by_h5py() {
    let folder = TempDir::new().unwrap();
    for start in [0, UNIX_TIME] {
        let (source, target) = (folder.path().join("source.aedat4"), folder.path().join("target.h5"));
        recording(&source, start);
        assert!(converted(&source, &target).contains("not kept"));
        let expected = events(start);
        assert_eq!(read(&target, RecordingOptions::default()), expected);
        assert!(read_by("h5py", &target) == json!({"events": rows(&expected), "size": [346, 260]}), "from {start} us");
        fs::remove_file(&target).unwrap();
    }
}

#[test]
fn written_evt3_is_read_by_faery() {
    let folder = TempDir::new().unwrap();
    for start in [0, 123_456_789, UNIX_TIME] {
        let (source, target) = (folder.path().join("source.aedat4"), folder.path().join("target.raw"));
        recording(&source, start);
        let report = converted(&source, &target);
        let zero = if start == UNIX_TIME { UNIX_TIME } else { 0 };
        assert_eq!(report.contains("times count from"), zero != 0, "{report}");
        let expected = events(start - zero);
        assert_eq!(read(&target, RecordingOptions::default()), expected);
        let found = read_by("faery", &target);
        assert!(found == json!({"events": rows(&expected), "size": [346, 260]}), "from {start} us");
        fs::remove_file(&target).unwrap();
    }
}
