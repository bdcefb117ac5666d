//! Cameras that are plugged in, unplugged or not usable: absent, forbidden and busy cameras cause different errors.

use std::fs::{self, Permissions};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::streams::{event, events, total};
use rusb::{Context, Device, Hotplug, HotplugBuilder, UsbContext};
use serde_json::Value;
use tempfile::TempDir;
use usb_davis::capture::Capture;
use usb_davis::device::{UDEV_RULE, UDEV_RULE_FILE};
use usb_davis::emulator::umockdev::{Access, EmulatedBus};
use usb_davis::emulator::{Faults, Model};
use usb_davis::protocol::Message;
use usb_davis::registers::{Register, mux};

const NOBODY: u32 = 65_534;

/// Returns a directory with `davis-record` that everybody may run, which also receives its output.
fn program() -> TempDir {
    let directory = tempfile::tempdir().expect("a directory can be made");
    fs::set_permissions(directory.path(), Permissions::from_mode(0o777)).expect("it is ours");
    // Not `fs::copy`: another test that starts a program at the same time would pass the open file to it, and a file
    // that is open for writing cannot be run.
    let copy = Command::new("cp").arg(env!("CARGO_BIN_EXE_davis-record")).arg(directory.path()).status();
    assert!(copy.expect("cp runs").success());
    directory
}

/// Runs `davis-record` as a user without privileges; returns its output and its errors.
fn run(bus: &EmulatedBus, program: &Path, arguments: &[&str]) -> (String, String) {
    let mut command = Command::new(program.join("davis-record"));
    command.args(arguments).current_dir(program).envs(bus.environment());
    // Root may open everything.
    if fs::metadata(program).expect("it is there").uid() == 0 {
        command.uid(NOBODY).gid(NOBODY);
    }
    let output = command.output().expect("davis-record runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
    (text(&output.stdout), text(&output.stderr))
}

#[test]
fn absent_forbidden_and_busy_cameras_cause_different_errors() {
    let bus = EmulatedBus::start(Model::new("00000042", || events(0))).expect("the bus starts");
    let program = program();
    for (access, serial, reason) in [
        (Access::Free, "00000042", "ready, logic 18.1"),
        (Access::Forbidden, "", "may not be opened: put this line into /etc/udev/rules.d/65-inivation.rules"),
        (Access::Busy, "", "used by another program"),
    ] {
        bus.set_access(access).expect("it is ours");
        let (list, errors) = run(&bus, program.path(), &[]);
        let list: Value = serde_json::from_str(&list).expect(&errors);
        let [camera] = list.as_array().expect("a list").as_slice() else { panic!("{access:?}: {list}") };
        assert_eq!(camera["serial"], serial);
        let state = camera["state"].as_str().expect("a text");
        assert!(state.contains(reason), "{access:?}: {state}");
        if access != Access::Free {
            let (_, errors) = run(&bus, program.path(), &["none.dvraw", "1"]);
            assert!(errors.contains(reason), "{access:?}: {errors}");
        }
    }
    bus.unplug().expect("it is plugged in");
    assert_eq!(run(&bus, program.path(), &[]).0, "[]");
    let (_, errors) = run(&bus, program.path(), &["none.dvraw", "1"]);
    assert!(errors.contains("no camera found"), "{errors}");
    assert!(!program.path().join("none.dvraw").exists());
}

#[test]
fn a_camera_that_is_plugged_in_again_starts_from_its_initial_state() {
    const COUNT: u64 = 300_000;
    let bytes = total(events(COUNT));
    let faults = Faults { unplug_at: Some(bytes / 2), ..Faults::default() };
    let bus = EmulatedBus::start(Model::new("1", || events(COUNT)).with_faults(faults)).expect("the bus starts");
    let program = program();
    let limit = format!("bytes={bytes}");
    let (report, errors) = run(&bus, program.path(), &["first.dvraw", "60", &limit]);
    assert!(report.contains("the camera was unplugged"), "{report} {errors}");
    assert_eq!(bus.model(|model| model.registers().get(mux::RUN)), Some(1));
    bus.plug_in().expect("it is unplugged");
    assert_eq!(bus.model(|model| model.registers().get(mux::RUN)), None);
    assert_eq!(bus.model(|model| model.registers().get(Register::new(5, 10))), None);
    let (report, errors) = run(&bus, program.path(), &["second.dvraw", "60", &limit]);
    assert!(report.contains("the stream was stopped"), "{report} {errors}");
    let mut capture = Capture::open(program.path().join("second.dvraw")).expect("it is a dump");
    let mut decoder = capture.header().decoder();
    let mut next = 0;
    let mut check = |message: Message<'_>| {
        let Message::Events(received) = message else { panic!("{message:?}") };
        for &received in received {
            assert_eq!(received, event(next));
            next += 1;
        }
    };
    while capture.decode_next(&mut decoder, &mut check).expect("it can be read") {}
    assert_eq!(next, COUNT);
}

/// Prints cameras that are plugged in or unplugged.
struct Printer;

impl<T: UsbContext> Hotplug<T> for Printer {
    fn device_arrived(&mut self, device: Device<T>) {
        println!("\narrived {}.{}", device.bus_number(), device.address());
    }

    fn device_left(&mut self, device: Device<T>) {
        println!("\nleft {}.{}", device.bus_number(), device.address());
    }
}

#[test]
#[ignore = "it is the program that the next test runs"]
fn print_hotplug_notifications() {
    assert!(rusb::has_hotplug());
    let context = Context::new().expect("libusb starts");
    let registered = HotplugBuilder::new()
        .vendor_id(usb_davis::VENDOR_ID)
        .enumerate(true)
        .register(&context, Box::new(Printer))
        .expect("libusb takes it");
    let end = Instant::now() + Duration::from_secs(60);
    while Instant::now() < end {
        context.handle_events(Some(Duration::from_millis(100))).expect("libusb works");
    }
    context.unregister_callback(registered);
}

#[test]
fn programs_are_notified_of_cameras_plugged_in_and_unplugged() {
    let bus = EmulatedBus::start(Model::new("1", || events(0))).expect("the bus starts");
    let mut watcher = Command::new(std::env::current_exe().expect("it has a path"))
        .args(["--ignored", "--exact", "--nocapture", "plugging_and_access::print_hotplug_notifications"])
        .envs(bus.environment())
        .stdout(Stdio::piped())
        .spawn()
        .expect("it runs");
    let lines = BufReader::new(watcher.stdout.take().expect("it is piped")).lines().map_while(Result::ok);
    let mut events = lines.filter(|line| line.starts_with("arrived") || line.starts_with("left"));
    assert_eq!(events.next().as_deref(), Some("arrived 2.3"));
    for _ in 0..3 {
        bus.unplug().expect("it is plugged in");
        assert_eq!(events.next().as_deref(), Some("left 2.3"));
        bus.plug_in().expect("it is unplugged");
        assert_eq!(events.next().as_deref(), Some("arrived 2.3"));
    }
    watcher.kill().expect("it runs still");
    watcher.wait().expect("it was killed");
}

#[test]
fn the_documented_udev_rule_equals_the_rule_in_errors() {
    let page = include_str!("../../../docs/usb.md");
    assert!(page.contains(UDEV_RULE) && page.contains(UDEV_RULE_FILE));
}
