//! `evcal emulate`. What needs root and the module `vhci-hcd` runs in a virtual machine: `make
//! test-usb-guest`.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::{BufRead, BufReader, Lines};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use event_recordings::text;
use event_recordings::write::EventWriter;
use tempfile::TempDir;
use usb_davis::configuration::Streams;
use usb_davis::device::{Camera, Queue, Selector, StreamError, list};
use usb_davis::dump::{Compression, DumpHeader, DumpWriter, Identity, Transfer, TransferStatus};
use usb_davis::emulator::default_registers;
use usb_davis::protocol::{Decoder, Message};
use usb_davis::registers::sysinfo;

const NOBODY: u32 = 65_534;
/// A virtual machine on a busy computer is slow.
const PATIENCE: Duration = Duration::from_secs(120);

fn program() -> PathBuf {
    std::env::var_os("EVCAL").map_or_else(|| env!("CARGO_BIN_EXE_evcal").into(), PathBuf::from)
}

/// Runs `evcal emulate` to its end, which must be a bad one: exit code and errors.
fn refused(command: &mut Command) -> (Option<i32>, String) {
    let output = command.output().expect("evcal runs");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn emulate(recording: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(program());
    command.arg("emulate").arg(recording).args(arguments);
    command
}

fn events(count: i64) -> Vec<Event> {
    let event = |index: i64| Event {
        t: 5_000_000 + index * 3,
        x: (index * 37 % 346) as u16,
        y: (index * 91 % 260) as u16,
        polarity: if index % 3 == 0 { Polarity::On } else { Polarity::Off },
    };
    (0..count).map(event).collect()
}

fn event_file(events: &[Event]) -> (TempDir, PathBuf) {
    let directory = tempfile::tempdir().expect("a directory can be made");
    let path = directory.path().join("events.csv");
    let mut writer = EventWriter::create(&path, text::OUTPUT, Sensor::new(346, 260), "").expect("it can be written");
    writer.write(events).expect("it can be written");
    writer.finish().expect("it can be written");
    (directory, path)
}

/// A running `evcal emulate`.
struct Emulation {
    process: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Emulation {
    fn start(recording: &Path, arguments: &[&str]) -> Self {
        let mut process = emulate(recording, arguments).stdout(Stdio::piped()).spawn().expect("evcal runs");
        let output = process.stdout.take().expect("it is piped");
        Self { process, lines: BufReader::new(output).lines() }
    }

    /// The next line that it prints must contain this.
    fn says(&mut self, part: &str) {
        let line = self.lines.next().expect("a line").expect("a text");
        assert!(line.contains(part), "{line}");
    }

    /// Ctrl-C.
    fn interrupt(mut self) {
        let id = self.process.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().expect("kill runs").success());
        self.says("unplugged");
        assert!(self.process.wait().expect("it is ours").success());
        wait_for(0);
    }
}

/// Waits until the bus has `count` cameras.
fn wait_for(count: usize) {
    let end = Instant::now() + PATIENCE;
    loop {
        let cameras = list().expect("libusb works");
        if cameras.len() == count {
            return;
        }
        assert!(Instant::now() < end, "{cameras:?}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Everything that the camera sends until it ends, or has sent `limit` bytes.
fn receive(camera: &mut Camera, limit: usize) -> (Vec<u8>, StreamError) {
    let mut stream = camera.start(Streams::ALL, Queue::default()).expect("it starts");
    let (mut received, end) = (Vec::new(), Instant::now() + PATIENCE);
    loop {
        match stream.next(Duration::from_millis(50)) {
            Ok(Some(transfer)) => received.extend_from_slice(transfer.payload),
            Ok(None) => {}
            Err(error) => return (received, error),
        }
        if received.len() >= limit || Instant::now() >= end {
            stream.stop().expect("it stops");
        }
    }
}

#[test]
fn what_is_missing_is_said() {
    let (_directory, path) = event_file(&events(10));
    let (code, errors) = refused(&mut emulate(&path.with_extension("none"), &[]));
    assert!(code == Some(1) && errors.contains("events.none"), "{errors}");
    for wrong in [&["--cuts", "7,0"][..], &["--plug-in-after", "1s"], &["--pace", "half"], &["--bad-word-every", "0"]] {
        assert_eq!(refused(&mut emulate(&path, wrong)).0, Some(2), "{wrong:?}");
    }
    // Where the module is loaded, the tests below say more.
    if !Path::new("/sys/devices/platform/vhci_hcd.0").exists() {
        let (code, errors) = refused(&mut emulate(&path, &[]));
        assert!(code == Some(1) && errors.contains("modprobe vhci-hcd"), "{errors}");
    }
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn only_root_may() {
    let (directory, path) = event_file(&events(10));
    for path in [directory.path(), &path] {
        fs::set_permissions(path, std::os::unix::fs::PermissionsExt::from_mode(0o755)).expect("it is ours");
    }
    let (code, errors) = refused(emulate(&path, &[]).uid(NOBODY).gid(NOBODY));
    assert!(code == Some(1) && errors.contains("only root") && errors.contains("sudo"), "{errors}");
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn transfers_arrive_as_they_were_recorded() {
    let directory = tempfile::tempdir().expect("a directory can be made");
    let path = directory.path().join("session.dvraw");
    let identity = Identity { vendor_id: 0x152A, product_id: 0x841A, device_version: 7, serial: "00000042".to_owned() };
    let mut registers = default_registers();
    registers.set(sysinfo::CLOCK_DEVIATION, 1007);
    let header = DumpHeader::new(Some(identity.clone()), registers);
    let mut dump = DumpWriter::new(Vec::new(), &header, Compression::None).expect("a vector");
    let payload: Vec<u8> = (0u32..500_001).map(|index| (index.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    for (milliseconds, payload) in (1u64..).zip(payload.chunks(99_999)) {
        let (status, host_ns) = (TransferStatus::Completed, Some(milliseconds * 1_000_000));
        dump.transfer(&Transfer { host_ns, gap_before: false, status, payload }).expect("a vector");
    }
    fs::write(&path, dump.finish().expect("a vector")).expect("it can be written");
    let mut emulation = Emulation::start(&path, &["--pace", "full"]);
    emulation.says("DAVIS346 00000042 is at bus");
    let mut camera = Camera::open(&Selector::default()).expect("it is there");
    assert_eq!(camera.identity(), &identity);
    assert_eq!(camera.read(sysinfo::CLOCK_DEVIATION).expect("it answers"), 1007);
    for _ in 0..2 {
        assert_eq!(receive(&mut camera, payload.len()), (payload.clone(), StreamError::Stopped));
    }
    drop(camera);
    emulation.interrupt();
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn events_of_a_file_arrive_and_a_camera_can_be_unplugged_and_plugged_in_again() {
    let events = events(100_000);
    let (_directory, path) = event_file(&events);
    let faults = ["--unplug-at", "100001", "--plug-in-after", "500ms", "--serial", "00000007", "--cuts", "8191,513"];
    let mut emulation = Emulation::start(&path, &[&["--pace", "full"], &faults[..]].concat());
    emulation.says("DAVIS346 00000007 is at bus");
    let mut camera = Camera::open(&Selector::default()).expect("it is there");
    let (received, error) = receive(&mut camera, usize::MAX);
    assert_eq!((received.len(), error), (100_001, StreamError::Unplugged));
    drop(camera);
    emulation.says("unplugged, 100001 bytes after the start");
    emulation.says("DAVIS346 00000007 is at bus");
    wait_for(1);
    let mut camera = Camera::open(&Selector::default()).expect("it is there again");
    let mut decoder = Decoder::new(camera.layout());
    let mut times = Vec::new();
    let mut stream = camera.start(Streams::EVENTS, Queue::default()).expect("it starts");
    let end = Instant::now() + PATIENCE;
    while times.len() < events.len() && Instant::now() < end {
        let Some(transfer) = stream.next(Duration::from_millis(50)).expect("it runs") else { continue };
        decoder.decode(transfer.payload, |message| {
            let Message::Events(events) = message else { panic!("{message:?}") };
            times.extend(events.iter().map(|event| (event.time as i64, event.x, event.y)));
        });
    }
    drop(stream);
    let expected: Vec<_> = events.iter().map(|event| (event.t - events[0].t, event.x, event.y)).collect();
    assert!(times == expected, "{} of {} events", times.len(), expected.len());
    drop(camera);
    emulation.interrupt();
}
