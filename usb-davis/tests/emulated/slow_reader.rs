//! A reader that pauses because its disk is busy: the data that the camera sends in the meantime wait in memory.

use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::streams::{event, events, total};
use usb_davis::configuration::{Configuration, Streams};
use usb_davis::device::{Camera, Queue, Selector, StreamError};
use usb_davis::emulator::umockdev::EmulatedBus;
use usb_davis::emulator::{Faults, Model};
use usb_davis::protocol::{Decoder, Message};

/// Three seconds at 24 and at 10.8 MB/s, and the length of the transfers at 1000 transfers per second.
const STALLS: [(u64, usize); 2] = [(72_000_000, 24_000), (32_400_000, 10_800)];

#[test]
#[ignore = "it is the program that the next test runs"]
fn stalled_reader() {
    let bytes: u64 = std::env::var("STALLED_READER_BYTES").expect("it is set").parse().expect("a number");
    let mut camera = Camera::open(&Selector::default()).expect("it is there");
    camera.configure(&Configuration::calibration()).expect("it is there");
    let mut decoder = Decoder::new(camera.layout());
    let mut stream = camera.start(Streams::EVENTS, Queue::default()).expect("it starts");
    let end = Instant::now() + Duration::from_secs(60);
    let mut before = 0;
    // Until all bytes have arrived, or no more arrive because there is no room.
    while stream.statistics().bytes < bytes && Instant::now() < end && stream.statistics().starved == 0 {
        before = stream.statistics().bytes;
        sleep(Duration::from_millis(1));
    }
    assert_eq!((stream.statistics().bytes, stream.statistics().starved), (bytes, 0), "{before}");
    assert!(stream.statistics().waiting_most < 128 << 20);
    stream.stop().expect("it stops");
    let mut next = 0;
    let error = loop {
        match stream.next(Duration::from_secs(1)) {
            Ok(Some(transfer)) => decoder.decode(transfer.payload, |message| {
                let Message::Events(received) = message else { panic!("{message:?}") };
                for &received in received {
                    assert_eq!(received, event(next));
                    next += 1;
                }
            }),
            Ok(None) => {}
            Err(error) => break error,
        }
    };
    assert_eq!((error, decoder.counts().bytes), (StreamError::Stopped, bytes));
}

#[test]
fn three_seconds_of_a_busy_disk_lose_nothing() {
    for (bytes, length) in STALLS {
        // A row and a column for each event, a timestamp for every third.
        let count = bytes * 3 / 14 + 1;
        let source = move || events(count);
        let sent = total(source());
        assert!(sent >= bytes, "{sent}");
        let faults = Faults { cuts: vec![length], ..Faults::default() };
        let bus = EmulatedBus::start(Model::new("1", source).with_faults(faults)).expect("the bus starts");
        let output = Command::new(std::env::current_exe().expect("it has a path"))
            .args(["--ignored", "--exact", "--nocapture", "slow_reader::stalled_reader"])
            .env("STALLED_READER_BYTES", sent.to_string())
            .envs(bus.environment())
            .output()
            .expect("it runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}
