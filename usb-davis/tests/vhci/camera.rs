//! A camera on the bus, from plugging in to unplugging.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use usb_davis::configuration::{Configuration, QUIESCE, Streams};
use usb_davis::device::{Availability, Camera, Queue, Selector, StreamError, StreamStatistics};
use usb_davis::emulator::vhci::VirtualCamera;
use usb_davis::emulator::{Faults, Model};
use usb_davis::protocol::{Decoder, DecoderCounts, ImuModel, Message};
use usb_davis::registers::{Clocks, Dropped, Register, mux, sysinfo, usb};

use crate::session::{Received, session};
use crate::streams::{event, events, total};
use crate::{NOBODY, PATIENCE, listed};

fn plug_in(model: Model) -> VirtualCamera {
    let camera = VirtualCamera::plug_in(model).expect("root, and the module vhci-hcd");
    wait_for(&camera);
    camera
}

/// Waits until programs can open the camera.
fn wait_for(camera: &VirtualCamera) {
    let end = Instant::now() + PATIENCE;
    while camera.location().expect("a status").is_none() {
        assert!(Instant::now() < end, "the kernel does not configure the camera");
        sleep(Duration::from_millis(50));
    }
}

fn open() -> Camera {
    let mut camera = Camera::open(&Selector::default()).expect("it is there");
    camera.configure(&Configuration::calibration()).expect("it is there");
    camera
}

/// Starts the camera, and stops it after `limit` bytes.
fn receive(
    camera: &mut Camera,
    streams: Streams,
    limit: u64,
    mut sink: impl FnMut(Message<'_>),
) -> (StreamError, StreamStatistics, DecoderCounts) {
    let mut decoder = Decoder::with_frames(camera.layout(), vec![0; 346 * 260]);
    let mut stream = camera.start(streams, Queue::default()).expect("it starts");
    let end = Instant::now() + 10 * PATIENCE;
    let error = loop {
        match stream.next(Duration::from_millis(50)) {
            Ok(Some(transfer)) => decoder.decode(transfer.payload, &mut sink),
            Ok(None) => {}
            Err(error) => break error,
        }
        if stream.statistics().bytes >= limit || Instant::now() >= end {
            stream.stop().expect("it stops");
        }
    };
    // An emulated camera drops nothing at full pace.
    assert_eq!(stream.read_dropped().unwrap_or_default(), Dropped::default());
    (error, stream.statistics(), decoder.counts())
}

/// Receives events, which must equal those of `event` from the first.
fn receive_events(camera: &mut Camera, limit: u64) -> (StreamError, StreamStatistics, u64) {
    let mut next = 0;
    let (error, statistics, counts) = receive(camera, Streams::EVENTS, limit, |message| {
        let Message::Events(events) = message else { panic!("{message:?}") };
        for &received in events {
            assert_eq!(received, event(next));
            next += 1;
        }
    });
    assert_eq!(counts.anomalies.total(), 0);
    (error, statistics, next)
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn a_camera_is_listed_opened_and_configured() {
    let virtual_camera = plug_in(Model::new("00000042", || events(0)));
    let [listing] = listed(1).try_into().expect("one");
    assert_eq!((listing.identity.serial.as_str(), listing.identity.firmware()), ("00000042", 6));
    assert!(matches!(listing.availability, Availability::Ready { logic: 18, patch: 1 }), "{listing:?}");
    let location = virtual_camera.location().expect("a status").expect("it was enumerated");
    assert_eq!((location.bus, location.address), (listing.bus, listing.address));
    let before = virtual_camera.model(|model| model.log().len());
    let mut camera = open();
    assert_eq!(camera.registers().get(sysinfo::LOGIC_VERSION), Some(18));
    assert_eq!(camera.read(Register::new(5, 10)).expect("it answers"), 0x427F);
    receive(&mut camera, Streams::EVENTS, 0, |message| panic!("{message:?}"));
    let mut expected = Vec::new();
    Configuration::calibration()
        .writes(&Clocks::ASSUMED, ImuModel::Mpu9250, |register, value| expected.push((register, value)));
    expected.extend(QUIESCE);
    expected.extend([(mux::RUN_CHIP, 1), (usb::RUN, 1), (mux::TIMESTAMP_RUN, 1), (mux::RUN, 1)]);
    expected.extend(Streams::EVENTS.writes());
    expected.extend(QUIESCE);
    let log: Vec<(Register, u32)> = virtual_camera.model(|model| model.log()[before..].to_vec());
    assert_eq!(log, expected);
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn ten_million_events_and_none_is_lost_and_the_camera_can_be_opened_again() {
    const COUNT: u64 = 10_000_000;
    let bytes = total(events(COUNT));
    let _virtual_camera = plug_in(Model::new("1", || events(COUNT)));
    let start = Instant::now();
    let mut camera = open();
    let (error, statistics, count) = receive_events(&mut camera, bytes);
    assert_eq!((error, statistics.bytes, count), (StreamError::Stopped, bytes, COUNT));
    drop(camera);
    println!("{count} events, {bytes} bytes in {:.1} s of the machine", start.elapsed().as_secs_f64());
    // After a stop during the stream the received data are still correct; the next run starts from the beginning.
    for part in [bytes / 40, bytes / 30] {
        let (error, statistics, _) = receive_events(&mut open(), part);
        assert_eq!(error, StreamError::Stopped);
        assert!(statistics.bytes >= part && statistics.bytes < bytes);
    }
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn frames_inertial_samples_and_signals() {
    let bytes = total(session());
    let _virtual_camera = plug_in(Model::new("1", session));
    let mut received = Received::default();
    let (error, _, counts) = receive(&mut open(), Streams::ALL, bytes, |message| received.take(&message));
    assert_eq!((error, counts.anomalies.total()), (StreamError::Stopped, 0));
    received.check();
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn unplugged_in_mid_stream_everything_before_it_is_kept_and_it_can_be_plugged_in_again() {
    const COUNT: u64 = 500_000;
    let bytes = total(events(COUNT));
    let unplug_at = bytes / 2 + 1;
    let faults = Faults { unplug_at: Some(unplug_at), ..Faults::default() };
    let mut virtual_camera = plug_in(Model::new("1", || events(COUNT)).with_faults(faults));
    let first = listed(1);
    let mut camera = open();
    let (error, statistics, count) = receive_events(&mut camera, u64::MAX);
    assert_eq!((error, statistics.bytes), (StreamError::Unplugged, unplug_at));
    assert!(count.abs_diff(COUNT / 2) < COUNT / 100, "{count}");
    assert!(camera.read(sysinfo::LOGIC_VERSION).is_err());
    drop(camera);
    listed(0);
    assert!(!virtual_camera.is_plugged_in());
    virtual_camera.unplug().expect("it is unplugged already");
    virtual_camera.plug_in_again().expect("a free port");
    wait_for(&virtual_camera);
    let again = listed(1);
    assert!((again[0].bus, again[0].address) != (first[0].bus, first[0].address));
    let (error, _, count) = receive_events(&mut open(), bytes);
    assert_eq!((error, count), (StreamError::Stopped, COUNT));
    // Unplugged explicitly, while a program has it open.
    let mut camera = open();
    virtual_camera.unplug().expect("it is plugged in");
    listed(0);
    assert!(camera.read(sysinfo::LOGIC_VERSION).is_err());
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn odd_transfers_and_halts_lose_nothing() {
    const COUNT: u64 = 50_000;
    let bytes = total(events(COUNT));
    let stall_at = bytes / 3;
    let faults = Faults { cuts: vec![1, 513, 7, 4095, 3], stall_at: Some(stall_at), ..Faults::default() };
    let _virtual_camera = plug_in(Model::new("1", || events(COUNT)).with_faults(faults));
    let mut camera = open();
    let (error, statistics, _) = receive_events(&mut camera, u64::MAX);
    assert_eq!((error, statistics.bytes), (StreamError::Stalled, stall_at));
    let (error, statistics, count) = receive_events(&mut camera, bytes);
    assert_eq!((error, statistics.bytes, count), (StreamError::Stopped, bytes, COUNT));
}

/// Returns the state of the only camera according to `davis-record`, run by this user.
fn state(program: &Path, user: u32) -> String {
    let output = Command::new(program).uid(user).gid(user).stderr(Stdio::inherit()).output().expect("it runs");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn absent_forbidden_and_busy_cameras_cause_different_errors() {
    let program = std::env::var_os("DAVIS_RECORD").unwrap_or_else(|| env!("CARGO_BIN_EXE_davis-record").into());
    let program = Path::new(&program);
    assert_eq!(state(program, NOBODY).trim(), "[]");
    let virtual_camera = plug_in(Model::new("1", || events(0)));
    let location = virtual_camera.location().expect("a status").expect("it was enumerated");
    let node = format!("/dev/bus/usb/{:03}/{:03}", location.bus, location.address);
    let forbidden = state(program, NOBODY);
    assert!(forbidden.contains("may not be opened: put this line into"), "{forbidden}");
    fs::set_permissions(node, Permissions::from_mode(0o666)).expect("root may");
    let ready = state(program, NOBODY);
    assert!(ready.contains("ready, logic 18.1"), "{ready}");
    let _camera = open();
    for user in [0, NOBODY] {
        let busy = state(program, user);
        assert!(busy.contains("used by another program"), "{busy}");
    }
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn several_cameras_use_different_ports_on_several_controllers() {
    // Linux builds at most 15 ports into a controller, and Debian eight controllers.
    const COUNT: usize = 16;
    let serial = |index: usize| format!("{index:08}");
    let plug_in = |index| VirtualCamera::plug_in(Model::new(&serial(index), || events(0))).expect("a free port");
    let cameras: Vec<VirtualCamera> = (0..COUNT).map(plug_in).collect();
    let mut ports: Vec<u32> = cameras.iter().map(VirtualCamera::port).collect();
    ports.dedup();
    assert_eq!(ports.len(), COUNT);
    cameras.iter().for_each(wait_for);
    let mut serials: Vec<String> = listed(COUNT).into_iter().map(|listing| listing.identity.serial).collect();
    serials.sort();
    assert_eq!(serials, (0..COUNT).map(serial).collect::<Vec<_>>());
    let selector = Selector { serial: Some(serial(2)), ..Selector::default() };
    assert_eq!(Camera::open(&selector).expect("it is there").identity().serial, serial(2));
    drop(cameras);
    listed(0);
}
