//! `evcal devices`, `record` and `live`, as a user runs them, on an emulated camera on umockdev's
//! preload library (Debian package `umockdev`).
#![cfg(target_os = "linux")]

use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Output};

use event_recordings::{Recording, RecordingOptions};
use usb_davis::capture::Capture;
use usb_davis::emulator::umockdev::{Access, EmulatedBus};
use usb_davis::emulator::{Failures, Faults, Model, Pace};
use usb_davis::registers::mux;

use crate::emulated::{
    BOARD, board_recording, camera, command, count, easy_settings, events, json, start, text, total, wait_for,
};

const NOBODY: u32 = 65_534;
fn run(bus: &EmulatedBus, arguments: &[&str]) -> (Option<i32>, String, String) {
    ended(command(bus, arguments).output().unwrap())
}

fn ended(output: Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

fn interrupt(child: Child) -> (Option<i32>, String, String) {
    let status = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(status.success());
    ended(child.wait_with_output().unwrap())
}

#[test]
fn cameras_are_listed_with_their_state() {
    let bus = EmulatedBus::start(camera(3000)).unwrap();
    let (code, listing, errors) = run(&bus, &["devices"]);
    assert_eq!(code, Some(0), "{errors}");
    let expected = "DAVIS346, serial number 00000042, bus 2, address 3, firmware 6, logic 18.1, ready";
    assert_eq!(listing.trim(), expected);
    let (_, listing, _) = run(&bus, &["devices", "--json"]);
    let listing = json(&listing);
    assert_eq!((&listing[0]["state"], &listing[0]["serial"]), (&"ready".into(), &"00000042".into()));

    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("busy.dvraw");
    let recorder = start(&bus, &["record", text(&file)]);
    wait_for("the recording", || bus.model(|model| model.sent()) >= total(3000));
    let (code, listing, errors) = run(&bus, &["devices"]);
    assert_eq!(code, Some(1));
    assert!(listing.contains("busy") && errors.contains("used by another program; end that first"), "{errors}");
    let (code, listing, _) = run(&bus, &["devices", "--json"]);
    assert_eq!((code, json(&listing)[0]["state"].as_str()), (Some(1), Some("busy")));
    assert_eq!(interrupt(recorder).0, Some(0));
}

#[test]
fn a_forbidden_camera_is_listed_with_the_required_udev_rule() {
    let bus = EmulatedBus::start(camera(0)).unwrap();
    bus.set_access(Access::Forbidden).unwrap();
    let directory = tempfile::tempdir().unwrap();
    fs::set_permissions(directory.path(), Permissions::from_mode(0o755)).unwrap();
    let program = directory.path().join("evcal");
    // Not `fs::copy`: another test that starts a program at this moment would pass it the file open for writing.
    let copy = Command::new("cp").arg(env!("CARGO_BIN_EXE_evcal")).arg(&program).status().unwrap();
    assert!(copy.success());
    let mut command = Command::new(&program);
    command.arg("devices").envs(bus.environment());
    // Root can open every file.
    if fs::metadata(directory.path()).unwrap().uid() == 0 {
        command.uid(NOBODY).gid(NOBODY);
    }
    let (code, listing, errors) = ended(command.output().unwrap());
    assert_eq!(code, Some(1), "{listing} {errors}");
    assert!(listing.contains("forbidden"), "{listing}");
    assert!(errors.contains("/etc/udev/rules.d/") && errors.contains(r#"ATTR{idVendor}=="152a""#), "{errors}");
}

#[test]
fn commands_without_a_camera_fail_with_advice() {
    let bus = EmulatedBus::start(camera(3000)).unwrap();
    bus.unplug().unwrap();
    let directory = tempfile::tempdir().unwrap();
    assert_eq!(run(&bus, &["devices", "--json"]).1.trim(), "[]");
    let output = directory.path().join("output");
    let recording = directory.path().join("none.dvraw");
    for arguments in [
        ["devices"].as_slice(),
        &["record", text(&recording)],
        &["live", "--board", BOARD, "-o", text(&output)],
        &["record", text(&recording), "--serial", "00000007"],
    ] {
        let (code, _, errors) = run(&bus, arguments);
        assert_eq!(code, Some(1), "{arguments:?}");
        assert!(errors.contains("no camera found") && errors.contains("is it plugged in?"), "{errors}");
        let is_full = ["lsusb", "/etc/udev/rules.d/", "DAVIS346"].iter().all(|part| errors.contains(part));
        assert_eq!(is_full, arguments == ["devices"], "{errors}");
    }
    assert!(!recording.exists() && !output.exists());
}

/// Of two cameras, `--serial` takes the one with that number, whichever comes first on the bus.
#[test]
fn a_camera_is_chosen_by_its_serial_number() {
    let bus = EmulatedBus::start(camera(3000)).unwrap();
    let _second = bus.plug_in_another(Model::new("00000043", || events(6000))).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let listing = json(&run(&bus, &["devices", "--json"]).1);
    let mut serials: Vec<&str> =
        listing.as_array().unwrap().iter().map(|camera| camera["serial"].as_str().unwrap()).collect();
    // The system lists them in the order of their connection.
    serials.sort_unstable();
    assert_eq!(serials, ["00000042", "00000043"]);
    for (serial, events) in [("00000042", 3000), ("00000043", 6000)] {
        let path = directory.path().join(format!("{serial}.dvraw"));
        let (code, _, errors) = run(&bus, &["record", text(&path), "--serial", serial, "--duration", "1s"]);
        assert_eq!(code, Some(0), "{errors}");
        assert_eq!(count(&path), events, "{serial}");
    }
}

#[test]
fn a_recording_ends_after_its_duration_or_at_ctrl_c_without_loss() {
    const COUNT: u64 = 200_000;
    let bus = EmulatedBus::start(camera(COUNT)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("interrupted.dvraw");
    let recorder = start(&bus, &["record", text(&file)]);
    wait_for("the stream", || bus.model(|model| model.sent()) >= total(COUNT));
    let (code, printed, errors) = interrupt(recorder);
    assert_eq!((code, errors.as_str()), (Some(0), ""), "{printed}");
    assert!(printed.contains("200000 events") && printed.contains("(stopped)"), "{printed}");
    assert_eq!(count(&file), COUNT);
    assert_eq!(Capture::open(&file).unwrap().header().camera_name(), "DAVIS346_00000042");

    let timed = directory.path().join("timed.dvraw");
    let (code, printed, errors) = run(&bus, &["record", text(&timed), "--duration", "3s", "--json"]);
    assert_eq!(code, Some(0), "{errors}");
    let report = json(&printed);
    assert_eq!((&report["ending"], &report["dropped"]), (&"the time is over".into(), &0.into()));
    assert_eq!(report["events"].as_u64(), Some(count(&timed)));

    let before = fs::read(&timed).unwrap();
    let (code, _, errors) = run(&bus, &["record", text(&timed), "--duration", "1s"]);
    assert_eq!(code, Some(1));
    assert!(errors.contains("choose another name"), "{errors}");
    assert_eq!(fs::read(&timed).unwrap(), before);
}

#[test]
fn unplugged_in_mid_stream_everything_before_it_is_kept() {
    const COUNT: u64 = 200_000;
    for (faults, reason) in [
        (Faults { unplug_at: Some(total(COUNT) / 2), ..Faults::default() }, "unplugged"),
        (Faults { stall_at: Some(total(COUNT) / 2), ..Faults::default() }, "halted"),
    ] {
        let bus = EmulatedBus::start(camera(COUNT).with_faults(faults)).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("half.dvraw");
        let (code, printed, errors) = run(&bus, &["record", text(&file)]);
        assert_eq!(code, Some(1), "{printed}");
        assert!(errors.contains(reason) && errors.contains("the part before is in"), "{errors}");
        assert!(count(&file).abs_diff(COUNT / 2) < COUNT / 100);
    }
}

#[test]
fn a_recording_is_not_given_the_ending_of_another_format() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("session.csv");
    let output = Command::new(env!("CARGO_BIN_EXE_evcal")).args(["record", text(&file)]).output().unwrap();
    let (code, _, errors) = ended(output);
    assert_eq!((code, file.exists()), (Some(2), false));
    assert!(errors.contains("session.dvraw") && errors.contains("evcal convert"), "{errors}");
}

#[test]
fn a_start_that_failed_can_be_tried_again_with_the_same_name() {
    let failures = Some(Failures { at: 0, transfers: 1 });
    let bus = EmulatedBus::start(camera(3000).with_faults(Faults { failures, ..Faults::default() })).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("again.dvraw");
    let (code, _, errors) = run(&bus, &["record", text(&file), "--duration", "1s"]);
    assert_eq!((code, file.exists()), (Some(1), false), "{errors}");
    let (code, _, errors) = run(&bus, &["record", text(&file), "--duration", "1s"]);
    assert_eq!(code, Some(0), "{errors}");
    assert_eq!(count(&file), 3000);
}

#[test]
fn a_full_disk_ends_the_recording_with_a_report_of_the_file() {
    let bus = EmulatedBus::start(camera(1_000_000)).unwrap();
    // XFSZ ignored, or with its default action.
    for trap in ["", "-"] {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("full.dvraw");
        // A limit of the file size acts like a full disk: one write is cut short, the next fails.
        let output = Command::new("bash")
            .args(["-c", r#"ulimit -f 1000; trap "$0" XFSZ; exec "$@""#, trap, env!("CARGO_BIN_EXE_evcal")])
            .args(["record", text(&file), "--json"])
            .envs(bus.environment())
            .output()
            .unwrap();
        let (code, printed, errors) = ended(output);
        assert_eq!(code, Some(1), "{printed}");
        assert!(
            errors.contains("could not be written any more") && errors.contains("make room on the disk"),
            "{errors}"
        );
        let (report, events) = (json(&printed), count(&file));
        assert!(events > 100_000, "{events}");
        assert_eq!(report["events"].as_u64(), Some(events));
        assert!(errors.contains(&format!("{events} events")), "{errors}");
        assert_eq!(report["file_bytes"].as_u64(), Some(fs::metadata(&file).unwrap().len()));
        let mut capture = Capture::open(&file).unwrap();
        let mut bytes = 0;
        while let Some(transfer) = capture.next_transfer().unwrap() {
            bytes += transfer.payload.len() as u64;
        }
        assert_eq!((report["bytes"].as_u64(), capture.damage()), (Some(bytes), Default::default()));
    }
}

#[test]
fn losses_of_an_earlier_recording_are_not_reported_again() {
    let earlier = [(mux::DVS_DROPPED, 0), (mux::DVS_DROPPED.next(), 77)];
    let bus = EmulatedBus::start(camera(3000).with_registers(earlier)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("second.dvraw");
    let (code, printed, errors) = run(&bus, &["record", text(&file), "--duration", "1s", "--json"]);
    assert_eq!((code, json(&printed)["dropped"].as_u64()), (Some(0), Some(0)), "{errors}");
    let recording = Recording::new(&file, RecordingOptions::default()).unwrap();
    let mut reader = recording.open().unwrap();
    let mut batch = Vec::new();
    while reader.next_batch(&mut batch).unwrap() {}
    assert_eq!(reader.report().stream.dropped, 0);
}

/// All result files with their content, except the report and the parts of calibration.json that depend on the command line.
fn results(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            files.extend(results(&path));
        } else if name == "calibration.json" {
            let mut calibration: serde_json::Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
            for key in ["command", "input_files"] {
                calibration.as_object_mut().unwrap().remove(key);
            }
            files.push((name, calibration.to_string().into_bytes()));
        } else if name != "report.html" && !name.ends_with(".dvraw") {
            files.push((name, fs::read(path).unwrap()));
        }
    }
    files.sort();
    files
}

#[test]
fn live_stops_at_its_target_and_calibrates_as_from_the_recording() {
    let directory = tempfile::tempdir().unwrap();
    let pieces = board_recording(directory.path(), "7");
    let sent: u64 = pieces.iter().map(|piece| piece.bytes.len() as u64).sum();
    let unplug = Faults { unplug_at: Some(sent - 1000), ..Faults::default() };
    // At full speed nothing is dropped, so the byte at which the camera disconnects is reached.
    for (name, faults, pace) in [("enough", Faults::default(), Pace::Real), ("unplugged", unplug, Pace::Full)] {
        let pieces = pieces.clone();
        let model = Model::new("00000042", move || pieces.clone().into_iter()).with_pace(pace);
        let is_unplugged = faults != Faults::default();
        let bus = EmulatedBus::start(model.with_faults(faults)).unwrap();
        let (live, again) = (directory.path().join(name), directory.path().join(format!("{name}-again")));
        let settings = easy_settings(directory.path());
        let mut arguments = vec!["live", "--board", BOARD, "-o", text(&live), "--duration", "100s", "--accept-any"];
        if !is_unplugged {
            arguments.extend(["--settings", text(&settings)]);
        }
        let (code, printed, errors) = run(&bus, &arguments);
        let recording = live.join("recording.dvraw");
        assert_eq!(code, Some(i32::from(is_unplugged)), "{printed}\n{errors}");
        assert!(is_unplugged || (printed.contains("Mev/s") && printed.contains("% of the sensor")), "{printed}");
        assert_eq!(errors.contains("the camera was unplugged"), is_unplugged, "{errors}");
        assert_eq!(printed.contains("(stopped)"), !is_unplugged, "{printed}");
        let mut arguments = vec!["calibrate", text(&recording), "--board", BOARD, "-o", text(&again), "--accept-any"];
        if !is_unplugged {
            arguments.extend(["--settings", text(&settings)]);
        }
        let output = Command::new(env!("CARGO_BIN_EXE_evcal")).args(&arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let (live, again) = (results(&live), results(&again));
        assert!(live.iter().any(|(name, _)| name == "calibration.json"), "{printed}");
        assert!(live == again, "{name}: the results differ");
    }
}
