//! If the recorder is killed, the dump is readable up to its last whole record.

use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use usb_davis::capture::Capture;
use usb_davis::emulator::umockdev::EmulatedBus;
use usb_davis::emulator::{Faults, Model, Piece};

const CAMERAS: u64 = 5;
const RUNS_EACH: u64 = 20;

/// Returns byte `at` of an endless stream that differs at every offset. All words are timestamps.
fn byte(at: u64) -> u8 {
    (at.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8 | if at % 2 == 1 { 0x80 } else { 0 }
}

fn pieces() -> impl Iterator<Item = Piece> + Send + 'static {
    (0..).map(|piece: u64| Piece { time: 0, bytes: (16_384 * piece..16_384 * (piece + 1)).map(byte).collect() })
}

#[test]
fn a_recorder_killed_at_a_random_moment_leaves_a_readable_dump() {
    let unfinished: u64 = std::thread::scope(|scope| {
        let cameras: Vec<_> = (0..CAMERAS).map(|camera| scope.spawn(move || kill_recorders(camera))).collect();
        cameras.into_iter().map(|camera| camera.join().expect("no run fails")).sum()
    });
    println!("{unfinished} of {} ended within a record", CAMERAS * RUNS_EACH);
}

/// Kills recorders of one camera; returns the number of files that ended within a record.
fn kill_recorders(camera: u64) -> u64 {
    // Transfers of irregular length, so that records end at arbitrary positions.
    let faults = Faults { cuts: vec![8192, 513, 100, 16_384, 7], ..Faults::default() };
    let bus = EmulatedBus::start(Model::new("1", pieces).with_faults(faults)).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let path = directory.path().join("killed.dvraw");
    let mut unfinished = 0;
    for run in 0..RUNS_EACH {
        let mut recorder = Command::new(env!("CARGO_BIN_EXE_davis-record"))
            .args([path.to_str().expect("UTF-8"), "60"])
            .envs(bus.environment())
            .stdout(Stdio::null())
            .spawn()
            .expect("davis-record runs");
        // Wait until it records, and then for up to 5 ms more.
        let begun = Instant::now();
        while std::fs::metadata(&path).map_or(0, |file| file.len()) < 10_000 {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing is recorded");
            sleep(Duration::from_millis(1));
        }
        sleep(Duration::from_micros((RUNS_EACH * camera + run) * 7919 % 5000));
        recorder.kill().expect("it runs");
        recorder.wait().expect("it ran");
        unfinished += u64::from(check(&path) > 0);
        std::fs::remove_file(&path).expect("it exists");
    }
    unfinished
}

/// Checks every byte of a dump; returns the number of bytes of an incomplete record at its end.
fn check(path: &Path) -> u64 {
    let length = std::fs::metadata(path).expect("it exists").len();
    let mut capture = Capture::open(path).expect("the header is whole");
    let mut at = 0;
    let mut records = 0;
    while let Some(transfer) = capture.next_transfer().expect("it is readable") {
        assert!(!transfer.gap_before);
        for &received in transfer.payload {
            assert_eq!(received, byte(at), "byte {at}");
            at += 1;
        }
        records += 1;
    }
    let damage = capture.damage();
    assert_eq!((damage.bytes, damage.places), (0, 0));
    assert!(damage.unfinished < 28 + 16_384 && at + 28 * records + damage.unfinished < length);
    damage.unfinished
}
