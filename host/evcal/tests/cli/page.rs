//! The page of `evcal live` on an emulated camera: it does not change a recording, and can start the next one.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, sleep};
use std::time::Duration;

use usb_davis::capture::Capture;
use usb_davis::emulator::umockdev::EmulatedBus;
use usb_davis::emulator::{Model, Pace, Piece};

use crate::emulated::{
    BOARD, board_recording, camera, count, easy_settings, events, json, start, text, total, wait_for,
};

/// Clients of the page during a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Watching {
    Nobody,
    /// A page that reads and draws the states.
    Page,
    /// A client that sends a request and reads nothing.
    Frozen,
    /// Sixteen clients that send one byte per second.
    Slow,
}

const WATCHING: [Watching; 4] = [Watching::Nobody, Watching::Page, Watching::Frozen, Watching::Slow];

/// Requests the page at `address` until `is_over`; returns the number of received states.
fn watch(watching: Watching, address: &str, token: &str, is_over: &AtomicBool) -> usize {
    let ask = |request: &str| {
        let mut stream = TcpStream::connect(address).ok()?;
        write!(stream, "{request} HTTP/1.1\r\nHost: {address}\r\nX-Evcal-Token: {token}\r\nConnection: close\r\n\r\n")
            .ok()?;
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
                // The server closes connections that take too long.
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

/// Records `model` with `evcal live` for `seconds` with these clients; returns the bytes of the recording and the number of states.
fn recorded(model: Model, watching: Watching, seconds: &str) -> (Vec<u8>, usize) {
    let directory = tempfile::tempdir().unwrap();
    let bus = EmulatedBus::start(model).unwrap();
    let page: &[&str] = if watching == Watching::Nobody { &["--no-page"] } else { &["--port=0", "--no-open"] };
    let arguments = ["live", "--board", BOARD, "-o", text(directory.path()), "--duration", seconds];
    let mut child = start(&bus, &[&arguments, page].concat());
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
    let mut printed = String::new();
    let states = thread::scope(|scope| {
        let watcher = scope.spawn(|| watch(watching, &address, &token, &is_over));
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        // The summary of the recording.
        printed =
            lines.find_map(|line| line.ok().filter(|line| line.contains("(the time is over)"))).unwrap_or_default();
        is_over.store(true, Ordering::Relaxed);
        let states = watcher.join().unwrap();
        lines.for_each(drop);
        states
    });
    let mut error = String::new();
    errors.read_to_string(&mut error).unwrap();
    child.wait().unwrap();
    assert!(!printed.is_empty(), "{error}");
    let mut capture = Capture::open(directory.path().join("recording.dvraw")).unwrap();
    let mut bytes = Vec::new();
    while let Some(transfer) = capture.next_transfer().unwrap() {
        assert!(!transfer.gap_before, "{watching:?}: a transfer was lost");
        bytes.extend_from_slice(transfer.payload);
    }
    println!("{watching:?}: {} bytes, {states} states; {printed}", bytes.len());
    (bytes, states)
}

/// Whatever clients do, the recording contains exactly the bytes that the camera sent.
#[test]
fn clients_of_the_page_do_not_change_the_recording() {
    const EVENTS: u64 = 3_000_000;
    let sent: Vec<u8> = events(EVENTS).flat_map(|piece| piece.bytes).collect();
    for watching in WATCHING {
        let (bytes, states) = recorded(camera(EVENTS), watching, "4s");
        assert!(bytes == sent, "{watching:?}: {} of {} bytes", bytes.len(), sent.len());
        assert_eq!(states > 1, watching == Watching::Page, "{states}");
    }
}

/// The same at 10 million events per second for 10 s. Needs an idle computer: the camera drops data that is not fetched
/// in time.
#[test]
#[ignore = "needs a computer that has nothing else to do"]
fn clients_of_the_page_lose_no_events_of_a_fast_camera() {
    const EVENTS: u64 = 100_000_000;
    for watching in WATCHING {
        let source = || events(EVENTS).map(|piece| Piece { time: piece.time * 3 / 10, ..piece });
        let model = Model::new("00000042", source).with_pace(Pace::Real);
        let (bytes, _) = recorded(model, watching, "11s");
        assert_eq!(bytes.len() as u64, total(EVENTS), "{watching:?}");
    }
}

/// After the result, the page can start another recording: in addition to the first, or instead of it.
#[test]
fn another_recording_is_added_or_replaces_the_first() {
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
    let mut child = start(&bus, &[arguments.as_slice(), &["--port", "0", "--no-open", "--duration", "4s"]].concat());
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
        calibration["stages"]["recordings"].as_array().unwrap().len()
    };
    assert_eq!(recordings(), 1);
    let boards = |state: &str| {
        let (_, rest) = state.split_once("\"boards\":").unwrap();
        rest.split_once(',').unwrap().0.parse::<u64>().unwrap()
    };
    let after_one = boards(&ask("GET /live?after=0"));
    assert!(after_one > 100, "{after_one}");
    for (wish, count) in [("add", 2), ("again", 1)] {
        ask(&format!("POST /{wish}"));
        wait_for("the next recording", || !ask("GET /live?after=0").contains("\"phase\":\"done\""));
        // Observations of the earlier recording count for an added one, but not for a replacement.
        let mut state = String::new();
        wait_for("its first picture", || {
            state = ask("GET /live?after=0");
            !state.contains("\"phase\":\"done\"") && state.contains(&format!("\"before\":{}", count - 1))
        });
        assert_eq!(boards(&state) >= after_one, wish == "add", "{wish}: {} {after_one}", boards(&state));
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
