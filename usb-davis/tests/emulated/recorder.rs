//! `davis-record`, end to end.

use std::path::Path;
use std::process::{Command, Output};

use crate::session::{Received, session};
use crate::streams::{event, events, total};
use serde_json::Value;
use usb_davis::capture::Capture;
use usb_davis::configuration::{Configuration, QUIESCE, Streams};
use usb_davis::dump::Identity;
use usb_davis::emulator::umockdev::EmulatedBus;
use usb_davis::emulator::{Failures, Faults, Model, Pace};
use usb_davis::protocol::{AnomalyKind, DecoderCounts, ImuModel, Message};
use usb_davis::registers::{Clocks, Dropped, Register, dvs, mux, sysinfo, usb};

fn run(bus: &EmulatedBus, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_davis-record"))
        .args(arguments)
        .envs(bus.environment())
        .output()
        .expect("davis-record runs")
}

/// Runs `davis-record FILE 60 arguments…`; returns its report and `true` if it succeeded.
fn record(bus: &EmulatedBus, file: &Path, arguments: &[&str]) -> (Value, bool) {
    let path = file.to_str().expect("UTF-8");
    let output = run(bus, &[&[path, "60"], arguments].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    let report = serde_json::from_slice(&output.stdout);
    let report = report.unwrap_or_else(|_| panic!("{errors} (is the package umockdev installed?)"));
    (report, output.status.success())
}

fn refused(model: Model) -> String {
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let path = directory.path().join("none.dvraw");
    let output = run(&bus, &[path.to_str().expect("UTF-8")]);
    assert!(!output.status.success() && !path.exists());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Decodes a dump: calls `sink` for each message, returns the decoder's counts.
fn decode(file: &Path, mut sink: impl FnMut(Message<'_>)) -> DecoderCounts {
    let mut capture = Capture::open(file).expect("it is a dump");
    let mut decoder = capture.header().decoder();
    while capture.decode_next(&mut decoder, &mut sink).expect("it can be read") {}
    assert_eq!(capture.damage(), Default::default());
    decoder.counts()
}

/// Decodes a dump whose events must equal those of `event`, in order, and returns their number.
fn check_events(file: &Path) -> u64 {
    let mut next = 0;
    let counts = decode(file, |message| match message {
        Message::Events(events) => {
            for &received in events {
                assert_eq!(received, event(next));
                next += 1;
            }
        }
        other => panic!("{other:?}"),
    });
    assert_eq!(counts.anomalies.total(), 0);
    next
}

#[test]
fn a_camera_is_listed() {
    let bus = EmulatedBus::start(Model::new("00000042", || events(0))).expect("the bus starts");
    let output = run(&bus, &[]);
    let listing: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let expected = serde_json::json!([
        { "bus": 2, "address": 3, "serial": "00000042", "firmware": 6, "state": "ready, logic 18.1" }
    ]);
    assert_eq!(listing, expected, "is the package umockdev installed? {}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn unusable_cameras_are_rejected_with_a_reason() {
    let none = || Model::new("1", || events(0));
    let logic = |version| none().with_registers([(sysinfo::LOGIC_VERSION, version)]);
    for version in [17, 19] {
        assert!(refused(logic(version)).contains(&format!("logic version {version} is not 18")));
    }
    assert!(refused(none().with_registers([(sysinfo::LOGIC_PATCH, 0)])).contains("patch level 0 is too old"));
    assert!(refused(none().with_registers([(sysinfo::CHIP_ID, 6)])).contains("chip is number 6"));
    let old = Identity { vendor_id: 0x152A, product_id: 0x841A, device_version: 5, serial: String::new() };
    assert!(refused(none().with_identity(old)).contains("firmware 5 is too old"));
    let other = Identity { vendor_id: 0x152A, product_id: 0x8419, device_version: 6, serial: String::new() };
    assert!(refused(none().with_identity(other)).contains("no camera found"));
}

#[test]
fn register_traffic_equals_that_of_libcaer_and_all_events_arrive_in_repeated_runs() {
    const COUNT: u64 = 200_000;
    let bytes = total(events(COUNT));
    let bus = EmulatedBus::start(Model::new("00000042", || events(COUNT))).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    for run in 0..2 {
        let before = bus.model(|model| model.log().len());
        let (report, success) = record(&bus, &file, &[&format!("bytes={bytes}")]);
        assert!(success, "{report}");
        assert_eq!(report["bytes"], bytes, "run {run}");
        assert_eq!(check_events(&file), COUNT);
        let mut expected = Vec::new();
        Configuration::calibration()
            .writes(&Clocks::ASSUMED, ImuModel::Mpu9250, |register, value| expected.push((register, value)));
        expected.extend(QUIESCE);
        expected.extend([(mux::RUN_CHIP, 1), (usb::RUN, 1), (mux::TIMESTAMP_RUN, 1), (mux::RUN, 1)]);
        expected.extend(Streams::EVENTS.writes());
        expected.extend(QUIESCE);
        let log: Vec<(Register, u32)> = bus.model(|model| model.log()[before..].to_vec());
        assert_eq!(log, expected);
    }
    let capture = Capture::open(&file).expect("it is a dump");
    assert_eq!(capture.header().camera_name(), "DAVIS346_00000042");
    assert_eq!(capture.header().registers.get(sysinfo::LOGIC_VERSION), Some(18));
    assert_eq!(capture.header().registers.get(Register::new(5, 10)), Some(0x427F));
}

#[test]
fn ten_million_events_and_none_is_lost() {
    const COUNT: u64 = 10_000_000;
    let bytes = total(events(COUNT));
    let bus = EmulatedBus::start(Model::new("1", || events(COUNT))).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[&format!("bytes={bytes}")]);
    assert!(success, "{report}");
    assert_eq!((report["bytes"].as_u64(), report["dropped"].as_u64()), (Some(bytes), Some(0)));
    assert_eq!(check_events(&file), COUNT);
}

#[test]
fn frames_inertial_samples_and_signals() {
    let bytes = total(session());
    let bus = EmulatedBus::start(Model::new("1", session)).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("frames.dvraw");
    let (report, success) = record(&bus, &file, &["frames", &format!("bytes={bytes}")]);
    assert!(success, "{report}");
    let mut received = Received::default();
    let counts = decode(&file, |message| received.take(&message));
    received.check();
    assert_eq!(counts.anomalies.total(), 0);
}

#[test]
fn unplugged_in_mid_stream_everything_before_it_is_kept() {
    const COUNT: u64 = 1_000_000;
    let unplug_at = total(events(COUNT)) / 2 + 1;
    let faults = Faults { unplug_at: Some(unplug_at), ..Faults::default() };
    let model = Model::new("1", || events(COUNT)).with_faults(faults);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[]);
    assert!(!success);
    assert_eq!(report["end"], "the camera was unplugged");
    assert_eq!(report["bytes"], unplug_at);
    let events = check_events(&file);
    assert!(events.abs_diff(COUNT / 2) < COUNT / 100, "{events}");
    let listing = run(&bus, &[]);
    assert_eq!(String::from_utf8_lossy(&listing.stdout).trim(), "[]");
}

#[test]
fn odd_transfers_lose_nothing() {
    const COUNT: u64 = 20_000;
    let bytes = total(events(COUNT));
    let faults = Faults { cuts: vec![1, 513, 7, 4095, 3], ..Faults::default() };
    let model = Model::new("1", || events(COUNT)).with_faults(faults);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[&format!("bytes={bytes}")]);
    assert!(success, "{report}");
    assert_eq!(check_events(&file), COUNT);
}

#[test]
fn bad_words_are_counted_and_lose_only_the_words_they_replace() {
    const COUNT: u64 = 200_000;
    let bytes = total(events(COUNT));
    let every = 10_001;
    let faults = Faults { bad_word_every: Some(every), ..Faults::default() };
    let model = Model::new("1", || events(COUNT)).with_faults(faults);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[&format!("bytes={bytes}")]);
    assert!(success, "{report}");
    let bad = bytes / 2 / every;
    let counts = decode(&file, |_| {});
    assert!(counts.anomalies.total() >= bad && counts.events < COUNT && COUNT - counts.events <= 2 * bad, "{counts:?}");
}

#[test]
fn a_halted_endpoint_ends_the_stream_and_the_next_start_clears_it() {
    const COUNT: u64 = 200_000;
    let bytes = total(events(COUNT));
    let stall_at = bytes / 3 * 2;
    let faults = Faults { stall_at: Some(stall_at), ..Faults::default() };
    let model = Model::new("1", || events(COUNT)).with_faults(faults);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[]);
    assert!(!success);
    assert_eq!(report["bytes"], stall_at);
    assert!(report["end"].as_str().is_some_and(|end| end.contains("halted")), "{report}");
    check_events(&file);
    let (report, success) = record(&bus, &file, &[&format!("bytes={bytes}")]);
    assert!(success, "{report}");
    assert_eq!(check_events(&file), COUNT);
}

/// Decodes a dump in which some events are lost but no wrap word; returns the number of events and of gaps. At full
/// pace the host clock is independent of the camera's clock.
fn check_events_with_gaps(file: &Path, count: u64) -> (u64, u64) {
    let mut capture = Capture::open(file).expect("it is a dump");
    let mut decoder = capture.header().decoder();
    let mut next = 0;
    let mut check = |message: Message<'_>| {
        let Message::Events(events) = message else { return };
        for &received in events {
            next = 1 + (next..count).find(|&index| event(index) == received).expect("an event that was sent, in order");
        }
    };
    while let Some(transfer) = capture.next_transfer().expect("it can be read") {
        if transfer.gap_before {
            decoder.gap(&mut check);
        }
        decoder.decode(transfer.payload, &mut check);
    }
    let counts = decoder.counts();
    let gaps = counts.anomalies.of(AnomalyKind::Gap);
    assert_eq!(counts.anomalies.total(), gaps);
    (counts.events, gaps)
}

#[test]
fn failed_transfers_are_a_gap_and_the_recording_continues() {
    const COUNT: u64 = 200_000;
    let bytes = total(events(COUNT));
    let faults =
        Faults { cuts: vec![4096], failures: Some(Failures { at: 81_920, transfers: 3 }), ..Faults::default() };
    let model = Model::new("1", || events(COUNT)).with_faults(faults);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[&format!("bytes={}", bytes - 3 * 4096)]);
    assert!(success, "{report}");
    assert_eq!((report["bytes"].as_u64(), report["failed"].as_u64()), (Some(bytes - 3 * 4096), Some(3)));
    let (events, gaps) = check_events_with_gaps(&file, COUNT);
    assert_eq!(gaps, 1);
    // The lost bytes are at most a third of the bytes of an event.
    assert!((500..=3 * 4096 / 2 + 100).contains(&(COUNT - events)), "{events}");
}

#[test]
fn persistent_bus_failures_end_the_recording_and_keep_earlier_data() {
    const COUNT: u64 = 400_000;
    let faults =
        Faults { cuts: vec![4096], failures: Some(Failures { at: 409_600, transfers: 200 }), ..Faults::default() };
    let model = Model::new("1", || events(COUNT)).with_faults(faults);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[]);
    assert!(!success);
    assert!(report["end"].as_str().is_some_and(|end| end.contains("too many transfers in a row failed")), "{report}");
    assert_eq!(report["bytes"], 409_600);
    assert!(check_events(&file) > 50_000);
}

#[test]
fn an_endpoint_that_halts_during_the_start_is_cleared_and_the_start_repeated() {
    const COUNT: u64 = 20_000;
    let bytes = total(events(COUNT));
    let faults = Faults { stall_at: Some(0), ..Faults::default() };
    let model = Model::new("1", || events(COUNT)).with_faults(faults);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[&format!("bytes={bytes}")]);
    assert!(success, "{report}");
    assert_eq!(check_events(&file), COUNT);
}

#[test]
fn a_start_that_fails_leaves_no_file() {
    let failures = Some(Failures { at: 0, transfers: 1 });
    let faults = Faults { failures, ..Faults::default() };
    assert!(refused(Model::new("1", || events(10)).with_faults(faults)).contains("while emptying the camera"));
}

#[test]
fn bytes_of_an_earlier_run_are_not_taken_for_the_beginning() {
    const COUNT: u64 = 20_000;
    let bytes = total(events(COUNT));
    // Half a word, then an event at pixel (5, 6): the rest would be out of step.
    let stale = [vec![0x77], [0x09, 0x80, 0x05, 0x10, 0x06, 0x20].repeat(5000)].concat();
    let model = Model::new("1", || events(COUNT)).with_faults(Faults { stale, ..Faults::default() });
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    for _ in 0..2 {
        let (report, success) = record(&bus, &file, &[&format!("bytes={bytes}")]);
        assert!(success, "{report}");
        assert_eq!(check_events(&file), COUNT);
    }
}

#[test]
fn modules_that_are_switched_off_send_nothing() {
    // Everything except the frames: three times 3 · (2 · 260 + 4) events, a sample, a signal.
    let bus = EmulatedBus::start(Model::new("1", session)).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &["bytes=5000"]);
    assert!(success, "{report}");
    let counts = decode(&file, |message| assert!(!matches!(message, Message::Frame(_))));
    assert_eq!((counts.events, counts.imu_samples, counts.signals), (3 * (2 * 260 + 4), 1, 1));
    assert_eq!((counts.frames, counts.skipped, counts.anomalies.total()), (0, 0, 0));
}

#[test]
fn losses_of_an_earlier_recording_are_not_reported() {
    const COUNT: u64 = 20_000;
    let bytes = total(events(COUNT));
    let earlier = [(mux::DVS_DROPPED, 1), (mux::DVS_DROPPED.next(), 5), (dvs::DROPPED.next(), 6)];
    let model = Model::new("1", || events(COUNT)).with_registers(earlier);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let (report, success) = record(&bus, &file, &[&format!("bytes={bytes}")]);
    assert!(success, "{report}");
    assert_eq!(report["dropped"], 0);
    let mut capture = Capture::open(&file).expect("it is a dump");
    assert_eq!(capture.header().registers.counter(mux::DVS_DROPPED), Some((1 << 32) + 5));
    while capture.next_transfer().expect("it can be read").is_some() {}
    assert_eq!(Dropped::between(&capture.header().registers, capture.registers()), Dropped::default());
}

#[test]
fn at_real_pace_the_queue_keeps_the_camera_from_dropping() {
    // 0.3 s at 3 million events/s, some 16 MB/s: without a queue the FIFO of 64 KiB lasts 4 ms.
    const COUNT: u64 = 1_000_000;
    let bytes = total(events(COUNT));
    let earlier = 1000;
    let model = Model::new("1", || events(COUNT)).with_pace(Pace::Real);
    let model = model.with_registers([(mux::DVS_DROPPED, 0), (mux::DVS_DROPPED.next(), earlier)]);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let file = directory.path().join("events.dvraw");
    let path = file.to_str().expect("UTF-8");
    let output = run(&bus, &[path, "5", &format!("bytes={bytes}")]);
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let dropped = report["dropped"].as_u64().expect("a number");
    let counted = bus.model(|model| model.registers().counter(mux::DVS_DROPPED)).expect("it was set");
    assert_eq!(dropped, counted - u64::from(earlier));
    let received = report["bytes"].as_u64().expect("a number");
    assert!(if dropped == 0 { received == bytes } else { received < bytes }, "{report}");
}
