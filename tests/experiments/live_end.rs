//! How long after the end of a live recording its result and report are there.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/live_end SECONDS [SEED]    # simulates fast motion, and plays it to evcal live as a camera would
//! ```
//!
//! The camera is emulated on umockdev's preload library (Debian package `umockdev`), on the same computer.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use evcal_tests::{BOARD, program, succeed, text};
use usb_davis::capture::Capture;
use usb_davis::emulator::umockdev::EmulatedBus;
use usb_davis::emulator::{Model, Pace, Piece};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let seconds: u32 = arguments.first().map_or(20, |seconds| seconds.parse().expect("whole seconds"));
    let seed = arguments.get(1).map_or("1", String::as_str);
    let folder = tempfile::tempdir().expect("a folder can be made");
    let (simulated, dump, results) =
        (folder.path().join("simulated"), folder.path().join("camera.dvraw"), folder.path().join("results"));
    let duration = format!("{seconds}s");
    succeed(&["simulate", "-o", text(&simulated), "--motion", "fast", "--duration", &duration, "--seed", seed]);
    succeed(&["convert", text(&simulated.join("events.aedat4")), text(&dump)]);
    let mut capture = Capture::open(&dump).expect("it was just made");
    let mut pieces = Vec::new();
    while let Some(transfer) = capture.next_transfer().expect("it is whole") {
        let time = transfer.host_ns.unwrap_or(0) / 1000;
        pieces.push(Piece { time, bytes: transfer.payload.to_vec() });
    }
    let model = Model::new("00000042", move || pieces.clone().into_iter()).with_pace(Pace::Real);
    let bus = EmulatedBus::start(model).expect("umockdev is installed");
    let mut live = Command::new(program())
        .args(["live", "--board", BOARD, "--no-page", "--accept-any", "--duration", &duration, "-o", text(&results)])
        .envs(bus.environment())
        .stdout(Stdio::piped())
        .spawn()
        .expect("evcal starts");
    let lines = BufReader::new(live.stdout.take().expect("it is a pipe")).lines();
    let mut end = None;
    for line in lines.map_while(Result::ok) {
        println!("{line}");
        // What was recorded is told as soon as the recording has ended.
        if line.contains("recording.dvraw") && end.is_none() {
            end = Some(Instant::now());
        }
    }
    let status = live.wait().expect("it ends");
    let waited = end.map_or(Duration::ZERO, |end| end.elapsed());
    println!("{seconds} s, seed {seed}: result and report {:.2} s after the end ({status})", waited.as_secs_f64());
}
