//! `evcal convert` and `evcal info` as a user runs them.

use evcal_core::sensor::Sensor;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use crate::command::{evcal, fail, succeed, text};
use evcal_core::event::{Event, Polarity};
use event_recordings::aedat4::header::Compression;
use event_recordings::aedat4::write::Encoder;
use event_recordings::encode::Encode;
use event_recordings::extras::{Extra, Frame, InertialSample, OtherStreams};
use event_recordings::{Recording, RecordingOptions};
use serde_json::Value;
use tempfile::TempDir;

/// 10 September 2026 in µs.
const UNIX_TIME: i64 = 1_789_000_000_000_000;

/// Two seconds of events on a DAVIS346: bursts, several events per microsecond, a pause of 0.3 s.
fn events(start: i64) -> Vec<Event> {
    (0..40_000i64)
        .map(|index| {
            let mixed = (index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
            let rest = if index >= 20_000 { 300_000 } else { 0 };
            Event {
                t: start + index / 3 * 120 + rest,
                x: (mixed % 346) as u16,
                y: (mixed / 346 % 260) as u16,
                polarity: if mixed & 0x40_0000 == 0 { Polarity::Off } else { Polarity::On },
            }
        })
        .collect()
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

fn sample(t: i64, rate: f32) -> InertialSample {
    InertialSample {
        t,
        temperature: 21.0 + 3339.0 / 333.87,
        // Multiples of the camera's units at ±4 g and ±500 °/s; for higher rates at ±1000 °/s.
        acceleration: [1.0, -1.0 / 8192.0, 0.0],
        angular_velocity: [rate, -rate, 250.0],
    }
}

fn write_aedat4(path: &Path, events: &[Event], frames: &[Frame], samples: &[InertialSample]) {
    let output = BufWriter::new(File::create(path).unwrap());
    let others = OtherStreams { frames: !frames.is_empty(), imu: !samples.is_empty() };
    let mut encoder =
        Encoder::with_streams(output, Compression::Lz4, Sensor::new(346, 260), "DAVIS346_00000042", others).unwrap();
    for part in events.chunks(5000) {
        encoder.write(part).unwrap();
    }
    frames.iter().for_each(|frame| encoder.frame(frame).unwrap());
    encoder.imu(samples).unwrap();
    encoder.finish().unwrap();
}

/// Reads all frames and IMU samples.
fn extras(path: &Path) -> (Vec<Frame>, Vec<InertialSample>) {
    let mut reader = Recording::new(path, RecordingOptions::default()).unwrap().open_extras().unwrap();
    let (mut frames, mut samples, mut lost) = (Vec::new(), Vec::new(), Vec::new());
    while let Some(extra) = reader.next_until(i64::MAX, &mut lost) {
        match extra {
            Extra::Frame(frame) => frames.push(frame),
            Extra::Inertial(sample) => samples.push(sample),
        }
    }
    assert_eq!(lost, [""; 0]);
    (frames, samples)
}

fn read(path: &Path) -> (Vec<Event>, Option<String>) {
    let mut reader = Recording::new(path, RecordingOptions::default()).unwrap().open().unwrap();
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    while reader.next_batch(&mut batch).unwrap() {
        all.extend_from_slice(&batch);
    }
    (all, reader.information().camera_name.clone())
}

fn place() -> (TempDir, impl Fn(&str) -> PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().to_owned();
    (directory, move |name: &str| path.join(name))
}

#[test]
fn events_are_the_same_in_every_format_whichever_they_come_from() {
    let (_directory, file) = place();
    let expected = events(5000);
    write_aedat4(&file("first.aedat4"), &expected, &[], &[]);
    let formats = ["dvraw", "aedat4", "csv", "bin"];
    for from in formats {
        let source = file(&format!("from.{from}"));
        succeed(&["convert", text(&file("first.aedat4")), text(&source)]);
        assert_eq!(read(&source).0, expected, "{from}");
        for to in formats {
            let target = file(&format!("{from}-to.{to}"));
            succeed(&["convert", text(&source), text(&target), "--sensor", "346x260"]);
            let (found, camera) = read(&target);
            assert_eq!(found, expected, "{from} to {to}");
            let kept = [from, to].iter().all(|format| ["dvraw", "aedat4"].contains(format));
            assert_eq!(camera.as_deref(), kept.then_some("DAVIS346_00000042"), "{from} to {to}");
        }
    }
    // The name of the file does not decide if the format is given.
    succeed(&["convert", text(&file("from.bin")), text(&file("events")), "--to", "csv", "--sensor", "346x260"]);
    assert_eq!(read(&file("events")).0, expected);
}

#[test]
fn frames_and_inertial_samples_survive_a_raw_dump() {
    let (_directory, file) = place();
    let expected = events(0);
    let frames: Vec<Frame> = (0..20).map(|index| frame(20_000 + 40_000 * index, index as usize)).collect();
    let samples: Vec<InertialSample> =
        (1..900).map(|index| sample(1000 * index, index as f32 / 1024.0 * 1000.0)).collect();
    write_aedat4(&file("first.aedat4"), &expected, &frames, &samples);
    let printed = succeed(&["convert", text(&file("first.aedat4")), text(&file("camera.dvraw"))]);
    assert!(printed.contains("40000 events, 20 frames, 899 IMU samples") && !printed.contains("not kept"), "{printed}");
    let printed = succeed(&["convert", text(&file("camera.dvraw")), text(&file("again.aedat4"))]);
    assert!(printed.contains("40000 events, 20 frames, 899 IMU samples") && printed.contains("10 bits"), "{printed}");
    assert_eq!(read(&file("again.aedat4")).0, expected);
    let (frames_again, again) = extras(&file("again.aedat4"));
    assert_eq!(frames_again, frames);
    assert_eq!(again.len(), samples.len());
    for (again, sample) in again.iter().zip(&samples) {
        assert_eq!((again.t, again.acceleration), (sample.t, sample.acceleration));
        assert!((again.temperature - sample.temperature).abs() < 1e-3);
        for (again, value) in again.angular_velocity.iter().zip(sample.angular_velocity) {
            // Half a unit of the full scale that contains the value.
            let unit = if sample.angular_velocity[0] < 500.0 { 500.0 / 32768.0 } else { 1000.0 / 32768.0 };
            assert!((again - value).abs() <= 0.5 * unit + 1e-4, "{again} {value}");
        }
    }

    let information: Value = serde_json::from_str(&succeed(&["info", "--json", text(&file("camera.dvraw"))])).unwrap();
    let elements = |index: usize| information["streams"][index]["elements"].as_u64().unwrap();
    assert_eq!([elements(0), elements(1), elements(2), elements(3)], [40_000, 20, 899, 0]);
    assert_eq!(information["report"]["stream"]["gaps"], 0);
    let printed = succeed(&["convert", text(&file("camera.dvraw")), text(&file("events.csv"))]);
    assert!(printed.contains("not kept: 20 frames") && printed.contains("not kept: 899 IMU samples"), "{printed}");
    let printed = succeed(&["convert", text(&file("first.aedat4")), text(&file("events.bin"))]);
    assert!(printed.contains("20 packets of 1 frames (FRME)"), "{printed}");
}

#[test]
fn times_since_1970_survive_a_raw_dump() {
    let (_directory, file) = place();
    let expected = events(UNIX_TIME);
    write_aedat4(&file("first.aedat4"), &expected, &[frame(UNIX_TIME + 20_000, 1)], &[]);
    let printed = succeed(&["convert", text(&file("first.aedat4")), text(&file("camera.dvraw"))]);
    assert!(printed.contains(&format!("times count from {UNIX_TIME} us")), "{printed}");
    let relative: Vec<Event> = events(0);
    assert_eq!(read(&file("camera.dvraw")).0, relative);
    succeed(&["convert", text(&file("camera.dvraw")), text(&file("again.aedat4")), "--unix-time"]);
    assert_eq!(read(&file("again.aedat4")).0, expected);
    assert_eq!(extras(&file("again.aedat4")).0[0].t, UNIX_TIME + 20_000);
    // RAW spent a word on each 4 ms since 1970, 800 GB in all.
    let printed = succeed(&["convert", text(&file("camera.dvraw")), text(&file("again.raw")), "--unix-time"]);
    assert!(printed.contains(&format!("times count from {UNIX_TIME} us")), "{printed}");
    assert_eq!(read(&file("again.raw")).0, relative);
    // Transfers are copied unchanged.
    let error = fail(&["convert", text(&file("camera.dvraw")), text(&file("copy.dvraw")), "--unix-time"]);
    assert!(error.contains("leave out --unix-time"), "{error}");
    let error = fail(&["convert", text(&file("first.aedat4")), text(&file("none.csv")), "--unix-time"]);
    assert!(error.contains("does not say when it began"), "{error}");
    assert!(!file("none.csv").exists());
}

#[test]
fn impossible_conversions_are_reported_and_nothing_is_overwritten() {
    let (_directory, file) = place();
    write_aedat4(&file("first.aedat4"), &events(0), &[], &[]);
    succeed(&["convert", text(&file("first.aedat4")), text(&file("events.bin"))]);
    for (to, advice) in [
        ("events.bin", "choose another name"),
        ("first.aedat4", "choose another name"),
        ("events.xyz", "--to"),
        ("folder/that/is/not/there.csv", "not/there.csv"),
    ] {
        let error = fail(&["convert", text(&file("first.aedat4")), text(&file(to))]);
        assert!(error.contains(advice), "{error}");
    }
    for to in ["a.dvraw", "a.csv", "a.aedat4"] {
        let error = fail(&["convert", text(&file("events.bin")), text(&file(to))]);
        assert!(error.contains("add --sensor ") && !file(to).exists(), "{error}");
    }
    let error = fail(&["convert", text(&file("events.bin")), text(&file("a.dvraw")), "--sensor", "640x480"]);
    assert!(error.contains("346x260"), "{error}");
    assert_eq!(evcal(&["convert", "a.bin", "b.csv", "--to", "avi"]).status.code(), Some(2));

    let mut damaged = fs::read(file("first.aedat4")).unwrap();
    let middle = damaged.len() / 2;
    damaged[middle..middle + 200].fill(0x5a);
    fs::write(file("damaged.aedat4"), damaged).unwrap();
    let error = fail(&["convert", text(&file("damaged.aedat4")), text(&file("saved.csv"))]);
    assert!(error.contains("the part before the error is in"), "{error}");
    let (saved, _) = read(&file("saved.csv"));
    assert!(saved.len() > 10_000 && saved == events(0)[..saved.len()]);
}

/// An existing file was replaced by one without events.
#[test]
fn a_recording_that_is_damaged_at_its_beginning_replaces_nothing() {
    let (_directory, file) = place();
    write_aedat4(&file("damaged.aedat4"), &events(0), &[], &[]);
    let mut content = fs::read(file("damaged.aedat4")).unwrap();
    // The head of the first packet is followed by an LZ4 frame, which begins with its magic number.
    let mark = content.windows(4).position(|bytes| bytes == [0x04, 0x22, 0x4d, 0x18]).unwrap();
    content[mark] ^= 0xff;
    fs::write(file("damaged.aedat4"), content).unwrap();
    fs::write(file("good.csv"), "what was there").unwrap();
    let error = fail(&["convert", text(&file("damaged.aedat4")), text(&file("good.csv")), "--force"]);
    assert!(error.contains("nothing was written"), "{error}");
    assert_eq!(fs::read_to_string(file("good.csv")).unwrap(), "what was there");
}

#[test]
fn after_a_gap_times_are_right_and_the_gap_is_reported() {
    let (_directory, file) = place();
    write_aedat4(&file("first.aedat4"), &events(0), &[], &[]);
    succeed(&["convert", text(&file("first.aedat4")), text(&file("whole.dvraw"))]);
    let mut bytes = fs::read(file("whole.dvraw")).unwrap();
    let (start, end) = (bytes.len() / 4, bytes.len() / 2);
    bytes[start..end].fill(0);
    fs::write(file("gap.dvraw"), &bytes).unwrap();
    let all = events(0);
    let (found, _) = read(&file("gap.dvraw"));
    assert!(found.len() > 20_000 && found.len() < 35_000, "{}", found.len());
    let same_end = found.iter().rev().zip(all.iter().rev()).take_while(|(found, event)| found == event).count();
    let same_start = found.iter().zip(&all).take_while(|(found, event)| found == event).count();
    assert!(same_start > 5000 && same_start + same_end >= found.len(), "{same_start} + {same_end}");

    let information: Value = serde_json::from_str(&succeed(&["info", "--json", text(&file("gap.dvraw"))])).unwrap();
    let stream = &information["report"]["stream"];
    assert_eq!((&stream["gaps"], &stream["repaired_gaps"]), (&1.into(), &1.into()), "{stream}");
    assert!(stream["restored_us"].as_u64().unwrap() > 300_000, "{stream}");
    let printed = succeed(&["info", text(&file("gap.dvraw"))]);
    assert!(printed.contains("lost in 1 place") && printed.contains("computer's clock"), "{printed}");
    // A copy of the stream keeps the gap.
    let printed = succeed(&["convert", text(&file("gap.dvraw")), text(&file("copy.dvraw"))]);
    assert!(printed.contains("transfers as they were") && printed.contains("has 1 damaged place, which"), "{printed}");
    assert_eq!(read(&file("copy.dvraw")).0, found);
}
