//! `evcal devices`, `record` and `live`, as a user runs them, on an emulated camera on umockdev's
//! preload library (Debian package `umockdev`).
#![cfg(target_os = "linux")]

use std::fs::{self, Permissions};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use evcal::recording::{Recording, RecordingOptions};
use serde_json::Value;
use usb_davis::capture::Capture;
use usb_davis::emulator::umockdev::{Access, EmulatedBus};
use usb_davis::emulator::{Failures, Faults, Model, Pace, Piece};
use usb_davis::protocol::{Encoder, Layout, Polarity, PolarityEvent};
use usb_davis::registers::mux;

const BOARD: &str = "acircles:9x4:55mm:r17.5mm";
const NOBODY: u32 = 65_534;
/// Long enough for a computer that has other things to do.
const PATIENCE: Duration = Duration::from_secs(120);

/// `count` events as pieces of some 16 KiB.
fn events(count: u64) -> impl Iterator<Item = Piece> + Send + 'static {
    let mut encoder = Encoder::new(Layout::DAVIS346);
    (0..count).step_by(3000).map(move |first| {
        let mut bytes = Vec::new();
        for index in first..(first + 3000).min(count) {
            let mixed = index.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
            let (x, y) = ((mixed % 346) as u16, (mixed / 346 % 260) as u16);
            let event = PolarityEvent { time: index / 3, x, y, polarity: Polarity::On };
            encoder.event(&event, &mut bytes).unwrap();
        }
        Piece { time: first / 3, bytes }
    })
}

fn camera(count: u64) -> Model {
    Model::new("00000042", move || events(count))
}

fn total(count: u64) -> u64 {
    events(count).map(|piece| piece.bytes.len() as u64).sum()
}

fn command(bus: &EmulatedBus, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
    command.args(arguments).envs(bus.environment());
    command
}

fn run(bus: &EmulatedBus, arguments: &[&str]) -> (Option<i32>, String, String) {
    ended(command(bus, arguments).output().unwrap())
}

fn ended(output: Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

/// Starts it in the background.
fn start(bus: &EmulatedBus, arguments: &[&str]) -> Child {
    command(bus, arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits for something to become true.
fn wait_for(what: &str, mut is_true: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !is_true() {
        assert!(Instant::now() < end, "{what} did not happen (is the package umockdev installed?)");
        sleep(Duration::from_millis(20));
    }
}

fn interrupt(child: Child) -> (Option<i32>, String, String) {
    let status = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(status.success());
    ended(child.wait_with_output().unwrap())
}

fn count(path: &Path) -> u64 {
    let mut reader = Recording::new(path, RecordingOptions::default()).unwrap().open().unwrap();
    let mut batch = Vec::new();
    while reader.next_batch(&mut batch).unwrap() {}
    assert!(reader.report().stream.faults.is_empty());
    reader.report().events
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|_| panic!("{text}"))
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn cameras_are_listed_and_a_busy_one_says_so() {
    let bus = EmulatedBus::start(camera(3000)).unwrap();
    let (code, listing, errors) = run(&bus, &["devices"]);
    assert_eq!(code, Some(0), "{errors}");
    let expected = "DAVIS346, serial number 00000042, bus 2, address 3, firmware 6, logic 18.1, ready";
    assert_eq!(listing.trim(), expected);
    let (_, listing, _) = run(&bus, &["devices", "--json"]);
    let listing = json(&listing);
    assert_eq!((&listing[0]["state"], &listing[0]["serial"]), (&"ready".into(), &"00000042".into()));

    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("busy.dvraw");
    let recorder = start(&bus, &["record", text(&file)]);
    wait_for("the recording", || bus.model(|model| model.sent()) >= total(3000));
    let (code, listing, errors) = run(&bus, &["devices"]);
    assert_eq!(code, Some(1));
    assert!(listing.contains("busy") && errors.contains("used by another program; end that first"), "{errors}");
    let (code, listing, _) = run(&bus, &["devices", "--json"]);
    assert_eq!((code, json(&listing)[0]["state"].as_str()), (Some(1), Some("busy")));
    assert_eq!(interrupt(recorder).0, Some(0));
}

#[test]
fn a_forbidden_camera_comes_with_the_rule_that_opens_it() {
    let bus = EmulatedBus::start(camera(0)).unwrap();
    bus.set_access(Access::Forbidden).unwrap();
    let directory = tempfile::tempdir().unwrap();
    fs::set_permissions(directory.path(), Permissions::from_mode(0o755)).unwrap();
    let program = directory.path().join("evcal");
    // Not `fs::copy`: a test that starts a program meanwhile would hand it the file open for writing.
    let copy = Command::new("cp").arg(env!("CARGO_BIN_EXE_evcal")).arg(&program).status().unwrap();
    assert!(copy.success());
    let mut command = Command::new(&program);
    command.arg("devices").envs(bus.environment());
    // Root may open everything.
    if fs::metadata(directory.path()).unwrap().uid() == 0 {
        command.uid(NOBODY).gid(NOBODY);
    }
    let (code, listing, errors) = ended(command.output().unwrap());
    assert_eq!(code, Some(1), "{listing} {errors}");
    assert!(listing.contains("forbidden"), "{listing}");
    assert!(errors.contains("/etc/udev/rules.d/") && errors.contains(r#"ATTR{idVendor}=="152a""#), "{errors}");
}

#[test]
fn an_absent_camera_is_a_failure_with_advice() {
    let bus = EmulatedBus::start(camera(3000)).unwrap();
    bus.unplug().unwrap();
    let directory = tempfile::tempdir().unwrap();
    assert_eq!(run(&bus, &["devices", "--json"]).1.trim(), "[]");
    let output = directory.path().join("output");
    let recording = directory.path().join("none.dvraw");
    for arguments in [
        ["devices"].as_slice(),
        &["record", text(&recording)],
        &["live", "--board", BOARD, "-o", text(&output)],
        &["record", text(&recording), "--serial", "00000007"],
    ] {
        let (code, _, errors) = run(&bus, arguments);
        assert_eq!(code, Some(1), "{arguments:?}");
        assert!(errors.contains("no camera found") && errors.contains("is it plugged in?"), "{errors}");
        let is_full = ["lsusb", "/etc/udev/rules.d/", "DAVIS346"].iter().all(|part| errors.contains(part));
        assert_eq!(is_full, arguments == ["devices"], "{errors}");
    }
    assert!(!recording.exists() && !output.exists());
}

#[test]
fn a_recording_ends_with_its_time_or_at_ctrl_c_and_has_everything() {
    const COUNT: u64 = 200_000;
    let bus = EmulatedBus::start(camera(COUNT)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("interrupted.dvraw");
    let recorder = start(&bus, &["record", text(&file)]);
    wait_for("the stream", || bus.model(|model| model.sent()) >= total(COUNT));
    let (code, told, errors) = interrupt(recorder);
    assert_eq!((code, errors.as_str()), (Some(0), ""), "{told}");
    assert!(told.contains("200000 events") && told.contains("(stopped)"), "{told}");
    assert_eq!(count(&file), COUNT);
    assert_eq!(Capture::open(&file).unwrap().header().camera_name(), "DAVIS346_00000042");

    let timed = directory.path().join("timed.dvraw");
    let (code, told, errors) = run(&bus, &["record", text(&timed), "--duration", "3s", "--json"]);
    assert_eq!(code, Some(0), "{errors}");
    let report = json(&told);
    assert_eq!((&report["ending"], &report["dropped"]), (&"the time is over".into(), &0.into()));
    assert_eq!(report["events"].as_u64(), Some(count(&timed)));

    let before = fs::read(&timed).unwrap();
    let (code, _, errors) = run(&bus, &["record", text(&timed), "--duration", "1s"]);
    assert_eq!(code, Some(1));
    assert!(errors.contains("choose another name"), "{errors}");
    assert_eq!(fs::read(&timed).unwrap(), before);
}

#[test]
fn unplugged_in_mid_stream_everything_before_it_is_kept() {
    const COUNT: u64 = 200_000;
    for (faults, reason) in [
        (Faults { unplug_at: Some(total(COUNT) / 2), ..Faults::default() }, "unplugged"),
        (Faults { stall_at: Some(total(COUNT) / 2), ..Faults::default() }, "halted"),
    ] {
        let bus = EmulatedBus::start(camera(COUNT).with_faults(faults)).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("half.dvraw");
        let (code, told, errors) = run(&bus, &["record", text(&file)]);
        assert_eq!(code, Some(1), "{told}");
        assert!(errors.contains(reason) && errors.contains("what came before is in"), "{errors}");
        assert!(count(&file).abs_diff(COUNT / 2) < COUNT / 100);
    }
}

#[test]
fn a_recording_is_not_given_the_ending_of_another_format() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("session.csv");
    let output = Command::new(env!("CARGO_BIN_EXE_evcal")).args(["record", text(&file)]).output().unwrap();
    let (code, _, errors) = ended(output);
    assert_eq!((code, file.exists()), (Some(2), false));
    assert!(errors.contains("session.dvraw") && errors.contains("evcal convert"), "{errors}");
}

#[test]
fn a_start_that_failed_can_be_tried_again_with_the_same_name() {
    let failures = Some(Failures { at: 0, transfers: 1 });
    let bus = EmulatedBus::start(camera(3000).with_faults(Faults { failures, ..Faults::default() })).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("again.dvraw");
    let (code, _, errors) = run(&bus, &["record", text(&file), "--duration", "1s"]);
    assert_eq!((code, file.exists()), (Some(1), false), "{errors}");
    let (code, _, errors) = run(&bus, &["record", text(&file), "--duration", "1s"]);
    assert_eq!(code, Some(0), "{errors}");
    assert_eq!(count(&file), 3000);
}

#[test]
fn a_full_disk_ends_the_recording_which_tells_what_is_in_the_file() {
    let bus = EmulatedBus::start(camera(1_000_000)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("full.dvraw");
    // A limit of the file's length is met as the end of a disk is: by a write that is cut, then refused.
    let output = Command::new("bash")
        .args(["-c", r#"ulimit -f 1000; trap "" XFSZ; exec "$0" "$@""#, env!("CARGO_BIN_EXE_evcal")])
        .args(["record", text(&file), "--json"])
        .envs(bus.environment())
        .output()
        .unwrap();
    let (code, told, errors) = ended(output);
    assert_eq!(code, Some(1), "{told}");
    assert!(errors.contains("could not be written any more") && errors.contains("make room on the disk"), "{errors}");
    let (report, events) = (json(&told), count(&file));
    assert!(events > 100_000, "{events}");
    assert_eq!(report["events"].as_u64(), Some(events));
    assert!(errors.contains(&format!("{events} events")), "{errors}");
    assert_eq!(report["file_bytes"].as_u64(), Some(fs::metadata(&file).unwrap().len()));
    let mut capture = Capture::open(&file).unwrap();
    let mut bytes = 0;
    while let Some(transfer) = capture.next_transfer().unwrap() {
        bytes += transfer.payload.len() as u64;
    }
    assert_eq!((report["bytes"].as_u64(), capture.damage()), (Some(bytes), Default::default()));
}

#[test]
fn what_an_earlier_recording_lost_is_not_told_again() {
    let earlier = [(mux::DVS_DROPPED, 0), (mux::DVS_DROPPED.next(), 77)];
    let bus = EmulatedBus::start(camera(3000).with_registers(earlier)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("second.dvraw");
    let (code, told, errors) = run(&bus, &["record", text(&file), "--duration", "1s", "--json"]);
    assert_eq!((code, json(&told)["dropped"].as_u64()), (Some(0), Some(0)), "{errors}");
    let recording = Recording::new(&file, RecordingOptions::default()).unwrap();
    let mut reader = recording.open().unwrap();
    let mut batch = Vec::new();
    while reader.next_batch(&mut batch).unwrap() {}
    assert_eq!(reader.report().stream.dropped, 0);
}

/// A simulated recording of the board and what the camera sends of it.
fn board_recording(directory: &Path, seed: &str) -> Vec<Piece> {
    let evcal = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_evcal")).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    let (folder, dump) = (directory.join(format!("simulated-{seed}")), directory.join(format!("simulated-{seed}.dvraw")));
    let options = ["--board", BOARD, "--duration", "3s", "--motion", "fast", "--seed", seed];
    evcal(&[["simulate", "-o", text(&folder)].as_slice(), &options].concat());
    evcal(&["convert", text(&folder.join("events.aedat4")), text(&dump)]);
    let mut capture = Capture::open(&dump).unwrap();
    let mut pieces = Vec::new();
    while let Some(transfer) = capture.next_transfer().unwrap() {
        pieces.push(Piece { time: transfer.host_ns.unwrap() / 1000, bytes: transfer.payload.to_vec() });
    }
    pieces
}

/// Settings with which 100 boards are enough and the display leaves nothing out.
fn easy_settings(directory: &Path) -> PathBuf {
    let path = directory.join("easy.toml");
    let text = "[live]\nboards = 100\ncoverage = 0.1\nboards_per_tilt = 0\nlongest_wait = 1000.0\nshortest = 0.0\ntarget = 10.0\nfirst_checkpoint = 1.0\n";
    fs::write(&path, text).unwrap();
    path
}

/// All files of results with their content but for the report, which tells the command line.
fn results(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            files.extend(results(&path));
        } else if name != "report.html" && !name.ends_with(".dvraw") {
            files.push((name, fs::read(path).unwrap()));
        }
    }
    files.sort();
    files
}

#[test]
fn live_stops_when_it_has_enough_and_calibrates_as_from_the_recording() {
    let directory = tempfile::tempdir().unwrap();
    let pieces = board_recording(directory.path(), "7");
    let sent: u64 = pieces.iter().map(|piece| piece.bytes.len() as u64).sum();
    let unplug = Faults { unplug_at: Some(sent - 1000), ..Faults::default() };
    // At full pace nothing is dropped, so that the byte at which it is unplugged comes.
    for (name, faults, pace) in [("enough", Faults::default(), Pace::Real), ("unplugged", unplug, Pace::Full)] {
        let pieces = pieces.clone();
        let model = Model::new("00000042", move || pieces.clone().into_iter()).with_pace(pace);
        let is_unplugged = faults != Faults::default();
        let bus = EmulatedBus::start(model.with_faults(faults)).unwrap();
        let (live, again) = (directory.path().join(name), directory.path().join(format!("{name}-again")));
        let settings = easy_settings(directory.path());
        let mut arguments = vec!["live", "--board", BOARD, "-o", text(&live), "--duration", "100s", "--accept-any"];
        if !is_unplugged {
            arguments.extend(["--settings", text(&settings)]);
        }
        let (code, told, errors) = run(&bus, &arguments);
        let recording = live.join("recording.dvraw");
        assert_eq!(code, Some(i32::from(is_unplugged)), "{told}\n{errors}");
        assert!(is_unplugged || (told.contains("Mev/s") && told.contains("% of the sensor")), "{told}");
        assert_eq!(errors.contains("the camera was unplugged"), is_unplugged, "{errors}");
        assert_eq!(told.contains("(stopped)"), !is_unplugged, "{told}");
        let mut arguments = vec!["calibrate", text(&recording), "--board", BOARD, "-o", text(&again), "--accept-any"];
        if !is_unplugged {
            arguments.extend(["--settings", text(&settings)]);
        }
        let output = Command::new(env!("CARGO_BIN_EXE_evcal")).args(&arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let (live, again) = (results(&live), results(&again));
        assert!(live.iter().any(|(name, _)| name == "calibration.json"), "{told}");
        assert!(live == again, "{name}: the results differ");
    }
}

/// Who looks at the page while it is recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Watching {
    Nobody,
    /// A page that draws what it gets.
    Page,
    /// One that asks and reads nothing.
    Frozen,
    /// Sixteen that send a byte a second.
    Slow,
}

const WATCHING: [Watching; 4] = [Watching::Nobody, Watching::Page, Watching::Frozen, Watching::Slow];

/// Watches the page at `address` until `is_over`; how many states came.
fn watch(watching: Watching, address: &str, token: &str, is_over: &AtomicBool) -> usize {
    let ask = |request: &str| {
        let mut stream = TcpStream::connect(address).ok()?;
        write!(stream, "{request} HTTP/1.1\r\nHost: {address}\r\nX-Evcal-Token: {token}\r\nConnection: close\r\n\r\n").ok()?;
        Some(stream)
    };
    let (mut states, mut number, mut open) = (0, 0, Vec::new());
    let head = format!("GET /live?after=0 HTTP/1.1\r\nHost: {address}\r\nX-Evcal-Token: {token}\r\n\r\n");
    for round in 0.. {
        if is_over.load(Ordering::Relaxed) {
            break;
        }
        match watching {
            Watching::Nobody => sleep(Duration::from_millis(20)),
            Watching::Page => {
                let mut answer = Vec::new();
                if let Some(mut stream) = ask(&format!("GET /live?after={number}"))
                    && stream.read_to_end(&mut answer).is_ok()
                    && let Some(start) = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n")
                    && let Some(bytes) = answer.get(start + 8..start + 12)
                {
                    number = u32::from_le_bytes(bytes.try_into().unwrap());
                    states += 1;
                }
            }
            Watching::Frozen if open.is_empty() => {
                let mut stream = TcpStream::connect(address).unwrap();
                let _ = stream.write_all(head.repeat(100).as_bytes());
                open.push(stream);
            }
            Watching::Frozen => sleep(Duration::from_millis(20)),
            Watching::Slow => {
                while open.len() < 16
                    && let Ok(stream) = TcpStream::connect(address)
                {
                    open.push(stream);
                }
                let byte = [head.as_bytes()[round % head.len()]];
                // The server closes those that take too long.
                open.retain_mut(|stream| stream.write_all(&byte).is_ok());
                (0..50).take_while(|_| !is_over.load(Ordering::Relaxed)).for_each(|_| sleep(Duration::from_millis(20)));
            }
        }
    }
    if watching == Watching::Page
        && let Some(mut stream) = ask("POST /close")
    {
        let _ = stream.read_to_end(&mut Vec::new());
    }
    states
}

/// Records `model` with `evcal live` for `seconds`, watched so: what is in the recording, and how many states the page got.
fn recorded(model: Model, watching: Watching, seconds: &str) -> (Vec<u8>, usize) {
    let directory = tempfile::tempdir().unwrap();
    let bus = EmulatedBus::start(model).unwrap();
    let page = if watching == Watching::Nobody { "--no-page" } else { "--port=0" };
    let arguments = ["live", "--board", BOARD, "-o", text(directory.path()), "--duration", seconds, page];
    let mut child = start(&bus, &arguments);
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    let (mut address, mut token) = (String::new(), String::new());
    if watching != Watching::Nobody {
        let mut line = String::new();
        errors.read_line(&mut line).unwrap();
        let url = line.split_once("http://").unwrap_or_else(|| panic!("{line}")).1;
        let (place, rest) = url.split_once("/#").unwrap();
        (address, token) = (place.to_owned(), rest.chars().take(32).collect());
    }
    let is_over = AtomicBool::new(false);
    let mut told = String::new();
    let states = thread::scope(|scope| {
        let watcher = scope.spawn(|| watch(watching, &address, &token, &is_over));
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        // The line that sums the recording up.
        told = lines.find_map(|line| line.ok().filter(|line| line.contains("(the time is over)"))).unwrap_or_default();
        is_over.store(true, Ordering::Relaxed);
        let states = watcher.join().unwrap();
        lines.for_each(drop);
        states
    });
    let mut error = String::new();
    errors.read_to_string(&mut error).unwrap();
    child.wait().unwrap();
    assert!(!told.is_empty(), "{error}");
    let mut capture = Capture::open(&directory.path().join("recording.dvraw")).unwrap();
    let mut bytes = Vec::new();
    while let Some(transfer) = capture.next_transfer().unwrap() {
        assert!(!transfer.gap_before, "{watching:?}: a transfer was lost");
        bytes.extend_from_slice(transfer.payload);
    }
    println!("{watching:?}: {} bytes, {states} states; {told}", bytes.len());
    (bytes, states)
}

/// Whoever looks at the page, or holds connections open: the recording holds what the camera sent, to the byte.
#[test]
fn no_page_changes_the_recording() {
    const EVENTS: u64 = 3_000_000;
    let sent: Vec<u8> = events(EVENTS).flat_map(|piece| piece.bytes).collect();
    for watching in WATCHING {
        let (bytes, states) = recorded(camera(EVENTS), watching, "4s");
        assert!(bytes == sent, "{watching:?}: {} of {} bytes", bytes.len(), sent.len());
        assert_eq!(states > 1, watching == Watching::Page, "{states}");
    }
}

/// The same at 10 million events a second for 10 s, for a computer that has nothing else to do: the camera drops what is
/// not fetched in time.
#[test]
#[ignore = "needs a computer that has nothing else to do"]
fn no_page_loses_events_of_a_fast_camera() {
    const EVENTS: u64 = 100_000_000;
    for watching in WATCHING {
        let source = || events(EVENTS).map(|piece| Piece { time: piece.time * 3 / 10, ..piece });
        let model = Model::new("00000042", source).with_pace(Pace::Real);
        let (bytes, _) = recorded(model, watching, "11s");
        assert_eq!(bytes.len() as u64, total(EVENTS), "{watching:?}");
    }
}

/// After the result the page can ask for another recording: beside the first, or in its place.
#[test]
fn another_recording_is_added_or_takes_the_place() {
    let directory = tempfile::tempdir().unwrap();
    // The same events twice would be refused.
    let both = ["7", "8"].map(|seed| board_recording(directory.path(), seed));
    let mut starts = 0;
    let model = Model::new("00000042", move || {
        starts += 1;
        both[starts % 2].clone().into_iter()
    });
    let bus = EmulatedBus::start(model).unwrap();
    let (out, settings) = (directory.path().join("live"), easy_settings(directory.path()));
    let arguments = ["live", "--board", BOARD, "-o", text(&out), "--settings", text(&settings), "--accept-any"];
    let mut child = start(&bus, &[arguments.as_slice(), &["--port", "0", "--duration", "4s"]].concat());
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    errors.read_line(&mut line).unwrap();
    let (address, rest) = line.split_once("http://").unwrap().1.split_once("/#").unwrap();
    let ask = |request: &str| {
        let mut stream = TcpStream::connect(address).unwrap();
        let token = &rest[..32];
        write!(stream, "{request} HTTP/1.1\r\nHost: {address}\r\nX-Evcal-Token: {token}\r\nConnection: close\r\n\r\n")
            .unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    };
    let recordings = || {
        wait_for("the result", || ask("GET /live?after=0").contains("\"phase\":\"done\""));
        let calibration = json(&fs::read_to_string(out.join("calibration.json")).unwrap());
        calibration["recordings"].as_array().unwrap().len()
    };
    assert_eq!(recordings(), 1);
    for (wish, count) in [("add", 2), ("again", 1)] {
        ask(&format!("POST /{wish}"));
        wait_for("the next recording", || !ask("GET /live?after=0").contains("\"phase\":\"done\""));
        assert_eq!(recordings(), count);
    }
    ask("POST /close");
    let mut left = String::new();
    errors.read_to_string(&mut left).unwrap();
    assert!(child.wait().unwrap().success(), "{left}");
    for number in ["", "-2", "-3"] {
        assert!(count(&out.join(format!("recording{number}.dvraw"))) > 100_000);
    }
}
