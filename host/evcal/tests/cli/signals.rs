//! Every command that writes, ended by a signal at any moment, leaves either the old results or the new ones.
//!
//! `EVCAL_SIGNAL_MOMENTS=40` tries 40 moments for each command and signal, instead of two.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use usb_davis::capture::Capture;
use usb_davis::emulator::umockdev::EmulatedBus;

use super::command::{succeed, text};
use super::emulated::{BOARD, camera, events, wait_for};

/// The program raises ABRT itself when it gets no memory.
const SIGNALS: [&str; 6] = ["TERM", "INT", "HUP", "XFSZ", "ABRT", "KILL"];
/// Signals that leave the program no time to clean up.
const AT_ONCE: [&str; 2] = ["ABRT", "KILL"];

/// Signals that leave the program time to give all files their names.
const NOT_AT_ONCE: [&str; 4] = ["TERM", "INT", "HUP", "XFSZ"];

/// Every file below a folder, with its content.
type Content = BTreeMap<PathBuf, Vec<u8>>;

fn content(folder: &Path) -> Content {
    let mut found = Content::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        match path.is_dir() {
            true => found.extend(content(&path)),
            false => {
                found.insert(path.clone(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// Replaces the content of a folder by `content`.
fn restore(folder: &Path, content: &Content) {
    let _ = fs::remove_dir_all(folder);
    for (path, bytes) in content {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
}

/// The part of a run after which it is ended: anywhere, and every other time near its end, where results get their names.
fn moment(index: u32) -> f64 {
    let share = (f64::from(index + 1) * 0.618_033_988_749_895).fract();
    if index.is_multiple_of(2) { share } else { 0.8 + 0.25 * share }
}

fn moments() -> u32 {
    std::env::var("EVCAL_SIGNAL_MOMENTS").map_or(2, |count| count.parse().unwrap())
}

fn program(arguments: &[&str]) -> Command {
    // Tests that run under nohup have HUP ignored, in the background of a shell INT, and so would the program.
    let mut command = Command::new("env");
    command.args(["--default-signal=HUP,INT", env!("CARGO_BIN_EXE_evcal")]).args(arguments);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// Starts the program and sends it a signal after `delay`.
fn end_after(program: &mut Command, signal: &str, delay: Duration) -> ExitStatus {
    let mut child = program.spawn().unwrap();
    sleep(delay);
    assert!(Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap().success());
    child.wait().unwrap()
}

/// Lets `new` replace what `old` wrote into `folder`, and ends it at many moments. After a signal of `together`, all results are
/// old or all are new.
fn end_at_every_moment(folder: &Path, old: &[&str], new: &[&str], together: &[&str]) {
    fs::create_dir(folder).unwrap();
    succeed(old);
    let before = content(folder);
    let began = Instant::now();
    succeed(new);
    let length = began.elapsed();
    let after = content(folder);
    assert_ne!(before, after, "{new:?}");
    for signal in SIGNALS {
        for index in 0..moments() {
            let delay = length.mul_f64(moment(index));
            let is_at_once = AT_ONCE.contains(&signal);
            let context = format!("{signal} after {delay:?} of {length:?}: {new:?}");
            restore(folder, &before);
            end_after(&mut program(new), signal, delay);
            let found = content(folder);
            let is_whole = |(path, bytes): (&PathBuf, &Vec<u8>)| {
                before.get(path) == Some(bytes) || after.get(path) == Some(bytes) || (is_at_once && is_hidden(path))
            };
            let wrong: Vec<&PathBuf> = found.iter().filter(|file| !is_whole(*file)).map(|(path, _)| path).collect();
            assert!(wrong.is_empty(), "{context}: {wrong:?}");
            let visible = || found.iter().filter(|(path, _)| !is_hidden(path));
            if together.contains(&signal) {
                assert!(visible().eq(before.iter()) || visible().eq(after.iter()), "{context}: a mixture");
            } else {
                let is_there = |path: &PathBuf| !before.contains_key(path) || found.contains_key(path);
                assert!(before.keys().all(is_there), "{context}: something is gone");
            }
            if is_at_once {
                succeed(new);
                let again = content(folder);
                assert!(again == after, "{context}: after the next run there are {:?}", again.keys());
            }
        }
    }
}

/// Returns `true` for a temporary file of the program or a file in a temporary folder.
fn is_hidden(path: &Path) -> bool {
    path.components().any(|part| part.as_os_str().to_string_lossy().ends_with(".part"))
}

fn simulation(directory: &TempDir) -> PathBuf {
    let folder = directory.path().join("simulation");
    succeed(&["simulate", "-o", text(&folder), "--duration", "1s", "--motion", "fast", "--seed", "3"]);
    folder
}

#[test]
fn an_interrupted_simulation_leaves_old_or_new_results() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join("outer");
    let output = folder.join("simulation");
    let simulate = ["simulate", "-o", text(&output), "--duration", "100ms", "--force", "--seed"];
    let [old, new] = [["1", "--frames"], ["2", "--imu"]].map(|more| [&simulate[..], &more].concat());
    end_at_every_moment(&folder, &old, &new, &SIGNALS);
}

#[test]
fn an_interrupted_calibration_leaves_old_or_new_results() {
    let directory = tempfile::tempdir().unwrap();
    let circles = directory.path().join("circles.csv");
    let events = simulation(&directory).join("events.aedat4");
    succeed(&["detect", text(&events), "--board", BOARD, "-o", text(&circles)]);
    let folder = directory.path().join("outer");
    let output = folder.join("calibration");
    let calibrate = ["calibrate", text(&circles), "--board", BOARD, "-o", text(&output), "--force", "--accept-any"];
    let [old, new] = [["--model", "radtan4"], ["--model", "radtan"]]
        .map(|more| [&calibrate[..], &["--sensor", "346x260"], &more].concat());
    end_at_every_moment(&folder, &old, &new, &SIGNALS);
}

#[test]
fn interrupted_conversions_and_undistortions_leave_old_or_new_results() {
    let directory = tempfile::tempdir().unwrap();
    let source = simulation(&directory);
    let events = source.join("events.aedat4");
    let folder = directory.path().join("converted");
    let output = folder.join("events.npz");
    let other = directory.path().join("other.csv");
    fs::write(&other, "t_us,x,y,p\n1,2,3,1\n2,3,4,0\n").unwrap();
    let convert = |input| ["convert", input, text(&output), "--force", "--sensor", "346x260"];
    end_at_every_moment(&folder, &convert(text(&other)), &convert(text(&events)), &[]);

    let folder = directory.path().join("undistorted");
    let output = folder.join("events.h5");
    let undistort = ["undistort", text(&events), "-c", text(&source), "-o", text(&output), "--force", "--alpha"];
    let [old, new] = [["0"], ["1"]].map(|more| [&undistort[..], &more].concat());
    end_at_every_moment(&folder, &old, &new, &[]);
}

#[test]
fn interrupted_exports_and_boards_leave_old_or_new_results() {
    let directory = tempfile::tempdir().unwrap();
    let source = simulation(&directory);
    let folder = directory.path().join("exports");
    let output = folder.join("all");
    let export = ["export", text(&source), "--format", "all", "-o", text(&output), "--force", "--camera-name"];
    let [old, new] = [["left"], ["right"]].map(|more| [&export[..], &more].concat());
    end_at_every_moment(&folder, &old, &new, &SIGNALS);

    let folder = directory.path().join("board");
    let [pdf, svg] = ["board.pdf", "board.svg"].map(|name| folder.join(name));
    let board = ["board", "--pdf", text(&pdf), "--svg", text(&svg), "--force", "--paper"];
    let [old, new] = [["a4"], ["a3"]].map(|more| [&board[..], &more].concat());
    end_at_every_moment(&folder, &old, &new, &NOT_AT_ONCE);
}

/// The pictures and their camera belong together: two cameras in one folder would be taken for one.
#[test]
fn interrupted_pictures_leave_those_of_one_camera() {
    let directory = tempfile::tempdir().unwrap();
    let source = directory.path().join("simulation");
    let simulate = ["simulate", "-o", text(&source), "--duration", "300ms", "--frames", "--seed", "3"];
    succeed(&simulate);
    let events = source.join("events.aedat4");
    let folder = directory.path().join("outer");
    let output = folder.join("pictures");
    let undistort = ["undistort", text(&events), "-c", text(&source), "--frames", text(&output), "--force", "--alpha"];
    let [old, new] = [["0"], ["1"]].map(|more| [&undistort[..], &more].concat());
    end_at_every_moment(&folder, &old, &new, &SIGNALS);
}

/// A recording has everything that the camera sent before the signal; only a signal that ends the program at once may cut the last transfer.
#[test]
fn an_interrupted_recording_loses_at_most_its_last_transfer() {
    let sent: Vec<u8> = events(9_000_000).flat_map(|piece| piece.bytes).collect();
    // At full speed the camera drops nothing.
    let bus = EmulatedBus::start(camera(9_000_000)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("recording.dvraw");
    let began = Instant::now();
    let mut first = program(&["record", text(&path)]).envs(bus.environment()).spawn().unwrap();
    wait_for("the recording", || fs::metadata(&path).is_ok_and(|file| file.len() > sent.len() as u64));
    let length = began.elapsed();
    first.kill().unwrap();
    first.wait().unwrap();
    fs::remove_file(&path).unwrap();
    let mut recorded = 0;
    for signal in SIGNALS {
        for index in 0..moments() {
            let delay = length.mul_f64(moment(index));
            let ended = end_after(program(&["record", text(&path)]).envs(bus.environment()), signal, delay);
            let context = format!("{signal} after {delay:?} of {length:?}: {ended}");
            let names: Vec<PathBuf> = content(directory.path()).into_keys().collect();
            if names.is_empty() {
                assert!(!ended.success(), "{context}: nothing was recorded");
                continue;
            }
            assert_eq!(names, [path.as_path()], "{context}");
            let is_at_once = AT_ONCE.contains(&signal);
            assert_eq!(ended.success(), !is_at_once, "{context}");
            let mut capture = Capture::open(&path).unwrap_or_else(|error| panic!("{context}: {error}"));
            let mut found = Vec::new();
            while let Some(transfer) = capture.next_transfer().unwrap() {
                found.extend_from_slice(transfer.payload);
            }
            let damage = capture.damage();
            assert!(is_at_once || damage.unfinished == 0, "{context}: {damage:?}");
            assert_eq!((damage.bytes, damage.places), (0, 0), "{context}");
            assert!(sent.starts_with(&found), "{context}: {} bytes", found.len());
            recorded += found.len();
            fs::remove_file(&path).unwrap();
        }
    }
    assert!(recorded > 0, "no run recorded anything");
}
