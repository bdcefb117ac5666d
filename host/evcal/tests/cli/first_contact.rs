//! The program as a new user meets it: existing results, interruptions, helpful messages.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

const BOARD: &str = "acircles:9x4:55mm:r17.5mm";

fn evcal(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_evcal")).args(arguments).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn succeed(arguments: &[&str]) -> String {
    let output = evcal(arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
    let is_stage = |line: &str| line.starts_with("evcal: ") && line.ends_with(" ...");
    assert!(stderr(&output).lines().all(is_stage), "{arguments:?}: only stages: {}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

/// Standard error of a run that ends with this exit code.
fn fail(code: i32, arguments: &[&str]) -> String {
    let output = evcal(arguments);
    let errors = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {errors}");
    errors
}

/// Exit code and standard output.
fn code_and_words(arguments: &[&str]) -> (Option<i32>, String) {
    let output = evcal(arguments);
    (output.status.code(), String::from_utf8(output.stdout).unwrap())
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A folder with a camera in `calibration.json`.
fn calibration(directory: &TempDir) -> PathBuf {
    let folder = directory.path().join("calibration");
    fs::create_dir(&folder).unwrap();
    let camera = serde_json::json!({
        "sensor": { "width": 346, "height": 260 },
        "camera": { "model": "radtan4", "parameters": {
            "fx": 300.0, "fy": 300.0, "cx": 172.5, "cy": 129.5, "k1": -0.3, "k2": 0.1, "p1": 0.0, "p2": 0.0
        } },
    });
    fs::write(folder.join("calibration.json"), camera.to_string()).unwrap();
    folder
}

#[test]
fn recordings_are_described_in_the_same_words_everywhere() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("events.txt");
    // x, y, polarity, time in ms: nothing of it can be guessed.
    let lines: String = (0..500).map(|index| format!("{} {} 1 {}\n", index % 300, index % 200, index)).collect();
    fs::write(&file, lines).unwrap();
    let described = ["--columns", "x,y,p,t", "--time-unit", "ms", "--sensor", "346x260"];
    let with = |arguments: &[&str]| evcal(&[arguments, &described].concat());
    let report = with(&["detect", text(&file), "--json"]);
    let report: serde_json::Value = serde_json::from_slice(&report.stdout).unwrap();
    assert_eq!(report["events"], 500);
    let output = directory.path().join("output");
    let calibrated = with(&["calibrate", text(&file), "--board", BOARD, "-o", text(&output)]);
    assert!(stderr(&calibrated).contains("no pattern found"), "{}", stderr(&calibrated));
    let repeated = with(&["repeat", text(&file), "--board", BOARD]);
    assert!(stderr(&repeated).contains("0.5 s long"), "{}", stderr(&repeated));
    // The program also searches for a missing stream.
    let simulation = directory.path().join("simulation");
    succeed(&["simulate", "-o", text(&simulation), "--duration", "20ms"]);
    let events = simulation.join("events.aedat4");
    for subcommand in [vec!["detect"], vec!["calibrate", "--board", BOARD, "-o", text(&output)]] {
        let errors = fail(1, &[&subcommand, &["--stream", "7", text(&events)][..]].concat());
        assert!(errors.contains("stream"), "{errors}");
    }
    assert_eq!(names(&output), ["failure.txt"], "no result is written");
}

/// One rule for all results: existing files are kept, unless --force is given.
#[test]
fn results_replace_existing_files_only_with_force() {
    let directory = tempfile::tempdir().unwrap();
    let camera = calibration(&directory);
    let events = directory.path().join("events.csv");
    let lines: String = (0..500).map(|index| format!("{},{},{},1\n", index * 100, index % 300, index % 200)).collect();
    fs::write(&events, format!("# sensor 346 x 260\nt_us,x,y,p\n{lines}")).unwrap();
    let place = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (camera, events) = (text(&camera), text(&events));
    for (arguments, name) in [
        (&["board", "--pdf"][..], "board.pdf"),
        (&["board", "--blink"], "board.html"),
        (&["export", camera, "--format", "ros", "-o"], "camera_info.yaml"),
        (&["export", camera, "--format", "all", "-o"], "exports"),
        (&["export", camera, "--c-header"], "undistort.h"),
        (&["detect", events, "-o"], "circles.csv"),
        (&["convert", events], "events.bin"),
        (&["undistort", events, "-c", camera, "-o"], "undistorted.csv"),
    ] {
        let place = place(name);
        let arguments = [arguments, &[&place]].concat();
        succeed(&arguments);
        let before = names(directory.path());
        let refused = fail(1, &arguments);
        assert!(refused.contains(name) && refused.contains("is there already"), "{refused}");
        assert!(refused.contains("--force"), "{refused}");
        succeed(&[&arguments[..], &["--force"]].concat());
        assert_eq!(names(directory.path()), before, "{arguments:?}");
    }
}

/// A pipe has no content to keep, and messages are not mixed with the events.
#[cfg(unix)]
#[test]
fn a_recording_can_go_into_a_pipe() {
    let directory = tempfile::tempdir().unwrap();
    let events = directory.path().join("events.csv");
    let lines: String = (0..500).map(|index| format!("{},{},{},1\n", index * 100, index % 300, index % 200)).collect();
    fs::write(&events, format!("# sensor 346 x 260\nt_us,x,y,p\n{lines}")).unwrap();
    let output = evcal(&["convert", text(&events), "/dev/stdout", "--to", "csv"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let written = String::from_utf8(output.stdout.clone()).unwrap();
    assert_eq!(written.lines().filter(|line| line.split(',').count() == 4 && !line.contains("t_us")).count(), 500);
    assert!(stderr(&output).contains("500 events") && !written.contains("500 events"), "{}", stderr(&output));
    let refused = evcal(&["convert", text(&events), "/dev/stdout", "--to", "aedat4"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("name a file"), "{}", stderr(&refused));
}

#[test]
fn a_calibration_can_be_given_by_its_folder() {
    let directory = tempfile::tempdir().unwrap();
    let folder = calibration(&directory);
    let file = folder.join("calibration.json");
    let export = |from: &Path| succeed(&["export", text(from), "--format", "ros"]);
    assert_eq!(export(&folder), export(&file));
    let at = |name: &str| directory.path().join(name);
    for (from, to) in [(&folder, at("a")), (&file, at("b"))] {
        succeed(&["simulate", "--camera", text(from), "-o", text(&to), "--duration", "20ms"]);
        succeed(&["undistort", text(&to.join("events.aedat4")), "-c", text(from), "-o", text(&to.join("new.csv"))]);
    }
    assert_eq!(fs::read(at("a/new.csv")).unwrap(), fs::read(at("b/new.csv")).unwrap());
    // For a folder without a calibration, the message contains the expected file.
    let errors = fail(1, &["export", text(&at("a/..").join("nothing")), "--format", "ros"]);
    assert!(errors.contains("nothing"), "{errors}");
}

#[test]
fn the_output_folder_is_checked_before_the_work() {
    // The recording is missing, too; the folder for the results is checked first.
    for folder in ["/proc/evcal", "/dev/null/evcal"] {
        let errors = fail(1, &["calibrate", "missing.dvraw", "--board", BOARD, "-o", folder]);
        assert!(errors.contains(folder) && errors.contains("-o") && !errors.contains("missing.dvraw"), "{errors}");
        let errors = fail(1, &["simulate", "-o", folder]);
        assert!(errors.contains(folder), "{errors}");
    }
}

#[test]
fn a_calibration_is_not_overwritten_by_chance() {
    let directory = tempfile::tempdir().unwrap();
    let folder = calibration(&directory);
    let before = fs::read(folder.join("calibration.json")).unwrap();
    let arguments = ["calibrate", "missing.dvraw", "--board", BOARD, "-o", text(&folder)];
    let errors = fail(1, &arguments);
    assert!(errors.contains("calibration.json is there already") && errors.contains("--force"), "{errors}");
    // A failure keeps the old result even with --force.
    let errors = fail(1, &[&arguments[..], &["--force"]].concat());
    assert!(errors.contains("missing.dvraw"), "{errors}");
    assert_eq!(fs::read(folder.join("calibration.json")).unwrap(), before);
}

/// An obstacle for the result is reported before the work, and the old result stays complete.
#[test]
fn a_result_that_cannot_be_written_is_reported_before_the_work() {
    for (wrong, is_folder, force) in [("exports", false, true), ("calibration.json", true, false)] {
        let directory = tempfile::tempdir().unwrap();
        let folder = directory.path().join("out");
        fs::create_dir(&folder).unwrap();
        let place = folder.join(wrong);
        match is_folder {
            true => fs::create_dir(&place).unwrap(),
            false => {
                fs::write(&place, "mine").unwrap();
                fs::write(folder.join("calibration.json"), "old").unwrap();
                fs::write(folder.join("report.html"), "old").unwrap();
            }
        }
        let before = names(&folder);
        // The recording is missing, too: it is not even opened.
        let mut arguments = vec!["calibrate", "missing.dvraw", "--board", BOARD, "-o", text(&folder)];
        arguments.extend(force.then_some("--force"));
        let errors = fail(1, &arguments);
        assert!(errors.contains(text(&place)) && errors.contains("move it away"), "{errors}");
        assert!(!errors.contains("missing.dvraw"), "{errors}");
        assert_eq!(names(&folder), before);
        assert_eq!(place.is_dir(), is_folder);
        if !is_folder {
            assert_eq!(fs::read_to_string(&place).unwrap(), "mine");
            assert_eq!(fs::read_to_string(folder.join("calibration.json")).unwrap(), "old");
            assert_eq!(fs::read_to_string(folder.join("report.html")).unwrap(), "old");
        }
    }
}

/// The same recording in two formats shares one camera file; the file of another camera is not overwritten.
#[test]
fn undistorted_recordings_of_one_name_share_their_camera() {
    let directory = tempfile::tempdir().unwrap();
    let folder = calibration(&directory);
    let recording = directory.path().join("events.csv");
    fs::write(&recording, "t,x,y,p\n1000,170,130,1\n2000,171,130,0\n").unwrap();
    let outputs = ["straight.csv", "straight.npz", "straight.raw"].map(|name| directory.path().join(name));
    let arguments = outputs.each_ref().map(|output| {
        let (from, camera) = (text(&recording), text(&folder));
        ["undistort", from, "-c", camera, "--time-unit", "us", "--sensor", "346x260", "-o", text(output)]
    });
    succeed(&arguments[0]);
    succeed(&arguments[1]);
    let errors = fail(1, &[&arguments[2][..], &["--alpha", "1"]].concat());
    assert!(errors.contains("straight.camera.json is there already"), "{errors}");
}

#[test]
fn a_new_simulation_leaves_nothing_of_the_old_one() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join("simulation");
    let simulate = ["simulate", "-o", text(&folder), "--duration", "50ms"];
    succeed(&[&simulate[..], &["--frames", "--imu"]].concat());
    fs::write(folder.join("notes.txt"), "mine").unwrap();
    let errors = fail(1, &simulate);
    assert!(errors.contains("is there already") && errors.contains("--force"), "{errors}");
    assert!(folder.join("frames.csv").exists());
    succeed(&[&simulate[..], &["--force", "--format", "csv"]].concat());
    assert_eq!(names(&folder), ["events.csv", "notes.txt", "trajectory.txt", "truth.json"]);
}

/// The old simulation stays complete until the new one is complete.
#[cfg(unix)]
#[test]
fn an_interrupted_simulation_leaves_the_old_one() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join("simulation");
    succeed(&["simulate", "-o", text(&folder), "--duration", "50ms", "--frames"]);
    let content =
        || names(&folder).into_iter().map(|name| (fs::read(folder.join(&name)).ok(), name)).collect::<Vec<_>>();
    let old = content();
    let longer = ["simulate", "-o", text(&folder), "--duration", "1000s", "--format", "csv", "--force"];
    end_when(&longer, "INT", || has_unfinished_bytes(&folder));
    assert_eq!(content(), old);

    // An obstacle is reported before the work.
    fs::write(folder.join("second"), "mine").unwrap();
    let errors = fail(1, &[&longer[..], &["--second-camera", "--second-frames"]].concat());
    assert!(errors.contains("second is not a folder") && errors.contains("move it away"), "{errors}");
    fs::remove_file(folder.join("second")).unwrap();
    fs::create_dir(folder.join("imu.csv")).unwrap();
    let errors = fail(1, &longer);
    assert!(errors.contains("imu.csv is a folder") && errors.contains("move it away"), "{errors}");
    fs::remove_dir(folder.join("imu.csv")).unwrap();
    assert_eq!(content(), old);
}

/// Returns whether the folder contains an unfinished file.
fn has_unfinished_bytes(folder: &Path) -> bool {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return false,
        Err(error) => panic!("{error}"),
    };
    let has_bytes = |path: &Path| path.metadata().is_ok_and(|there| there.is_file() && there.len() > 0);
    entries.map(|entry| entry.unwrap().path()).filter(|path| path.extension().is_some_and(|one| one == "part")).any(
        |path| {
            let inner = fs::read_dir(&path).into_iter().flatten().flatten().map(|entry| entry.path());
            has_bytes(&path) || inner.into_iter().any(|path| has_bytes(&path))
        },
    )
}

/// Starts the program, and ends it with a signal as soon as `begun` returns true.
#[cfg(unix)]
fn end_when(arguments: &[&str], signal: &str, begun: impl Fn() -> bool) {
    end_in_when(Path::new("."), arguments, signal, begun);
}

/// The same with the program in this folder.
#[cfg(unix)]
fn end_in_when(folder: &Path, arguments: &[&str], signal: &str, begun: impl Fn() -> bool) {
    // Under nohup, tests ignore HUP, and the program would inherit that.
    let mut command = Command::new("env");
    command.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_evcal")]).args(arguments);
    let mut child = command.current_dir(folder).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    wait_until(&mut child, begun);
    assert!(Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap().success());
    assert!(!child.wait().unwrap().success());
}

fn wait_until(child: &mut Child, begun: impl Fn() -> bool) {
    let end = Instant::now() + Duration::from_secs(300);
    while !begun() {
        assert!(child.try_wait().unwrap().is_none() && Instant::now() < end, "it ended before it could be stopped");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Starts the program, and kills it as soon as `begun` returns true.
fn kill_when(arguments: &[&str], begun: impl Fn() -> bool) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
    let mut child = command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    wait_until(&mut child, begun);
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_program_that_is_killed_leaves_no_cut_file_behind() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join("simulation");
    let arguments = ["simulate", "-o", text(&folder), "--duration", "1000s", "--format", "csv"];
    kill_when(&arguments, || has_unfinished_bytes(&folder));
    assert!(!folder.join("events.csv").exists());

    let recording = directory.path().join("recording.csv");
    let lines: String = (0..2_000_000).map(|index| format!("{index},{},{},1\n", index % 346, index % 260)).collect();
    fs::write(&recording, format!("t_us,x,y,p\n{lines}")).unwrap();
    let other = directory.path().join("other");
    fs::create_dir(&other).unwrap();
    let converted = other.join("events.bin");
    kill_when(&["convert", text(&recording), text(&converted), "--sensor", "346x260"], || has_unfinished_bytes(&other));
    assert!(!converted.exists());
    // Leftovers do not prevent the next run.
    succeed(&["convert", text(&recording), text(&converted), "--sensor", "346x260"]);
    assert_eq!(fs::metadata(&converted).unwrap().len() % 2_000_000, 0);
    assert_eq!(names(&other), ["events.bin"]);
    succeed(&["simulate", "-o", text(&folder), "--duration", "0.1s", "--format", "csv"]);
    assert!(names(&folder).iter().all(|name| !name.starts_with('.')), "{:?}", names(&folder));
}

#[cfg(unix)]
#[test]
fn a_program_that_is_interrupted_leaves_nothing() {
    let directory = tempfile::tempdir().unwrap();
    // HUP comes from a terminal that is closed, XFSZ from a file that is too large; neither was handled.
    for signal in ["INT", "TERM", "HUP", "XFSZ"] {
        let folder = directory.path().join("simulation");
        let arguments = ["simulate", "-o", text(&folder), "--duration", "1000s", "--format", "csv"];
        end_when(&arguments, signal, || fs::read_dir(&folder).into_iter().flatten().count() > 0);
        assert!(!folder.exists(), "{signal}: {:?}", names(&folder));
    }
}

/// The program removes only what it created, whatever the names of folders are.
#[cfg(unix)]
#[test]
fn an_interrupt_removes_made_folders_and_nothing_of_the_user() {
    let directory = tempfile::tempdir().unwrap();
    let simulate = |name| ["simulate", "-o", name, "--duration", "1000s", "--format", "csv"];
    for relative in ["lx", "./outer/inner", "lx.part"] {
        let folder = directory.path().join(relative);
        end_in_when(directory.path(), &simulate(relative), "INT", || has_unfinished_bytes(&folder));
        assert_eq!(names(directory.path()), [""; 0], "{relative}");
    }
    let folder = directory.path().join("mine.part");
    end_in_when(directory.path(), &simulate("mine.part"), "INT", || {
        let begun = has_unfinished_bytes(&folder);
        if begun {
            fs::write(folder.join("notes.txt"), "mine").unwrap();
        }
        begun
    });
    assert_eq!(names(&folder), ["notes.txt"]);
}

#[test]
fn a_full_disk_is_reported_with_the_file() {
    let directory = tempfile::tempdir().unwrap();
    let folder = calibration(&directory);
    let errors = fail(1, &["export", text(&folder), "--format", "ros", "-o", "/dev/full"]);
    assert!(errors.contains("/dev/full: No space left"), "{errors}");
    assert!(!fs::metadata("/dev/full").unwrap().is_file());
}

#[test]
fn shells_and_man_find_every_subcommand() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = succeed(&["completions", shell]);
        assert!(["calibrate", "undistort", "time-unit"].iter().all(|word| script.contains(word)), "{shell}");
    }
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join("man1");
    succeed(&["man", text(&folder)]);
    let pages = names(&folder);
    for name in ["evcal.1", "evcal-calibrate.1", "evcal-export.1", "evcal-man.1"] {
        assert!(pages.iter().any(|page| page == name), "{pages:?}");
    }
    let page = fs::read_to_string(folder.join("evcal-calibrate.1")).unwrap();
    assert!(page.starts_with(".ie") || page.contains(".TH"), "{page}");
    assert!(page.contains("Examples") && page.contains("\\-\\-board"), "{page}");
}

/// The recorded session in the fixtures, with a board of 9 x 4 circles with a spacing of 55 mm and a radius of 17.5 mm.
fn fixture() -> String {
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/board/events.dvraw").to_owned()
}

/// Writes events in milliseconds; read as microseconds, their rate is a thousand times too high.
fn write_milliseconds(path: &Path) {
    let lines: String = (0..50_000)
        .map(|index| format!("{:.3},{},{},1\n", f64::from(index) * 0.004, index % 346, index % 260))
        .collect();
    fs::write(path, format!("t,x,y,p\n{lines}")).unwrap();
}

#[test]
fn times_in_another_unit_are_suspected() {
    let directory = tempfile::tempdir().unwrap();
    let events = directory.path().join("events.txt");
    write_milliseconds(&events);
    let (code, checked) = code_and_words(&["check", text(&events), "--board", BOARD]);
    assert!(code == Some(3) && checked.ends_with("next: add --time-unit ms\n"), "{checked}");
    let (code, checked) = code_and_words(&["check", text(&events), "--time-unit", "ms"]);
    assert!(code == Some(3) && checked.ends_with("next: add --sensor 346x260\n"), "{checked}");
}

#[test]
fn check_prints_the_next_command() {
    let checked = succeed(&["check", &fixture(), "--board", BOARD]);
    assert!(checked.contains("flicker     none seen") && checked.contains("seen in 408 of"), "{checked}");
    assert!(
        checked.ends_with(&format!("next: evcal calibrate {} --board {BOARD} -o calibration\n", fixture())),
        "{checked}"
    );
    let (code, checked) = code_and_words(&["check", &fixture(), "--board", "acircles:4x9:55mm:r17.5mm"]);
    assert_eq!(code, Some(3));
    assert!(checked.ends_with(&format!("windows fit the board {BOARD} instead; use --board {BOARD}\n")), "{checked}");
    let checked = succeed(&["check", &fixture()]);
    assert!(checked.contains("next: the board is acircles:9x4, which fits"), "{checked}");
    assert!(checked.contains("measure the spacing (half the distance of neighbours in a row)"), "{checked}");
    let checked: serde_json::Value = serde_json::from_str(&succeed(&["check", &fixture(), "--json"])).unwrap();
    assert_eq!((&checked["events"], &checked["whole"]), (&1_947_933.into(), &true.into()));
}

#[test]
fn two_calibrations_are_compared_in_words() {
    let directory = tempfile::tempdir().unwrap();
    let folder = calibration(&directory);
    let compared = succeed(&["compare", text(&folder), text(&folder.join("calibration.json"))]);
    assert!(compared.starts_with("The same camera"), "{compared}");
    let other = directory.path().join("other");
    succeed(&["simulate", "-o", text(&other), "--duration", "20ms", "--sensor", "320x240"]);
    let errors = fail(1, &["compare", text(&folder), text(&other)]);
    assert!(errors.contains("different cameras"), "{errors}");
}

#[test]
fn exported_cameras_are_read_again() {
    let directory = tempfile::tempdir().unwrap();
    let folder = calibration(&directory);
    for format in ["opencv-yaml", "ros", "kalibr"] {
        let file = directory.path().join(format!("{format}.yaml"));
        succeed(&["export", text(&folder), "--format", format, "-o", text(&file)]);
        let figures = succeed(&["evaluate", text(&file), "--truth", text(&folder), "--json"]);
        let figures: serde_json::Value = serde_json::from_str(&figures).unwrap();
        let difference = figures["projection_difference"]["max_px"].as_f64().unwrap();
        assert!(difference < 1e-3, "{format}: {difference} px");
    }
}

#[test]
fn trajectories_of_different_recordings_are_recognised() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let simulate = |name: &str, options: &[&str]| {
        succeed(&[&["simulate", "-o", text(&at(name)), "--duration", "300ms"][..], options].concat());
    };
    simulate("one", &["--seed", "1"]);
    simulate("two", &["--seed", "2", "--motion", "fast"]);
    let figures = succeed(&["evaluate", text(&at("one")), "--truth", text(&at("two"))]);
    assert!(figures.contains("are not of the same recording") && !figures.contains("aligned mm"), "{figures}");
    let figures = succeed(&["evaluate", text(&at("one")), "--truth", text(&at("two")), "--json"]);
    let figures: serde_json::Value = serde_json::from_str(&figures).unwrap();
    assert_eq!(figures["trajectory"]["same_recording"], false);
    let figures = succeed(&["evaluate", text(&at("one")), "--truth", text(&at("one"))]);
    assert!(figures.contains("aligned mm"), "{figures}");
    // The trajectories are of different days; the cameras are compared nevertheless.
    let path = at("two/trajectory.txt");
    let later: String = fs::read_to_string(&path)
        .unwrap()
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            line.split_once(' ').map(|(t, pose)| format!("{} {pose}\n", t.parse::<f64>().unwrap() + 1e6)).unwrap()
        })
        .collect();
    fs::write(&path, later).unwrap();
    let figures = succeed(&["evaluate", text(&at("one")), "--truth", text(&at("two"))]);
    assert!(figures.contains("no times in common") && figures.contains("fx"), "{figures}");
}
