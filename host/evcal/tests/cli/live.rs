//! `evcal live --replay`: the same recording always gives the same hints, and the camera of `evcal calibrate`. Reports on camera and
//! board, compared with simulated recordings.

use std::convert::Infallible;
use std::ops::ControlFlow;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use assert_cmd::Command;
use evcal::{CircleBoard, Recording, RecordingOptions};
use evcal_calibrate::calibrate::beginning::calibrate_beginning;
use evcal_calibrate::calibrate::calibrate;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::Task;
use evcal_core::camera::ModelKind;
use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_live::checkpoint::{Checkpoints, ReportTime, ReportedAccuracy};
use evcal_live::frames::FrameFeed;
use evcal_live::guidance::Hint;
use evcal_live::health::{Health, HealthMonitor};
use evcal_live::latest::Latest;
use evcal_live::observer::Observer;
use evcal_live::obstacle::{Obstacle, explain};
use evcal_live::replay::replay;
use evcal_simulator::lens::lens;
use evcal_simulator::motion::MotionSettings;
use evcal_simulator::rays::Rays;
use evcal_simulator::scene::SceneSettings;
use evcal_simulator::sensor::SensorModel;
use evcal_simulator::{Simulation, SimulationSettings};
use event_recordings::pass::read_recording;
use serde_json::Value;
use tempfile::TempDir;

const RECORDING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/board/events.dvraw");
const BOARD: &str = "acircles:9x4:55mm:r17.5mm";
const SENSOR: Sensor = Sensor::new(346, 260);

fn board() -> CircleBoard {
    BOARD.parse().unwrap()
}

fn recording(path: &Path) -> Recording {
    Recording::new(path, RecordingOptions::default()).unwrap()
}

fn accuracy(calibrated: &Calibrated) -> ReportedAccuracy {
    let projection = &calibrated.quality.projection;
    let halves = calibrated.events().and_then(|events| events.quality.split_half.as_ref());
    ReportedAccuracy {
        rms: projection.rms,
        max: projection.max,
        halves_agree: halves.is_some_and(|halves| halves.consistent()),
    }
}

/// Calibrates the first `seconds`; returns the reported uncertainty.
fn state(path: &Path, seconds: f64) -> ReportedAccuracy {
    let board = board();
    accuracy(
        &calibrate_beginning(&recording(path), seconds, &Task::new(&[], &board.into()), |_| ControlFlow::Continue(()))
            .unwrap(),
    )
}

/// Plays the recording at `speed`, with a checkpoint after a second; returns the lines that are printed once per second.
fn printed_lines(speed: Option<f64>) -> Vec<String> {
    let (settings, board) = (Settings::default(), board());
    let work = |seconds: f64, _: &_| Ok(state(Path::new(RECORDING), seconds));
    let checkpoints = Checkpoints::start(ReportTime::AtLength(1.5), 0.05, 1.0, work).unwrap();
    let observer = Observer::new(&settings.detection, &settings.initial, &settings.live, &board.into(), SENSOR)
        .with_checkpoints(checkpoints);
    let latest = Latest::new(observer.seen());
    let mut printed = Vec::new();
    let on_progress = |seen: &evcal_live::Seen| printed.push(format!("{seen:?}"));
    let report = replay(&recording(Path::new(RECORDING)), SENSOR, speed, observer, &latest, on_progress, |_| {
        ControlFlow::Continue(())
    })
    .unwrap();
    assert!(report.damage.is_none() && report.events > 1_000_000);
    let seen = &report.seen;
    assert!(seen.coverage.boards > 200 && seen.camera.is_some());
    let checkpoint = seen.checkpoint.as_ref().unwrap();
    let accuracy = checkpoint.accuracy.as_ref().unwrap();
    assert!(seen.about.unwrap() <= accuracy.rms && accuracy.rms < 0.2, "{accuracy:?}");
    assert!(!seen.is_enough(), "three seconds are too short");
    printed.push(format!("{seen:?}"));
    printed
}

/// A checkpoint reports the same as a calibration of the same events, also while the file ends in the middle of a record.
#[test]
fn a_checkpoint_is_a_calibration_of_the_beginning() {
    let (mut events, board): (Vec<Event>, CircleBoard) = (Vec::new(), board());
    let whole = recording(Path::new(RECORDING));
    read_recording(&whole, &mut |batch| events.extend_from_slice(batch)).unwrap();
    events.retain(|event| event.t < 1_200_000);
    let options = RecordingOptions { sensor: Some(SENSOR), ..RecordingOptions::default() };
    let inputs = [Recording::from_events("beginning", events, options).into()];
    let expected = accuracy(&calibrate(&Task::new(&inputs, &board.into()), |_| ControlFlow::Continue(())).unwrap());
    assert_eq!(state(Path::new(RECORDING), 1.2), expected);

    let folder = TempDir::new().unwrap();
    let growing = folder.path().join("growing.dvraw");
    let bytes = std::fs::read(RECORDING).unwrap();
    std::fs::write(&growing, &bytes[..bytes.len() * 2 / 3]).unwrap();
    assert_eq!(state(&growing, 1.2), expected);
}

/// The events of a simulated second or two.
fn simulated(board: &str, sensor: SensorModel, motion: MotionSettings, duration: f64) -> Vec<Event> {
    let camera = lens(ModelKind::Radtan, &[331.6, 331.1, 176.9, 134.2, -0.352, 0.149, -0.0004, 0.0005, -0.03]).unwrap();
    let settings = SimulationSettings { duration, seed: 5, scene: SceneSettings::default(), sensor, motion };
    let simulation = Simulation::new(Rays::new(&camera, SENSOR), board.parse().unwrap(), settings).unwrap();
    let mut events = Vec::new();
    let taken = simulation.run(|slice| {
        events.extend_from_slice(slice);
        Ok::<(), Infallible>(())
    });
    taken.unwrap();
    events
}

fn health(events: &[Event]) -> Health {
    let (settings, board) = (Settings::default(), board());
    let mut observer = Observer::new(&settings.detection, &settings.initial, &settings.live, &board.into(), SENSOR);
    events.chunks(10_000).for_each(|events| {
        observer.push(events);
    });
    observer.finish();
    let mut alone = HealthMonitor::new(SENSOR);
    alone.push(events);
    let health = observer.seen().health;
    assert_eq!((alone.health().noise, alone.health().hot_pixels), (health.noise, health.hot_pixels));
    health
}

#[test]
fn the_reported_health_is_that_of_the_simulated_sensor() {
    let quiet = SensorModel { hot_pixels: 0, ..SensorModel::default() };
    let noisy = SensorModel { noise_rate: 5.0, hot_pixels: 12, hot_rate: [100.0, 400.0], ..SensorModel::default() };
    let (quiet, noisy) = (
        health(&simulated(BOARD, quiet, MotionSettings::slow(), 2.2)),
        health(&simulated(BOARD, noisy, MotionSettings::slow(), 2.2)),
    );
    // Shot noise and leak.
    for (found, rate) in [(quiet.noise.unwrap(), 0.7), (noisy.noise.unwrap(), 5.1)] {
        assert!((found / rate - 1.0).abs() < 0.4, "{found} {rate}");
    }
    assert_eq!((quiet.hot_pixels, noisy.hot_pixels), (Some(0), Some(12)));
    let rates = quiet.rates.unwrap();
    assert!((rates.on_share - 0.5).abs() < 0.05 && rates.mean < rates.peak, "{rates:?}");
    assert!(rates.load.unwrap() > 0.01 && rates.load.unwrap() < 0.5, "{rates:?}");
}

#[test]
fn a_blurred_lens_has_wider_edges() {
    let width = |point_spread| {
        let sensor = SensorModel { point_spread, ..SensorModel::default() };
        health(&simulated(BOARD, sensor, MotionSettings::slow(), 0.7)).focus.unwrap().sharpest
    };
    let (sharp, blurred) = (width(0.6), width(2.2));
    assert!(blurred > 1.2 * sharp, "{sharp} {blurred}");
}

/// Lamps are simulated by leaving out events of a good recording in step with them.
#[test]
fn a_flickering_lamp_is_reported() {
    let events = simulated(BOARD, SensorModel::default(), MotionSettings::slow(), 3.3);
    assert_eq!(health(&events).flicker, Some(None));
    let under_a_lamp = |event: &&Event| {
        let wave = (std::f64::consts::TAU * 100.0 * event.t as f64 * 1e-6).cos();
        let chance = f64::from((event.t as u32 ^ u32::from(event.x) << 7).wrapping_mul(2_654_435_761) >> 16) / 65_536.0;
        chance < 0.5 + 0.4 * wave
    };
    let flickering: Vec<Event> = events.iter().filter(under_a_lamp).copied().collect();
    assert_eq!(health(&flickering).flicker.unwrap().unwrap().frequency, 100.0);
}

#[test]
fn the_reason_for_a_missing_board_is_reported() {
    let (settings, board) = (Settings::default(), board());
    let why = |events: &[Event]| explain(events, &board.into(), SENSOR, &settings.detection).obstacle;
    let model = SensorModel::default;
    assert_eq!(why(&[]), Obstacle::NoEvents);
    let still = MotionSettings { mean_speed: 2.0, tremor: 0.0, ..MotionSettings::slow() };
    assert_eq!(why(&simulated(BOARD, model(), still, 0.4)), Obstacle::TooSlow);
    let far = MotionSettings { distance_scale: 5.0, ..MotionSettings::fast() };
    assert_eq!(why(&simulated(BOARD, model(), far, 0.4)), Obstacle::TooFar);
}

#[test]
fn a_board_of_another_layout_is_named() {
    let settings = Settings::default();
    let exchanged: CircleBoard = "acircles:4x9:55mm:r17.5mm".parse().unwrap();
    let events = simulated(BOARD, SensorModel::default(), MotionSettings::fast(), 0.4);
    let found = explain(&events, &exchanged.into(), SENSOR, &settings.detection);
    let Obstacle::OtherBoard(other) = found.obstacle else { panic!("{:?}", found.obstacle) };
    assert_eq!(other.pattern(), Some(board().pattern));
    assert!(found.circles.len() > 18, "{}", found.circles.len());
}

#[test]
fn a_cut_off_board_is_reported() {
    let (settings, board) = (Settings::default(), board());
    let events = simulated(BOARD, SensorModel::default(), MotionSettings::fast(), 0.4);
    // Only a corner of the picture, moved to the corner of the sensor: the rest of the board is outside.
    let corner: Vec<Event> = events
        .iter()
        .filter(|event| event.x < 150 && event.y < 120)
        .map(|event| Event { x: event.x + 196, y: event.y + 140, ..*event })
        .collect();
    let found = explain(&corner, &board.into(), SENSOR, &settings.detection);
    assert_eq!(found.obstacle, Obstacle::CutOff, "{:?}", found.circles);
}

/// Boards of squares are found as soon as they are in view, their outline is current, and there is a camera to guide with.
#[test]
fn boards_of_squares_are_guided_while_they_move() {
    for text in ["checkerboard:6x9:25mm", "aprilgrid:6x6:35.2mm:0.3"] {
        let (settings, board) = (Settings::default(), text.parse().unwrap());
        let mut observer = Observer::new(&settings.detection, &settings.initial, &settings.live, &board, SENSOR);
        let events = simulated(text, SensorModel::default(), MotionSettings::slow(), 2.5);
        let (mut lags, mut first_hint) = (Vec::new(), f64::INFINITY);
        for piece in events.chunk_by(|a, b| a.t / 10_000 == b.t / 10_000) {
            if observer.push(piece) {
                let seen = observer.seen();
                lags.extend(seen.board.map(|board| seen.t - board.t));
                first_hint = if seen.hint == Hint::Show { first_hint } else { first_hint.min(seen.t) };
            }
        }
        lags.sort_by(f64::total_cmp);
        let (seen, lag) = (observer.seen(), lags.get(lags.len() / 2));
        println!(
            "{text}: first hint {first_hint:.2} s, lag {lag:?}, {} boards, {:?}",
            seen.coverage.boards, seen.camera
        );
        assert!(first_hint < 1.5 && lag.is_some_and(|lag| *lag < 0.1), "{text}: {first_hint} s, {lag:?} s");
        assert!(seen.coverage.boards > 30 && seen.camera.is_some(), "{text}: {}", seen.coverage.boards);
    }
}

/// Another board of squares in view is named.
#[test]
fn another_board_of_squares_is_named() {
    let settings = Settings::default();
    let events = simulated("checkerboard:6x9:25mm", SensorModel::default(), MotionSettings::slow(), 0.7);
    for stated in ["checkerboard:5x8:25mm", "aprilgrid:6x6:35.2mm:0.3", BOARD] {
        let found = explain(&events, &stated.parse().unwrap(), SENSOR, &settings.detection);
        let Obstacle::OtherBoard(other) = &found.obstacle else { panic!("{stated}: {:?}", found.obstacle) };
        assert!(other.to_string().contains("6x9") || other.to_string().contains("6 x 9"), "{stated}: {other}");
    }
}

#[test]
fn replay_prints_the_same_at_every_speed() {
    let first = printed_lines(None);
    assert_eq!(first.len(), 3, "two whole seconds and the end");
    assert_eq!(printed_lines(None), first);
    assert_eq!(printed_lines(Some(2.0)), first);
}

#[test]
fn every_kind_of_session_results_in_the_camera_of_calibrate() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out");
    let run_with = |arguments: &[&str], input: Vec<u8>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
        command.args(arguments).args(["--board", BOARD, "--json", "--force", "-o"]).arg(&out).write_stdin(input);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        // One object per line, also for the calibration.
        let text = String::from_utf8(output.stdout).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect::<Vec<Value>>()
    };
    let run = |arguments: &[&str]| run_with(arguments, Vec::new());
    let live = run(&["live", "--replay", RECORDING, "--speed", "max", "--no-page"]);
    let calibrated = run(&["calibrate", RECORDING]);
    let (result, hints) = live.split_last().unwrap();
    for part in ["camera", "sigma", "verdict", "residuals"] {
        assert_eq!(result[part], calibrated[0][part], "{part}");
    }
    assert_eq!(hints.len(), 2);
    for (second, hint) in hints.iter().enumerate() {
        assert!(hint["t"].as_f64().unwrap() >= second as f64 + 1.0);
        assert!(hint["health"]["rate"].as_f64().unwrap() > 1e5 && hint["checkpoint"].is_null(), "{hint}");
        assert!(hint["hint"].is_string() && hint["missing"].is_array() && hint["ghost"][3][1].is_number(), "{hint}");
    }

    // The same events from another program: on standard input, and in a file that grows by pieces that end anywhere.
    let [raw, table] = ["events.raw", "events.csv"].map(|name| folder.path().join(name));
    for path in [&raw, &table] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
        assert!(command.args(["convert", RECORDING]).arg(path).output().unwrap().status.success());
    }
    let words = std::fs::read(&raw).unwrap();
    let piped = run_with(&["live", "-", "--no-page"], words.clone());
    assert_eq!(std::fs::read(out.join("recording.raw")).unwrap(), words, "standard input is stored");
    let text = std::fs::read(&table).unwrap();
    let growing = folder.path().join("growing.csv");
    std::fs::write(&growing, &text[..1000]).unwrap();
    let mut writer = std::fs::OpenOptions::new().append(true).open(&growing).unwrap();
    let followed = std::thread::scope(|scope| {
        scope.spawn(|| {
            for piece in text[1000..].chunks(text.len() / 50) {
                sleep(Duration::from_millis(30));
                std::io::Write::write_all(&mut writer, piece).unwrap();
            }
        });
        run(&["live", growing.to_str().unwrap(), "--follow", "--no-page"])
    });
    for live in [piped, followed] {
        let (result, hints) = live.split_last().unwrap();
        assert_eq!((&result["camera"], &result["sigma"]), (&calibrated[0]["camera"], &calibrated[0]["sigma"]));
        assert!(hints.len() >= 2 && hints.iter().any(|hint| hint["hint"].is_string()), "{hints:?}");
    }
}

/// Without data from the camera there is no time either.
#[test]
fn a_silent_camera_is_reported() {
    let (settings, board) = (Settings::default(), board());
    let mut observer = Observer::new(&settings.detection, &settings.initial, &settings.live, &board.into(), SENSOR);
    assert_eq!(observer.seen().explanation, None);
    observer.silence(1.2);
    let seen = observer.seen();
    assert_eq!((seen.hint, seen.explanation.unwrap().obstacle), (Hint::Show, Obstacle::NoEvents));
    let mut events = Vec::new();
    read_recording(&recording(Path::new(RECORDING)), &mut |batch| events.extend_from_slice(batch)).unwrap();
    events.retain(|event| event.t < 1_000_000);
    events.chunks(10_000).for_each(|events| {
        observer.push(events);
    });
    let seen = observer.seen();
    assert!(seen.coverage.boards > 50 && seen.explanation.is_none(), "{:?}", seen.explanation);
    observer.silence(1.2);
    let seen = observer.seen();
    assert_eq!((seen.hint, seen.explanation.unwrap().obstacle), (Hint::Lost, Obstacle::NoEvents));
}

/// The uncertainties of the cells agree with that of the sensor, and remembered observations count from the start.
#[test]
fn the_map_of_the_uncertainty_agrees_with_its_mean_and_is_kept_in_memory() {
    let (settings, board) = (Settings::default(), board());
    let new = || Observer::new(&settings.detection, &settings.initial, &settings.live, &board.into(), SENSOR);
    let mut observer = new();
    read_recording(&recording(Path::new(RECORDING)), &mut |batch| {
        observer.push(batch);
    })
    .unwrap();
    observer.finish();
    let seen = observer.seen();
    assert_eq!(seen.sigma_in_cells.len(), seen.coverage.cells.len());
    let cells: Vec<f64> = seen.sigma_in_cells.iter().flatten().copied().collect();
    let rms = (cells.iter().map(|sigma| sigma * sigma).sum::<f64>() / cells.len() as f64).sqrt();
    assert!((rms / seen.sigma.unwrap() - 1.0).abs() < 0.1, "{rms} {:?}", seen.sigma);
    let worst = cells.iter().copied().fold(0.0, f64::max);
    assert!(cells[27] < rms && rms < worst, "the middle is known best: {cells:?}");

    let remembered = new().with_memory(observer.into_memory()).seen();
    assert_eq!(remembered.coverage, seen.coverage);
    assert_eq!((remembered.sigma, remembered.sigma_in_cells), (seen.sigma, seen.sigma_in_cells));
    assert_eq!((remembered.hint, remembered.board, remembered.watched), (Hint::Show, None, 0.0));
}

/// Frames of a recording are shown with the events of the same time, not earlier.
#[test]
fn frames_of_a_recording_are_shown_at_their_time() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("simulated");
    let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
    let output = command
        .args(["simulate", "--board", BOARD, "--duration", "0.6s", "--frames", "30", "--seed", "3", "-o"])
        .arg(&out)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let simulated = recording(&out.join("events.aedat4"));
    let mut frames = Vec::new();
    simulated.visit_frames(|frame| frames.push((frame.exposure.0, frame.image.unwrap()))).unwrap();
    assert!(frames.len() > 5, "{}", frames.len());
    let mut first = None;
    read_recording(&simulated, &mut |batch| first = first.or(batch.first().map(|event| event.t))).unwrap();
    let feed = FrameFeed::start(simulated);
    for pair in [&frames[2..4], &frames[4..6]] {
        let between = 0.5 * ((pair[0].0 + pair[1].0 - 2 * first.unwrap()) as f64) * 1e-6;
        let end = Instant::now() + Duration::from_secs(60);
        while feed.at(between).as_deref() != Some(&pair[0].1) {
            assert!(Instant::now() < end, "the frame does not come");
            sleep(Duration::from_millis(5));
        }
        sleep(Duration::from_millis(50));
        assert_eq!(feed.at(between).as_deref(), Some(&pair[0].1), "the next one is not due");
    }
}

#[test]
fn wrong_usage_is_reported() {
    for (arguments, reason) in [
        (&["--speed", "2"] as &[&str], "--replay"),
        (&["--replay", RECORDING, "--speed", "fast"], "a number from 0.01 to 1000, or max"),
        (&["--replay", RECORDING, "--frames"], "--frames"),
        (&["--no-page", "--port", "1"], "--port"),
        (&["--no-page", "--listen", "0.0.0.0"], "--listen"),
        (&["--no-page", "--no-open"], "--no-open"),
        (&["--sensor", "346x260"], "--replay"),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
        let output = command.args(["live", "--board", BOARD, "-o", "none"]).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(error.contains(reason), "{error}");
    }
}
