//! Tests of the program `davis-emulate`.

use std::fs::{self, Permissions};
use std::io::{BufRead, BufReader, Lines};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;
use usb_davis::configuration::Streams;
use usb_davis::device::{Camera, Queue, Selector, StreamError};
use usb_davis::dump::{Compression, DumpHeader, DumpWriter, Identity, Transfer, TransferStatus};
use usb_davis::protocol::{Decoder, Message};
use usb_davis::registers::{default_registers, sysinfo};

use crate::streams::{event, events, total};
use crate::{NOBODY, PATIENCE, listed};

fn emulate(recording: &Path, arguments: &[&str]) -> Command {
    let program = std::env::var_os("DAVIS_EMULATE").unwrap_or_else(|| env!("CARGO_BIN_EXE_davis-emulate").into());
    let mut command = Command::new(program);
    command.arg(recording).args(arguments);
    command
}

/// Runs `davis-emulate` to its end, which must be a failure; returns exit code and errors.
fn refused(command: &mut Command) -> (Option<i32>, String) {
    let output = command.output().expect("davis-emulate runs");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Returns a file of bare payload.
fn event_file(count: u64) -> (TempDir, PathBuf) {
    let directory = tempfile::tempdir().expect("a directory can be made");
    let path = directory.path().join("events.bin");
    let payload: Vec<u8> = events(count).flat_map(|piece| piece.bytes).collect();
    fs::write(&path, payload).expect("it can be written");
    (directory, path)
}

/// A running `davis-emulate`.
struct Emulation {
    process: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Emulation {
    fn start(recording: &Path, arguments: &[&str]) -> Self {
        let mut process = emulate(recording, arguments).stdout(Stdio::piped()).spawn().expect("davis-emulate runs");
        let output = process.stdout.take().expect("it is piped");
        Self { process, lines: BufReader::new(output).lines() }
    }

    /// Asserts that the next printed line contains `part`.
    fn prints(&mut self, part: &str) {
        let line = self.lines.next().expect("a line").expect("a text");
        assert!(line.contains(part), "{line}");
    }

    /// Sends Ctrl-C, which unplugs the camera.
    fn interrupt(mut self) {
        let id = self.process.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().expect("kill runs").success());
        self.process.wait().expect("it is ours");
        listed(0);
    }
}

/// Returns everything that the camera sends until the stream ends or has sent `limit` bytes.
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
fn missing_arguments_are_reported() {
    let (_directory, path) = event_file(10);
    let (code, errors) = refused(&mut emulate(&path.with_extension("none"), &[]));
    assert!(code == Some(1) && errors.contains("events.none"), "{errors}");
    for wrong in [
        &["cuts=7,0"][..],
        &["plug-in-after=1"],
        &["unplug-at=1", "plug-in-after=-1"],
        &["half"],
        &["device=2"],
        &["bad-word-every=0"],
    ] {
        let (code, errors) = refused(&mut emulate(&path, wrong));
        let name = wrong[wrong.len() - 1].split('=').next().expect("a name");
        assert!(code == Some(2) && errors.contains(name), "{wrong:?}: {errors}");
    }
    // If the module is loaded, the tests below check more.
    if !Path::new("/sys/devices/platform/vhci_hcd.0").exists() {
        let (code, errors) = refused(&mut emulate(&path, &[]));
        assert!(code == Some(1) && errors.contains("modprobe vhci-hcd"), "{errors}");
    }
}

#[test]
#[ignore = "needs root and the module vhci-hcd: make test-usb-guest"]
fn only_root_may_emulate_a_camera() {
    let (directory, path) = event_file(10);
    for path in [directory.path(), &path] {
        fs::set_permissions(path, Permissions::from_mode(0o755)).expect("it is ours");
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
    let mut dump = DumpWriter::new(Vec::new(), &header, Compression::Zstd(1)).expect("a vector");
    // Includes words that no camera sends.
    let payload: Vec<u8> = (0u32..500_001).map(|index| (index.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    for (milliseconds, payload) in (1u64..).zip(payload.chunks(99_999)) {
        let (status, host_ns) = (TransferStatus::Completed, Some(milliseconds * 1_000_000));
        dump.transfer(&Transfer { host_ns, gap_before: false, status, payload }).expect("a vector");
    }
    fs::write(&path, dump.finish().expect("a vector")).expect("it can be written");
    let mut emulation = Emulation::start(&path, &["full"]);
    emulation.prints("DAVIS346 00000042 is at bus");
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
fn a_camera_can_be_unplugged_and_plugged_in_again() {
    const COUNT: u64 = 100_000;
    let bytes = total(events(COUNT));
    let (_directory, path) = event_file(COUNT);
    let options = ["full", "unplug-at=100001", "plug-in-after=0.5", "serial=00000007", "cuts=8191,513"];
    let mut emulation = Emulation::start(&path, &options);
    emulation.prints("DAVIS346 00000007 is at bus");
    let mut camera = Camera::open(&Selector::default()).expect("it is there");
    let (received, error) = receive(&mut camera, usize::MAX);
    assert_eq!((received.len(), error), (100_001, StreamError::Unplugged));
    drop(camera);
    emulation.prints("unplugged, 100001 bytes after the start");
    emulation.prints("DAVIS346 00000007 is at bus");
    listed(1);
    let mut camera = Camera::open(&Selector::default()).expect("it is there again");
    let mut decoder = Decoder::new(camera.layout());
    let (received, error) = receive(&mut camera, bytes as usize);
    assert_eq!((received.len() as u64, error), (bytes, StreamError::Stopped));
    let mut next = 0;
    decoder.decode(&received, |message| {
        let Message::Events(received) = message else { panic!("{message:?}") };
        for &received in received {
            assert_eq!(received, event(next));
            next += 1;
        }
    });
    assert_eq!(next, COUNT);
    drop(camera);
    emulation.interrupt();
}
