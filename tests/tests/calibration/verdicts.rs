//! Verdicts of `evcal calibrate` on good and bad recordings.

use std::cell::Cell;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use evcal_core::event::Polarity;
use evcal_tests::lens::{self, RADTAN};
use evcal_tests::{BOARD, camera, evcal, json, made, read_json, text};
use event_recordings::{Recording, RecordingOptions};
use serde_json::Value;

/// Calibrates from `events` and returns the verdict.
fn verdict(name: &str, events: &Path, board: &str) -> Value {
    let options = ["--board", board, "--model", RADTAN.model, "--accept-any"];
    let calibration = made(name, &[&["calibrate", text(events)][..], &options].concat());
    read_json(&calibration.join("calibration.json"))["verdict"].clone()
}

/// Returns the path of a recording of three seconds of this motion.
fn events(motion: &str) -> PathBuf {
    RADTAN.simulation(motion, &["--motion", motion, "--duration", "3s", "--seed", "4"]).join("events.aedat4")
}

/// `true` if the verdict's sentence contains the reason of a finding with this cause.
fn names(verdict: &Value, cause: &str) -> bool {
    let findings = verdict["findings"].as_array().expect("findings");
    findings.iter().any(|finding| {
        let reason = finding["reason"].as_str().expect("a reason");
        finding["cause"] == cause && verdict["sentence"].as_str().expect("a sentence").contains(reason)
    })
}

#[test]
fn a_good_recording_has_a_good_verdict() {
    for lens in lens::ALL {
        let verdict = read_json(&lens.own_calibration().join("calibration.json"))["verdict"].clone();
        assert_eq!(verdict["grade"], "good", "{}: {verdict:#}", lens.model);
    }
}

#[test]
fn a_distant_board_leaves_the_camera_uncertain() {
    let options = ["--motion", "far", "--duration", "4s", "--seed", "13"];
    let verdict = verdict("far", &RADTAN.simulation("far-4s", &options).join("events.aedat4"), BOARD);
    // Both findings are warnings. The sentence names the distance, which is the cause, and the uncertainty is a separate finding.
    assert_eq!(verdict["grade"], "usable", "{verdict:#}");
    assert!(names(&verdict, "far-away"), "{verdict:#}");
    let findings = verdict["findings"].as_array().expect("findings");
    assert!(findings.iter().any(|finding| finding["cause"] == "uncertain"), "{verdict:#}");
}

/// The verdict was good, with a true error of eight times the bound: neither the other half of the events nor the camera's frames can
/// contradict a value that all of them share.
#[test]
fn a_fixed_value_that_the_recording_contradicts_is_not_good() {
    let events = RADTAN.recording().join("events.aedat4");
    let given = ["calibrate", text(&events), "--board", BOARD, "--model", RADTAN.model, "--accept-any"];
    let fx = camera(&RADTAN.recording().join("truth.json")).parameters()[0];
    for (value, cause) in [(1.005 * fx, true), (fx, false)] {
        let fixed = format!("fx={}", (100.0 * value).round() / 100.0);
        let calibration = made(&format!("fixed-{cause}"), &[&given[..], &["--fix", &fixed]].concat());
        let verdict = read_json(&calibration.join("calibration.json"))["verdict"].clone();
        assert_eq!((names(&verdict, "fixed-value"), verdict["grade"] == "not-good"), (cause, cause), "{verdict:#}");
        assert_eq!(verdict.to_string().contains(&format!("leave out --fix {fixed}")), cause, "{verdict:#}");
    }
}

#[test]
fn frontal_views_are_reported() {
    let verdict = verdict("head-on", &events("head-on"), BOARD);
    assert!(names(&verdict, "head-on"), "{verdict:#}");
}

#[test]
fn uncovered_parts_of_the_sensor_are_reported() {
    let verdict = verdict("corner", &events("corner"), BOARD);
    assert!(names(&verdict, "uncovered"), "{verdict:#}");
    assert!(verdict["sentence"].as_str().unwrap().contains("at the lower right"), "{verdict:#}");
}

/// A lens calibrated with an unsuitable model: the verdict recommends a suitable one, and the error is within the reported bound.
#[test]
fn an_unsuitable_model_is_reported_with_a_better_one() {
    for (lens, model, right) in [
        (lens::KANNALA_BRANDT, "radtan", &["kannala-brandt", "radtan8", "eucm", "double-sphere"][..]),
        // The model is wrong by half a pixel in the corners, which the board rarely covers, and almost exact elsewhere.
        (lens::RADTAN8, "radtan4", &["radtan", "radtan8"][..]),
    ] {
        let simulation = lens.simulation("wrong-model", &["--motion", "fast", "--duration", "4s", "--seed", "7"]);
        let events = simulation.join("events.aedat4");
        let options = ["--board", BOARD, "--model", model, "--accept-any"];
        let name = format!("wrong-model-{model}");
        let folder = made(&name, &[&["calibrate", text(&events)][..], &options].concat());
        let calibration = read_json(&folder.join("calibration.json"));
        let verdict = &calibration["verdict"];
        assert_eq!(verdict["grade"], "not-good", "{model}: {verdict:#}");
        assert!(names(verdict, "model-too-poor"), "{model}: {verdict:#}");
        let better = calibration["misfit"]["better_model"].as_str().expect("a better model");
        assert!(right.contains(&better), "{model}: {better}");
        let sentence = verdict["sentence"].as_str().expect("a sentence");
        assert!(sentence.contains(&format!("the model {better} fits better")), "{model}: {sentence}");
        let evaluation = json(&["evaluate", text(&folder), "--truth", text(&simulation), "--json"]);
        let error = evaluation["projection_difference"]["rms_px"].as_f64().expect("a number");
        let bound = calibration["uncertainty"]["projection_rms_95"].as_f64().expect("a number");
        assert!(error <= bound, "{model}: the error of {error} px exceeds the reported bound of {bound} px");
    }
}

#[test]
fn a_recording_of_two_seconds_is_reported_as_short() {
    let events = RADTAN.simulation("short", &["--motion", "fast", "--duration", "2s"]).join("events.aedat4");
    let verdict = verdict("short", &events, BOARD);
    assert!(names(&verdict, "short"), "{verdict:#}");
}

/// Writes the events of the recording in the folder `simulation` as a sensor sends them that can read `per_millisecond` events
/// per millisecond.
fn read_out(simulation: &Path, per_millisecond: f64, file: &Path) {
    let recording = Recording::new(simulation.join("events.aedat4"), RecordingOptions::default()).unwrap();
    let mut reader = recording.open().unwrap();
    let (mut events, mut free) = (Vec::new(), 0.0_f64);
    let mut csv = "# sensor 346 x 260\nt_us,x,y,p\n".to_owned();
    while reader.next_batch(&mut events).unwrap() {
        for event in &events {
            free = free.max(event.t as f64) + 1e3 / per_millisecond;
            let polarity = u8::from(event.polarity == Polarity::On);
            writeln!(csv, "{:.0},{},{},{polarity}", free.floor(), event.x, event.y).unwrap();
        }
    }
    fs::write(file, csv).unwrap();
}

/// Two sensors are too slow for the motion: one occasionally, the other nearly always.
#[test]
fn a_saturated_readout_is_reported() {
    let options = ["--motion", "fast", "--duration", "3s", "--seed", "4"];
    let simulation = RADTAN.simulation("readout", &options);
    let folder = tempfile::tempdir().unwrap();
    let run = |per_millisecond: f64, name: &str| {
        let file = folder.path().join(name).with_extension("csv");
        read_out(&simulation, per_millisecond, &file);
        let output = folder.path().join(name);
        let model = ["--model", RADTAN.model, "--accept-any", "-o", text(&output)];
        let finished = evcal(&[&["calibrate", text(&file), "--board", BOARD][..], &model].concat());
        assert_eq!(finished.code, Some(0), "{finished:?}");
        output
    };
    let (sometimes, always) = (run(2000.0, "sometimes"), run(1300.0, "always"));
    let verdict = |folder: &Path| read_json(&folder.join("calibration.json"))["verdict"].clone();
    let verdict_of_run = verdict(&sometimes);
    assert!(names(&verdict_of_run, "saturated") && verdict_of_run["grade"] != "not-good", "{verdict_of_run:#}");
    let figures = json(&["evaluate", text(&sometimes), "--truth", text(&simulation), "--json"]);
    let furthest = figures["trajectory"]["best_time_shift"]["as_is_m"]["max"].as_f64().unwrap();
    assert!(furthest < 5e-3, "{furthest} m: late events are in the trajectory");
    let verdict_of_run = verdict(&always);
    assert!(names(&verdict_of_run, "saturated") && verdict_of_run["grade"] == "not-good", "{verdict_of_run:#}");
}

/// The nominal radius or spacing is wrong by 10 %. Only their ratio can be measured.
#[test]
fn a_wrong_nominal_radius_or_spacing_is_reported() {
    let events = RADTAN.recording().join("events.aedat4");
    for (name, board) in [
        ("radius", "acircles:9x4:55mm:r19.5mm"),
        ("smaller-radius", "acircles:9x4:55mm:r15.5mm"),
        ("spacing", "acircles:9x4:50mm:r17.5mm"),
    ] {
        let verdict = verdict(name, &events, board);
        assert_eq!(verdict["grade"], "not-good", "{board}: {verdict:#}");
        assert!(names(&verdict, "radius-disagrees"), "{board}: {verdict:#}");
        assert!(verdict["sentence"].as_str().unwrap().contains("spacing"), "{verdict:#}");
    }
}

/// The exit code informs scripts; the results are written nevertheless.
#[test]
fn not_good_enough_has_an_exit_code_of_its_own() {
    let events = RADTAN.recording().join("events.aedat4");
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("output");
    let board = "acircles:9x4:55mm:r19.5mm";
    let finished = evcal(&["calibrate", text(&events), "--board", board, "-o", text(&output)]);
    assert_eq!(finished.code, Some(3), "{finished:?}");
    assert!(finished.stderr.contains("--accept-any") && finished.stdout.contains("fx"), "{finished:?}");
    assert_eq!(read_json(&output.join("calibration.json"))["verdict"]["grade"], "not-good");
}

/// A mirrored print has its circles at the same positions, so the camera is the same. The test mirrors the image instead of the
/// print, which also mirrors the principal point.
#[test]
fn a_mirrored_print_gives_the_same_camera() {
    let board = "acircles:8x4:55mm:r17.5mm";
    let options =
        ["simulate", "--board", board, "--motion", "fast", "--duration", "2s", "--format", "csv", "--seed", "3"];
    let recording = made("even", &options);
    let csv = fs::read_to_string(recording.join("events.csv")).unwrap();
    let mirrored = csv.lines().map(|line| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        // The header has no number in this column.
        if let Some(cell) = cells.get_mut(1)
            && let Ok(x) = cell.parse::<u16>()
        {
            *cell = (345 - x).to_string();
        }
        cells.join(",") + "\n"
    });
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mirrored.csv");
    fs::write(&file, mirrored.collect::<String>()).unwrap();
    let parameters = |events: &Path, name: &str| {
        let output = folder.path().join(name);
        let finished = evcal(&["calibrate", text(events), "--board", board, "--accept-any", "-o", text(&output)]);
        assert_eq!(finished.code, Some(0), "{finished:?}");
        camera(&output.join("calibration.json")).parameters()
    };
    let (direct, mirrored) = (parameters(&recording.join("events.csv"), "direct"), parameters(&file, "mirrored"));
    assert!((direct[0] - mirrored[0]).abs() < 0.1 && (direct[1] - mirrored[1]).abs() < 0.1, "{direct:?} {mirrored:?}");
    assert!((direct[2] - (345.0 - mirrored[2])).abs() < 0.1, "{direct:?} {mirrored:?}");
    assert!((direct[3] - mirrored[3]).abs() < 0.1, "{direct:?} {mirrored:?}");
}

/// The given board has one row or column fewer than the real board: the camera is correct, the origin is not, and the verdict
/// names the whole board.
#[test]
fn a_missing_row_or_column_of_the_board_is_reported() {
    let events = RADTAN.recording().join("events.aedat4");
    for (name, board) in [("a-row-fewer", "acircles:8x4:55mm:r17.5mm"), ("a-column-fewer", "acircles:9x3:55mm:r17.5mm")]
    {
        let verdict = verdict(name, &events, board);
        let findings = verdict["findings"].as_array().expect("findings");
        let larger: Vec<&Value> = findings.iter().filter(|finding| finding["cause"] == "larger-board").collect();
        assert_eq!(larger.len(), 1, "{board}: {verdict:#}");
        assert_eq!(larger[0]["severity"], "warning", "{board}: {verdict:#}");
        assert!(larger[0]["advice"].as_str().expect("advice").contains(&format!("--board {BOARD},")), "{verdict:#}");
    }
    let whole = read_json(&RADTAN.own_calibration().join("calibration.json"))["verdict"].clone();
    assert!(whole["findings"].as_array().expect("findings").iter().all(|finding| finding["cause"] != "larger-board"));
}

#[test]
fn a_wrong_board_is_rejected_with_the_right_one() {
    let events = RADTAN.recording().join("events.aedat4");
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("output");
    let finished = evcal(&["calibrate", text(&events), "--board", "acircles:4x9:55mm:r17.5mm", "-o", text(&output)]);
    assert_eq!(finished.code, Some(1), "{finished:?}");
    assert!(finished.stderr.contains("--board acircles:9x4:55mm:r17.5mm"), "{finished:?}");
}

/// Refocusing by 0.5 % between two recordings leads to a camera between both. Halves of alternating slices agree then, because each
/// is the same mixture.
#[test]
fn a_lens_that_changed_between_recordings_is_reported() {
    let lens = |share: f64| format!("{},{},170.6,131.2,-0.37,0.19,-0.0005,0.0003,-0.06", 344.1 * share, 343.6 * share);
    let simulation = |share: f64, seed: &str| {
        let parameters = format!("--parameters={}", lens(share));
        let motion = ["--motion", "fast", "--duration", "2.5s", "--seed", seed];
        made("refocused", &[&["simulate", "--model", "radtan", &parameters][..], &motion].concat())
    };
    let [first, longer, same] = [(1.0, "21"), (1.005, "22"), (1.0, "23")].map(|(share, seed)| simulation(share, seed));
    let calibrated = |second: &Path| {
        let events = [first.join("events.aedat4"), second.join("events.aedat4")];
        let folder = RADTAN.calibration("refocused", &[&events[0], &events[1]]);
        read_json(&folder.join("calibration.json"))
    };
    let mixed = calibrated(&longer);
    assert!(names(&mixed["verdict"], "lens-changed"), "{:#}", mixed["verdict"]);
    assert_eq!(mixed["verdict"]["grade"], "not-good");
    assert_eq!(mixed["drift"]["recording"], 1);
    assert_eq!(mixed["drift"]["t"], Value::Null, "the change is at the border of the recordings");
    let longer_by = mixed["drift"]["focal_length"]["value"].as_f64().unwrap();
    let sigma = mixed["drift"]["focal_length"]["sigma"].as_f64().unwrap();
    assert!((longer_by - 0.005).abs() < 2.0 * sigma && sigma < 4e-4, "{longer_by} ± {sigma}");
    let alike = calibrated(&same);
    assert_eq!(alike["verdict"]["grade"], "good", "{:#}", alike["verdict"]);
    assert_eq!(alike.get("drift"), None);
}

/// Writes the events of the recording in the folder `simulation` to `file`, those at the pixel that `moved` returns.
fn write_moved(simulation: &Path, moved: impl Fn([u16; 2]) -> Option<[u16; 2]>, file: &Path) {
    let recording = Recording::new(simulation.join("events.aedat4"), RecordingOptions::default()).unwrap();
    let (mut reader, mut events) = (recording.open().unwrap(), Vec::new());
    let mut csv = "# sensor 346 x 260\nt_us,x,y,p\n".to_owned();
    while reader.next_batch(&mut events).unwrap() {
        for event in &events {
            if let Some([x, y]) = moved([event.x, event.y]) {
                writeln!(csv, "{},{x},{y},{}", event.t, u8::from(event.polarity == Polarity::On)).unwrap();
            }
        }
    }
    fs::write(file, csv).unwrap();
}

/// The rows of an image come from below. The board is its own mirror image, so only the accelerations show it.
#[test]
fn the_accelerometer_shows_whether_the_image_is_mirrored() {
    let simulation = RADTAN.simulation("mirrored", &["--imu", "--motion", "fast", "--duration", "4s", "--seed", "51"]);
    let (folder, samples) = (tempfile::tempdir().unwrap(), simulation.join("imu.csv"));
    let verdict = |name: &str, moved: fn([u16; 2]) -> [u16; 2]| {
        let (file, output) = (folder.path().join(format!("{name}.csv")), folder.path().join(name));
        write_moved(&simulation, |place| Some(moved(place)), &file);
        let options = ["--model", RADTAN.model, "--board", BOARD, "--imu", text(&samples), "-o", text(&output)];
        let finished = evcal(&[&["calibrate", text(&file)][..], &options].concat());
        let result = read_json(&output.join("calibration.json"));
        (finished.code, result)
    };
    let (code, result) = verdict("mirrored", |[x, y]| [x, 259 - y]);
    let mirrored = &result["verdict"];
    assert!(names(mirrored, "mirrored-image") && mirrored["grade"] == "not-good", "{mirrored:#}");
    assert_eq!(code, Some(1));
    let (code, result) = verdict("upright", |place| place);
    let (upright, inertial, read) = (&result["verdict"], &result["inertial"], &result["input_files"]);
    assert!(!names(upright, "mirrored-image") && !names(upright, "orientation-not-checked"), "{upright:#}");
    assert_eq!((code, &upright["grade"]), (Some(0), &Value::from("good")), "{upright:#}");
    assert_eq!(read[1]["path"], text(&samples));
    // The samples have no noise, and the axes of the IMU are the camera's: what is left is the error of the trajectory.
    for axis in 0..3 {
        let error = inertial["T_imu_camera"][(axis + 2) % 3][(axis + 1) % 3].as_f64().unwrap();
        let sigma = inertial["rotation_sigma"][axis].as_f64().unwrap();
        assert!(error.abs() < 3.0 * sigma && sigma < 2e-3, "{axis}: {error} ± {sigma}");
    }
}

/// Seven of ten events, chosen at random, are lost. The ranks of the others are wrong, which the focal length absorbs.
#[test]
fn a_random_loss_of_events_is_reported_and_in_the_bound() {
    let simulation = RADTAN.simulation("lost", &["--motion", "fast", "--duration", "2.5s", "--seed", "41"]);
    let folder = tempfile::tempdir().unwrap();
    let (file, output) = (folder.path().join("lost.csv"), folder.path().join("output"));
    let state = Cell::new(1_u64);
    let arrives = |place| {
        state.set(state.get().wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407));
        (state.get() >> 33 < (1 << 31) * 3 / 10).then_some(place)
    };
    write_moved(&simulation, arrives, &file);
    let options = ["--model", RADTAN.model, "--accept-any", "-o", text(&output)];
    let finished = evcal(&[&["calibrate", text(&file), "--board", BOARD][..], &options].concat());
    assert_eq!(finished.code, Some(0), "{finished:?}");
    let found = read_json(&output.join("calibration.json"));
    assert!(names(&found["verdict"], "lost-events") && found["verdict"]["grade"] != "good", "{:#}", found["verdict"]);
    let of = |kind: &str| found[kind]["parameters"]["fx"].as_f64().unwrap();
    let (error, sigma) = (
        of("camera") - read_json(&simulation.join("truth.json"))["camera"]["parameters"]["fx"].as_f64().unwrap(),
        of("sigma"),
    );
    assert!(error.abs() < 1.96 * sigma && sigma < 1.0, "{error} ± {sigma}");
    let checked = evcal(&["check", text(&file), "--board", BOARD]);
    assert!(checked.stdout.contains("lost at random"), "{checked:?}");
}

/// Coordinates that count from 1 and were cut at the sensor's size move the principal point by one pixel. A sensor whose lower half
/// is dead never shows the whole board; the answer was to move faster.
#[test]
fn silent_rows_and_halves_are_reported() {
    let simulation = RADTAN.simulation("silent", &["--motion", "fast", "--duration", "2.5s", "--seed", "31"]);
    let folder = tempfile::tempdir().unwrap();
    let (from_one, half) = (folder.path().join("from-one.csv"), folder.path().join("half.csv"));
    write_moved(&simulation, |[x, y]| (x < 345 && y < 259).then_some([x + 1, y + 1]), &from_one);
    write_moved(&simulation, |[x, y]| (y < 130).then_some([x, y]), &half);
    let output = folder.path().join("from-one");
    let options = ["--model", RADTAN.model, "--accept-any", "-o", text(&output)];
    let finished = evcal(&[&["calibrate", text(&from_one), "--board", BOARD][..], &options].concat());
    assert_eq!(finished.code, Some(0), "{finished:?}");
    let verdict = read_json(&output.join("calibration.json"))["verdict"].clone();
    assert!(names(&verdict, "counted-from-one") && verdict["grade"] == "not-good", "{verdict:#}");
    for command in [
        &["calibrate", text(&half), "--board", BOARD, "-o", text(&folder.path().join("half"))][..],
        &["check", text(&half), "--board", BOARD],
        &["info", text(&half)],
    ] {
        let finished = evcal(command);
        let answer = format!("{}{}", finished.stdout, finished.stderr);
        assert!(
            answer.contains("the lower half of the sensor sends nothing (rows 130 to 259 of 260)"),
            "{command:?}: {answer}"
        );
        assert!(!answer.contains("move faster"), "{command:?}: {answer}");
    }
}

/// Dots and checkerboards look the same in a mirror. The verdict states that this was not checked, which does not lower the grade.
#[test]
fn an_orientation_that_cannot_be_checked_is_stated() {
    let verdict = read_json(&RADTAN.own_calibration().join("calibration.json"))["verdict"].clone();
    let findings = verdict["findings"].as_array().expect("findings");
    assert!(findings.iter().any(|finding| finding["cause"] == "orientation-not-checked"), "{verdict:#}");
    assert_eq!(verdict["grade"], "good");
}
