//! An emulated camera on umockdev's preload library (Debian package `umockdev`), and programs that run on it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use event_recordings::{Recording, RecordingOptions};
use serde_json::Value;
use usb_davis::capture::Capture;
use usb_davis::emulator::umockdev::EmulatedBus;
use usb_davis::emulator::{Model, Piece};
use usb_davis::protocol::{Encoder, Layout, Polarity, PolarityEvent};

pub const BOARD: &str = "acircles:9x4:55mm:r17.5mm";
/// Long enough for a busy computer.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// `count` events as pieces of some 16 KiB.
pub fn events(count: u64) -> impl Iterator<Item = Piece> + Send + 'static {
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

pub fn camera(count: u64) -> Model {
    Model::new("00000042", move || events(count))
}

pub fn total(count: u64) -> u64 {
    events(count).map(|piece| piece.bytes.len() as u64).sum()
}

pub fn command(bus: &EmulatedBus, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
    command.args(arguments).envs(bus.environment());
    command
}

/// Starts it in the background.
pub fn start(bus: &EmulatedBus, arguments: &[&str]) -> Child {
    command(bus, arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until a condition is true.
pub fn wait_for(what: &str, mut is_true: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !is_true() {
        assert!(Instant::now() < end, "{what} did not happen (is the package umockdev installed?)");
        sleep(Duration::from_millis(20));
    }
}

pub fn count(path: &Path) -> u64 {
    let mut reader = Recording::new(path, RecordingOptions::default()).unwrap().open().unwrap();
    let mut batch = Vec::new();
    while reader.next_batch(&mut batch).unwrap() {}
    assert!(reader.report().stream.faults.is_empty());
    reader.report().events
}

pub fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|_| panic!("{text}"))
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A simulated recording of the board, and the bytes that a camera sends for it.
pub fn board_recording(directory: &Path, seed: &str) -> Vec<Piece> {
    let evcal = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_evcal")).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    let (folder, dump) =
        (directory.join(format!("simulated-{seed}")), directory.join(format!("simulated-{seed}.dvraw")));
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

/// Settings with which 200 boards are enough, the first checkpoint comes after a second, and the display leaves nothing out.
pub fn easy_settings(directory: &Path) -> PathBuf {
    let path = directory.join("easy.toml");
    let text = "[live]\ncoverage = 0.1\nboards_per_tilt = 0\nlongest_wait = 1000.0\nshortest = 0.0\ntarget = 10.0\n";
    fs::write(&path, text).unwrap();
    path
}
