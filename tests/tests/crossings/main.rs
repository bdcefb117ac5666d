//! Crossings: kinds of boards, sensors, sources of a recording and devices on the mount, together. Each works alone; this table
//! shows that they work where they meet.
//!
//! Every row is a simulated recording. `check` must recognise its board and print a command that runs, the calibration must be
//! within its stated bound with the device found, the report must speak of the board in use, and every export must be written.

use std::fs;
use std::path::{Path, PathBuf};

use evcal_tests::accuracy::Accuracy;
use evcal_tests::{evcal, made, read_json, succeed, text};
use serde_json::Value;

/// Where the events come from.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Source {
    /// The simulator's file.
    File,
    /// A recording of this format.
    Converted(&'static str),
    /// `evcal live` with a replay of the file.
    Replay,
}

/// What is calibrated with the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Extra {
    Nothing,
    Imu,
    SecondCamera,
    /// The camera's own frames, solved with the events.
    JointFrames,
    /// The camera's own frames alone.
    FramesOnly,
}

struct Crossing {
    board: &'static str,
    sensor: &'static str,
    source: Source,
    extra: Extra,
}

use Extra::{FramesOnly, Imu, JointFrames, Nothing, SecondCamera};
use Source::{Converted, File, Replay};

const DOTS: &str = "acircles:9x4:55mm:r17.5mm";
const CHECKERBOARD: &str = "checkerboard:6x9:25mm";
const APRILGRID: &str = "aprilgrid:6x6:35.2mm:0.3";
const APRILTAGS: &str = "apriltags:3x4:60mm:0.25";
const CHARUCO: &str = "charuco:5x7:30mm:22mm:DICT_5X5_50";
const DAVIS346: &str = "davis346";
const VGA: &str = "gen31";
const HD: &str = "imx636";

impl Extra {
    /// Returns the options of the simulator.
    fn simulated(self) -> &'static [&'static str] {
        match self {
            Nothing => &[],
            Imu => &["--imu"],
            SecondCamera => &["--second-camera"],
            JointFrames | FramesOnly => &["--frames", "20"],
        }
    }

    /// Returns the part of `calibration.json` that shows that it was used.
    fn part(self) -> Option<&'static str> {
        match self {
            Nothing | FramesOnly => None,
            Imu => Some("inertial"),
            SecondCamera => Some("second_cameras"),
            JointFrames => Some("joint_frames"),
        }
    }
}

impl Crossing {
    fn name(&self) -> String {
        let kind = self.board.split(':').next().unwrap_or_default();
        format!("crossing-{kind}-{}-{:?}", self.sensor, self.extra).to_lowercase()
    }

    /// `true` if the recording is too short for a good verdict: a longer one of a large sensor takes minutes to simulate.
    fn is_short(&self) -> bool {
        self.sensor == HD
    }

    /// Returns the folder of the simulated recording.
    fn simulated(&self) -> PathBuf {
        let duration = if self.is_short() { "1.5s" } else { "4s" };
        let options = ["simulate", "--board", self.board, "--sensor", self.sensor, "--duration", duration];
        made(&self.name(), &[&options[..], &["--seed", "51"], self.extra.simulated()].concat())
    }

    /// Returns the recording in the form of its source.
    fn recording(&self, folder: &Path) -> PathBuf {
        let simulated = self.simulated().join("events.aedat4");
        match self.source {
            File | Replay => simulated,
            Converted(format) => {
                let converted = folder.join("events").with_extension(format);
                succeed(&["convert", text(&simulated), text(&converted)]);
                converted
            }
        }
    }

    fn calibrate(&self, recording: &Path, result: &Path) {
        let second = self.simulated().join("second.aedat4");
        let extra: &[&str] = match self.extra {
            Nothing => &[],
            Imu => &["--imu"],
            SecondCamera => &["--with", text(&second)],
            JointFrames => &["--joint-frames"],
            FramesOnly => &["--frames-only"],
        };
        let command: &[&str] = match self.source {
            Replay => &["live", "--no-page", "--speed", "max", "--replay"],
            File | Converted(_) => &["calibrate", "--threads", "2"],
        };
        let options = ["--board", self.board, "-o", text(result)];
        let accepted: &[&str] = if self.is_short() { &["--accept-any"] } else { &[] };
        let finished = evcal(&[command, &[text(recording)], &options, extra, accepted].concat());
        assert_eq!(finished.code, Some(0), "{}: {}", self.name(), finished.stderr);
    }

    /// `check` without a board recognises it, and with the board prints the command that calibrates.
    fn checked(&self, recording: &Path, folder: &Path) {
        let printed = succeed(&["check", text(recording)]);
        let kind = self.board.split(':').next().unwrap_or_default();
        assert!(printed.contains(&format!("--board {kind}:")), "{}: {printed}", self.name());
        let finished = evcal(&["check", text(recording), "--board", self.board]);
        if self.is_short() {
            assert!(finished.stdout.contains("next: the recording is short"), "{}: {finished:?}", self.name());
            return;
        }
        assert_eq!(finished.code, Some(0), "{}: {finished:?}", self.name());
        let printed = finished.stdout;
        let command = printed.lines().find_map(|line| line.trim().strip_prefix("next: evcal "));
        let command = command.unwrap_or_else(|| panic!("{}: {printed}", self.name()));
        let result = folder.join("printed");
        let words: Vec<&str> =
            command.split(' ').map(|word| if word == "calibration" { text(&result) } else { word }).collect();
        let finished = evcal(&words);
        assert_eq!(finished.code, Some(0), "evcal {command}: {}", finished.stderr);
    }

    fn is_right(&self) {
        let folder = tempfile::tempdir().expect("a folder");
        let recording = self.recording(folder.path());
        if self.extra != FramesOnly {
            self.checked(&recording, folder.path());
        }
        let result = folder.path().join("result");
        self.calibrate(&recording, &result);

        let json = read_json(&result.join("calibration.json"));
        let accuracy = Accuracy::of(&result, &self.simulated());
        let bound = json["uncertainty"]["projection_rms_95"].as_f64().expect("a bound");
        assert!(accuracy.projection_rms <= bound, "{}: {accuracy:?}, stated {bound}", self.name());
        let grade = &json["verdict"]["grade"];
        assert!(self.is_short() || grade == "good" || grade == "usable", "{}: {}", self.name(), json["verdict"]);
        if let Some(part) = self.extra.part() {
            assert!(json.get(part).is_some_and(|part| *part != Value::Null), "{}: no {part} in {json}", self.name());
        }

        let report = fs::read_to_string(result.join("report.html")).expect("a report");
        // The lists of files and settings are the same for all boards.
        let report = ["circles.csv", "circles or corners", "fewest_circles"]
            .iter()
            .fold(report, |report, same| report.replace(same, ""));
        let other = if self.board == DOTS { "corners of the board" } else { "circles" };
        assert!(!report.contains(other), "{}: the report speaks of {other}", self.name());
        succeed(&["export", text(&result), "--format", "all", "-o", text(&folder.path().join("exports"))]);
    }
}

// Each board, sensor, source and device at least once.

#[test]
fn dots_from_a_bag_with_a_second_camera() {
    Crossing { board: DOTS, sensor: VGA, source: Converted("bag"), extra: SecondCamera }.is_right();
}

#[test]
fn a_checkerboard_in_a_replay_with_an_imu() {
    Crossing { board: CHECKERBOARD, sensor: DAVIS346, source: Replay, extra: Imu }.is_right();
}

#[test]
fn an_aprilgrid_of_a_large_sensor_in_raw() {
    Crossing { board: APRILGRID, sensor: HD, source: Converted("raw"), extra: Nothing }.is_right();
}

#[test]
fn apriltags_with_the_cameras_frames() {
    Crossing { board: APRILTAGS, sensor: VGA, source: File, extra: JointFrames }.is_right();
}

#[test]
fn a_charuco_board_in_frames_alone_from_mcap() {
    Crossing { board: CHARUCO, sensor: DAVIS346, source: Converted("mcap"), extra: FramesOnly }.is_right();
}

/// Every device with a board from every source, except other cameras in a replay: `evcal live` has none.
macro_rules! all_sources {
    ($($name:ident $board:expr;)*) => {$(
        mod $name {
            use super::*;

            fn all_are_right(extra: Extra) {
                let live: &[Source] = if extra == SecondCamera { &[] } else { &[Replay] };
                for &source in [File, Converted("bag"), Converted("mcap")].iter().chain(live) {
                    Crossing { board: $board, sensor: DAVIS346, source, extra }.is_right();
                }
            }

            all_sources! { @test
                alone Nothing;
                imu Imu;
                second_camera SecondCamera;
                joint_frames JointFrames;
                frames_only FramesOnly;
            }
        }
    )*};
    (@test $($name:ident $extra:expr;)*) => {$(
        #[test]
        #[ignore = "part of make test-all"]
        fn $name() {
            all_are_right($extra);
        }
    )*};
}

all_sources! {
    dots DOTS;
    checkerboard CHECKERBOARD;
    aprilgrid APRILGRID;
    apriltags APRILTAGS;
    charuco CHARUCO;
}
