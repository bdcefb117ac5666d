//! The program as a user runs it: exit codes, messages, files.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

use crate::command::evcal;

/// A lens without distortion, centred on the sensor.
const PINHOLE: &str = "300,300,172.5,129.5,0,0,0,0";

fn code(output: &Output) -> i32 {
    output.status.code().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn succeed(arguments: &[&str]) -> String {
    let output = evcal(arguments);
    assert_eq!(code(&output), 0, "{arguments:?}: {}", stderr(&output));
    let is_stage = |line: &str| line.starts_with("evcal: ") && line.ends_with(" ...");
    assert!(stderr(&output).lines().all(is_stage), "only stages on standard error: {}", stderr(&output));
    stdout(&output)
}

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&succeed(arguments)).unwrap()
}

fn read_json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Simulates 100 ms into a new directory of this name.
fn simulate(directory: &TempDir, name: &str, options: &[&str]) -> PathBuf {
    let output = directory.path().join(name);
    let mut arguments = vec!["simulate", "-o", text(&output), "--duration", "100ms"];
    arguments.extend(options);
    succeed(&arguments);
    output
}

#[test]
fn the_version_is_printed() {
    assert_eq!(succeed(&["--version"]).trim(), concat!("evcal ", env!("CARGO_PKG_VERSION")));
}

/// The board that the help prints is the board that its calibration uses.
#[test]
fn the_example_in_the_help_uses_the_default_board() {
    let directory = tempfile::tempdir().unwrap();
    let printed = succeed(&["board", "--pdf", text(&directory.path().join("board.pdf"))]);
    let board = printed.trim().rsplit_once("calibrate with ").unwrap().1;
    assert!(succeed(&["--help"]).contains(&format!("evcal calibrate recording.dvraw {board} -o")), "{board}");
}

#[test]
fn wrong_usage_is_reported_with_exit_code_2() {
    let directory = tempfile::tempdir().unwrap();
    let output = directory.path().join("never");
    let simulate = ["simulate", "-o", text(&output)];
    let cases: &[(&[&str], &str)] = &[
        (&[], "Usage"),
        (&["calibrat"], "calibrate"),
        (&["info"], "FILE"),
        (&["info", "--columns", "t,x,y", "a.csv"], "x,y,p,t"),
        (&["info", "--time-unit", "h", "a.csv"], "ms"),
        (&["info", "--sensor", "346", "a.csv"], "346x260"),
        (&["info", "--threads", "two", "a.csv"], "--threads"),
        (&["evaluate", "calibration.json"], "--truth"),
        (&["calibrate", "a.csv", "-o", "never"], "--board"),
        (&["calibrate", "a.csv", "-o", "never", "--board", "circles:6x3:40:r10mm"], "acircles:9x4:55mm:r17.5mm"),
        (&["calibrate", "a.csv", "-o", "never", "--board", "circles:6x3:40mm:r9mm", "--model", "x"], "kannala-brandt"),
        (&["simulate"], "--output"),
    ];
    let options: &[(&[&str], &str)] = &[
        (&["--board", "acircle:9x4:55mm:r17mm"], "write acircles:9x4:55mm:r17mm"),
        (&["--board", "dots:9x4:55mm:r17mm"], "acircles:9x4:55mm:r17.5mm"),
        (&["--board", "checkerboard:6x9"], "checkerboard:6x9:25mm"),
        (&["--duration", "6"], "6s"),
        (&["--motion", "jump"], "blur"),
        (&["--model", "radtan"], "--parameters"),
        (&["--model", "fisheye", "--parameters", "1,2,3,4"], "kannala-brandt"),
        (&["--model", "radtan", "--parameters", "1,2,3,4"], "fx,fy,cx,cy,k1,k2,p1,p2,k3"),
        (&["--model", "radtan4", "--parameters", "-300,300,172,129,0,0,0,0"], "positive"),
        (&["--camera", "truth.json", "--sensor", "346x260"], "cannot be used with"),
    ];
    let with_options = options.iter().map(|(options, part)| ([&simulate, *options].concat(), *part));
    for (arguments, part) in cases.iter().map(|(arguments, part)| (arguments.to_vec(), *part)).chain(with_options) {
        let output = evcal(&arguments);
        assert_eq!(code(&output), 2, "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(part), "{arguments:?}: {}", stderr(&output));
        assert_eq!(stdout(&output), "", "{arguments:?}");
    }
    assert!(!output.exists(), "nothing is written");
}

#[test]
fn a_file_that_cannot_be_used_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let file = |name: &str, content: &[u8]| {
        let path = directory.path().join(name);
        fs::write(&path, content).unwrap();
        path
    };
    let missing = directory.path().join("missing.aedat4");
    let cases = [
        (missing.clone(), "No such file"),
        (file("empty.aedat4", b""), "empty"),
        (file("prose.csv", b"It was a bright cold day in April,\nand the clocks were striking thirteen.\n"), ""),
        (file("noise.bin", &[0xff, 0x00, 0x9c, 0x17, 0xe3, 0x55, 0x01]), ""),
        (file("head.aedat4", b"#!AER-DAT4.0\r\n"), ""),
        (file("nan.csv", b"t,x,y,p\nnan,1,2,1\n"), "line 2"),
        (directory.path().to_owned(), "is a folder"),
    ];
    for (path, part) in &cases {
        for json in [&[][..], &["--json"]] {
            let output = evcal(&[&["info", text(path)], json].concat());
            assert_eq!(code(&output), 1, "{path:?}: {}", stdout(&output));
            let message = stderr(&output);
            assert!(message.contains(text(path)) && message.contains(part), "{path:?}: {message}");
            assert!(!message.contains("panicked"), "{message}");
        }
    }
    let results = directory.path().join("results");
    for path in [&missing, &cases[1].0, &cases[3].0] {
        let board = "acircles:9x4:55mm:r17.5mm";
        let output = evcal(&["calibrate", text(path), "--board", board, "-o", text(&results)]);
        assert_eq!(code(&output), 1, "{path:?}: {}", stdout(&output));
        assert!(stderr(&output).contains(text(path)), "{path:?}: {}", stderr(&output));
        assert!(!results.exists(), "nothing is written");
    }
    let output = evcal(&["evaluate", text(&missing), "--truth", text(&missing)]);
    assert_eq!(code(&output), 1);
    assert!(stderr(&output).contains(text(&missing)), "{}", stderr(&output));
    let wrong = file("wrong.json", b"{\"sensor\": {\"width\": 346}}");
    let output = evcal(&["evaluate", text(&wrong), "--truth", text(&wrong)]);
    assert_eq!(code(&output), 1);
    let message = stderr(&output);
    assert!(message.contains(text(&wrong)) && message.contains("height"), "{message}");
}

#[test]
fn one_bad_file_does_not_hide_the_others() {
    let directory = tempfile::tempdir().unwrap();
    let good = directory.path().join("good.csv");
    fs::write(&good, "t_us,x,y,p\n10,1,2,1\n20,3,4,0\n30,5,6,0\n").unwrap();
    let missing = directory.path().join("missing.csv");
    let output = evcal(&["info", "--json", text(&missing), text(&good)]);
    assert_eq!(code(&output), 1);
    assert!(stderr(&output).contains(text(&missing)));
    let information: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((information["events"].as_u64(), information["times_us"][1].as_i64()), (Some(3), Some(30)));
}

#[test]
fn a_seed_gives_the_same_files_on_any_number_of_threads() {
    let directory = tempfile::tempdir().unwrap();
    let one = simulate(&directory, "one", &["--seed", "7", "--threads", "1"]);
    let two = simulate(&directory, "two", &["--seed", "7", "--threads", "2"]);
    let other = simulate(&directory, "other", &["--seed", "8", "--threads", "2"]);
    for name in ["events.aedat4", "truth.json", "trajectory.txt"] {
        let bytes = |directory: &Path| fs::read(directory.join(name)).unwrap();
        assert!(bytes(&one) == bytes(&two), "{name} depends on the number of threads");
        assert!(bytes(&one) != bytes(&other), "{name} does not depend on the seed");
    }
}

#[test]
fn every_format_contains_the_simulated_events() {
    let directory = tempfile::tempdir().unwrap();
    for format in ["aedat4", "csv", "bin", "raw"] {
        let output = simulate(&directory, format, &["--format", format]);
        let truth = read_json(&output.join("truth.json"));
        let [off, on] = ["off_events", "on_events"].map(|count| truth[count].as_u64().unwrap());
        assert!(off > 1000 && on > 1000, "{truth}");
        let information = json(&["info", "--json", text(&output.join(format!("events.{format}")))]);
        assert_eq!(information["events"].as_u64(), Some(off + on), "{format}");
        let share = information["on_share"].as_f64().unwrap();
        assert!((share - on as f64 / (off + on) as f64).abs() < 1e-12, "{format}: {share}");
        let [first, last] = [0, 1].map(|index| information["times_us"][index].as_i64().unwrap());
        assert!((0..5_000).contains(&first) && (95_000..101_000).contains(&last), "{format}: {first} to {last}");
        if ["aedat4", "raw"].contains(&format) {
            assert_eq!(information["sensor"], serde_json::json!({ "width": 346, "height": 260 }));
        }
    }
}

#[test]
fn a_truncated_recording_is_read_to_its_end_and_the_loss_is_reported() {
    let directory = tempfile::tempdir().unwrap();
    let output = simulate(&directory, "whole", &[]);
    let whole = output.join("events.aedat4");
    let bytes = fs::read(&whole).unwrap();
    let cut = directory.path().join("cut.aedat4");
    fs::write(&cut, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let count = |path: &Path| json(&["info", "--json", text(path)])["events"].as_u64().unwrap();
    assert!(count(&cut) > 0 && count(&cut) < count(&whole));
    assert!(succeed(&["info", text(&cut)]).contains("cut off"));
    assert!(!succeed(&["info", text(&whole)]).contains("cut off"));
}

#[test]
fn motion_presets_reach_their_speed() {
    let directory = tempfile::tempdir().unwrap();
    for (motion, speed) in [("slow", 150.0), ("fast", 350.0), ("blur", 700.0)] {
        let output = simulate(&directory, motion, &["--motion", motion, "--light", "ideal"]);
        let truth = read_json(&output.join("truth.json"));
        let found = truth["mean_speed"].as_f64().unwrap();
        assert!((found - speed).abs() < 0.02 * speed, "{motion}: {found} px/s");
    }
}

#[test]
fn the_truth_of_a_simulation_describes_its_camera() {
    let directory = tempfile::tempdir().unwrap();
    let lens = "196.4,196.0,119.3,86.1,-0.018,0.006,-0.003,0.0006";
    let options = ["--model", "kannala-brandt", "--parameters", lens, "--sensor", "240x180"];
    let first = simulate(&directory, "first", &options);
    let again = simulate(&directory, "again", &["--camera", text(&first.join("truth.json"))]);
    assert!(fs::read(first.join("events.aedat4")).unwrap() == fs::read(again.join("events.aedat4")).unwrap());
    let truth = read_json(&first.join("truth.json"));
    assert_eq!(truth["camera"]["parameters"]["k4"].as_f64(), Some(0.0006));
    assert_eq!(truth["sensor"]["width"].as_u64(), Some(240));
    let printed = json(&[
        "simulate",
        "--json",
        "-o",
        text(&directory.path().join("json")),
        "--duration",
        "20ms",
        "--camera",
        text(&first.join("truth.json")),
    ]);
    assert_eq!(printed, read_json(&directory.path().join("json/truth.json")));
}

/// Writes a camera file for a pinhole camera of this focal length.
fn camera_file(path: &Path, focal: f64, width: u16) {
    let camera = serde_json::json!({
        "sensor": { "width": width, "height": 260 },
        "camera": {
            "model": "radtan4",
            "parameters": {
                "fx": focal, "fy": focal, "cx": 172.5, "cy": 129.5, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0
            },
        },
    });
    fs::write(path, camera.to_string()).unwrap();
}

#[test]
fn evaluation_finds_a_known_difference() {
    let directory = tempfile::tempdir().unwrap();
    let truth = simulate(&directory, "truth", &["--model", "radtan4", "--parameters", PINHOLE]);
    let same = json(&["evaluate", text(&truth), "--truth", text(&truth), "--json"]);
    assert!(same["projection_difference"]["max_px"].as_f64().unwrap() < 1e-8, "{same}");
    assert!(same["trajectory"]["own_clock"]["as_is_m"]["max"].as_f64().unwrap() < 1e-12, "{same}");

    // One per cent of focal length moves the corner by one per cent of its distance from the centre.
    let estimate = directory.path().join("estimate");
    fs::create_dir(&estimate).unwrap();
    camera_file(&estimate.join("calibration.json"), 303.0, 346);
    // The same path, 2 ms late, seen from another origin.
    let late: String = fs::read_to_string(truth.join("trajectory.txt"))
        .unwrap()
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let mut fields: Vec<f64> = line.split(' ').map(|field| field.parse().unwrap()).collect();
            fields[0] += 0.002;
            fields.iter().map(f64::to_string).collect::<Vec<_>>().join(" ") + "\n"
        })
        .collect();
    fs::write(estimate.join("trajectory.txt"), late).unwrap();
    let arguments = ["evaluate", text(&estimate), "--truth", text(&truth)];
    let figures = json(&[&arguments[..], &["--json"]].concat());
    let corner = 172.5f64.hypot(129.5);
    let max = figures["projection_difference"]["max_px"].as_f64().unwrap();
    assert!((max - 0.01 * corner).abs() < 1e-6, "{figures}");
    let focal = &figures["intrinsics"]["parameters"]["fx"];
    assert!((focal["difference"].as_f64().unwrap() - 3.0).abs() < 1e-9, "{focal}");
    let trajectory = &figures["trajectory"];
    let shift = trajectory["best_time_shift"]["time_shift_s"].as_f64().unwrap();
    assert!((shift + 0.002).abs() < 1e-5, "{trajectory}");
    let rms = |clock: &str, kind: &str| trajectory[clock][kind]["rmse"].as_f64().unwrap();
    assert!(rms("best_time_shift", "as_is_m") < 1e-6, "{trajectory}");
    assert!(rms("own_clock", "as_is_m") > 1e-4, "{trajectory}");
    let report = succeed(&arguments);
    assert!(report.contains("(+1.000 %)") && report.contains("times shifted by -2000.0 us"), "{report}");
}

#[test]
fn impossible_comparisons_are_reported() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    camera_file(&path("a.json"), 300.0, 346);
    camera_file(&path("wide.json"), 300.0, 640);
    let [a, wide] = [path("a.json"), path("wide.json")];
    fs::write(path("broken.txt"), "0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 1\n").unwrap();
    fs::write(path("elsewhen.txt"), "9 0 0 0 0 0 0 1\n9.1 0 0 0 0 0 0 1\n9.2 0 0 0 0 0 0 1\n").unwrap();
    fs::write(path("good.txt"), "0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n0.2 0 0 0 0 0 0 1\n").unwrap();
    let [broken, elsewhen, good] = ["broken.txt", "elsewhen.txt", "good.txt"].map(path);
    let with = |estimate: &Path| {
        evcal(&[
            "evaluate",
            text(&a),
            "--truth",
            text(&a),
            "--trajectory",
            text(estimate),
            "--true-trajectory",
            text(&good),
        ])
    };
    let cases = [
        (evcal(&["evaluate", text(&a), "--truth", text(&wide)]), 1, "640x260"),
        (with(&broken), 1, "line 2"),
        (with(&broken), 1, text(&broken)),
        (with(&elsewhen), 1, "clock"),
        (with(&path("missing.txt")), 1, "missing.txt"),
        (evcal(&["evaluate", text(&a), "--truth", text(&a), "--trajectory", text(&good)]), 2, "--true-trajectory"),
    ];
    for (output, expected, part) in &cases {
        assert_eq!(code(output), *expected, "{}", stderr(output));
        assert!(stderr(output).contains(part), "{}", stderr(output));
    }
    assert!(succeed(&["evaluate", text(&a), "--truth", text(&a)]).contains("no trajectories"));

    // An empty trajectory next to a calibration does not prevent the comparison of the cameras; an empty one given by option does.
    fs::write(path("trajectory.txt"), "# t tx ty tz qx qy qz qw\n").unwrap();
    assert!(
        succeed(&["evaluate", text(&a), "--truth", text(&a)]).contains("is empty because all poses are too uncertain")
    );
    let asked = with(&path("trajectory.txt"));
    assert_eq!(code(&asked), 1);
    assert!(stderr(&asked).contains("no pose"), "{}", stderr(&asked));
}

#[test]
fn a_closed_pipe_is_not_an_error() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("a.csv");
    fs::write(&file, "t_us,x,y,p\n10,1,2,1\n20,3,4,0\n").unwrap();
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_evcal"))
        .args(["info", text(&file)])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(code(&output), 0, "{}", stderr(&output));
}

/// A build with OpenCV accepts the name, and fails only because the recording is missing.
#[test]
fn the_grid_finder_of_opencv_is_refused_by_a_build_without_it() {
    let directory = TempDir::new().unwrap();
    let (missing, folder) = (directory.path().join("missing.aedat4"), directory.path().join("calibration"));
    let board = "acircles:9x4:55mm:r17.5mm";
    let output = evcal(&["calibrate", text(&missing), "--board", board, "-o", text(&folder), "--grid", "opencv"]);
    assert_ne!(code(&output), 0);
    let refused = stderr(&output).contains("built without OpenCV: use lattice");
    assert_eq!(refused, !cfg!(feature = "opencv"), "{}", stderr(&output));
}
