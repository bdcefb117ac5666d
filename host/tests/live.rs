//! `evcal live --replay`: the same recording gives the same hints, and the camera that `evcal calibrate` gives.

use std::ops::ControlFlow;
use std::path::Path;

use assert_cmd::Command;
use evcal::live::latest::Latest;
use evcal::live::observer::Observer;
use evcal::live::replay::replay;
use evcal::settings::Settings;
use evcal::{Board, Recording, RecordingOptions};
use evcal_core::sensor::Sensor;
use serde_json::Value;
use tempfile::TempDir;

const RECORDING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/board/events.dvraw");
const BOARD: &str = "acircles:9x4:55mm:r17.5mm";
const SENSOR: Sensor = Sensor::new(346, 260);

/// What is told, each second, of the recording played at `speed`.
fn told(speed: Option<f64>) -> Vec<String> {
    let (settings, board): (_, Board) = (Settings::default(), BOARD.parse().unwrap());
    let recording = Recording::new(Path::new(RECORDING), RecordingOptions::default()).unwrap();
    let observer = Observer::new(&settings.detection, &settings.initial, &settings.live, &board, SENSOR);
    let latest = Latest::new(observer.seen());
    let mut told = Vec::new();
    let tell = |seen: &evcal::live::Seen| told.push(format!("{seen:?}"));
    let report = replay(&recording, SENSOR, speed, observer, &latest, tell, |_| ControlFlow::Continue(())).unwrap();
    assert!(report.damage.is_none() && report.events > 1_000_000);
    assert!(report.seen.coverage.boards > 200 && report.seen.camera.is_some());
    told.push(format!("{:?}", report.seen));
    told
}

#[test]
fn replay_tells_the_same_at_every_speed() {
    let first = told(None);
    assert_eq!(first.len(), 3, "two whole seconds and the end");
    assert_eq!(told(None), first);
    assert_eq!(told(Some(2.0)), first);
}

#[test]
fn replay_ends_in_the_camera_of_calibrate() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
        let output =
            command.args(arguments).args(["--board", BOARD, "--json", "--force", "-o"]).arg(&out).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::Deserializer::from_slice(&output.stdout).into_iter().map(Result::unwrap).collect::<Vec<Value>>()
    };
    let live = run(&["live", "--replay", RECORDING, "--speed", "max", "--no-page"]);
    let calibrated = run(&["calibrate", RECORDING]);
    let (result, hints) = live.split_last().unwrap();
    for part in ["camera", "sigma", "verdict", "residuals"] {
        assert_eq!(result[part], calibrated[0][part], "{part}");
    }
    assert_eq!(hints.len(), 2);
    for (second, hint) in hints.iter().enumerate() {
        assert!(hint["t"].as_f64().unwrap() >= second as f64 + 1.0);
        assert!(hint["hint"].is_string() && hint["missing"].is_array() && hint["ghost"][3][1].is_number(), "{hint}");
    }
}

#[test]
fn wrong_use_is_told() {
    for (arguments, reason) in [
        (&["--speed", "2"] as &[&str], "--replay"),
        (&["--replay", RECORDING, "--speed", "fast"], "a number from 0.01 to 1000, or max"),
        (&["--replay", RECORDING, "--frames"], "--frames"),
        (&["--no-page", "--port", "1"], "--port"),
        (&["--sensor", "346x260"], "--replay"),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
        let output = command.args(["live", "--board", BOARD, "-o", "none"]).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(error.contains(reason), "{error}");
    }
}
