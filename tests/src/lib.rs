//! What the end-to-end tests share: the program, and recordings and calibrations made once.

use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::SystemTime;
use std::{fs, io};

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::event::Event;
use event_recordings::EventReader;
use serde_json::Value;

pub mod accuracy;
pub mod lens;
pub mod readers;
pub mod values;

/// The board of all simulated recordings.
pub const BOARD: &str = "acircles:9x4:55mm:r17.5mm";

/// How a run of the program ended.
#[derive(Debug)]
pub struct Finished {
    /// Exit code; `None` after a signal.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// The program, in the profile of this test.
///
/// Cargo builds it before the tests of the workspace run, but tells its path to the tests of its own
/// package only. A program that is missing or older than its sources is refused: tests of an old
/// program say nothing.
pub fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let test = std::env::current_exe().expect("the test knows its own path");
        // target/PROFILE/deps/test, target/PROFILE/evcal.
        let profile = test.ancestors().nth(2).expect("cargo puts tests below its target folder");
        let program = profile.join(format!("evcal{}", std::env::consts::EXE_SUFFIX));
        let advice = "test the whole workspace, or build package evcal in this profile first";
        let built = modified(&program).unwrap_or_else(|error| panic!("{}: {error}: {advice}", program.display()));
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("");
        let crates = fs::read_dir(workspace.join("host")).expect("sources can be read");
        let crates = crates.map(|entry| entry.expect("sources can be read").path());
        for sources in crates.chain([workspace.join("core")]).map(|path| path.join("src")) {
            if let Some(source) = newer_source(&sources, built) {
                panic!("{} is newer than {}: {advice}", source.display(), program.display());
            }
        }
        program
    })
}

fn modified(path: &Path) -> io::Result<SystemTime> {
    fs::metadata(path)?.modified()
}

/// A source file below `folder` that was changed after `built`; modules of tests do not count.
fn newer_source(folder: &Path, built: SystemTime) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).expect("sources can be read");
    entries.map(|entry| entry.expect("sources can be read").path()).find_map(|path| {
        if path.is_dir() {
            return (!path.ends_with("tests")).then(|| newer_source(&path, built)).flatten();
        }
        let of_program = path.extension().is_some_and(|extension| extension == "rs") && !path.ends_with("tests.rs");
        (of_program && modified(&path).is_ok_and(|time| time > built)).then_some(path)
    })
}

/// Stack of the program's threads in bytes: half of what they have otherwise. A thread whose stack ends is a crash without a word.
const STACK: &str = "1048576";

/// Runs the program.
pub fn evcal(arguments: &[&str]) -> Finished {
    let mut command = Command::new(program());
    command.args(arguments).env("RUST_MIN_STACK", STACK);
    let output = command.output().expect("evcal starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("evcal prints UTF-8");
    Finished { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

impl Finished {
    /// What it said on standard error beside the stages that it came to.
    pub fn said(&self) -> Vec<&str> {
        self.stderr.lines().filter(|line| !line.ends_with(" ...")).collect()
    }
}

/// Runs the program, which must succeed and say nothing on standard error but the stages that it has come to, and returns
/// what it prints.
pub fn succeed(arguments: &[&str]) -> String {
    let finished = evcal(arguments);
    assert_eq!(finished.code, Some(0), "{arguments:?}: {}", finished.stderr);
    assert_eq!(finished.said(), [""; 0], "{arguments:?}");
    finished.stdout
}

/// What the program prints as JSON.
pub fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&succeed(arguments)).expect("evcal prints JSON")
}

/// A JSON file.
pub fn read_json(path: &Path) -> Value {
    let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The camera of `calibration.json` or `truth.json`.
pub fn camera(file: &Path) -> Camera<f64> {
    let description = &read_json(file)["camera"];
    let kind = description["model"].as_str().and_then(ModelKind::from_name).expect("a camera file names its model");
    let value = |name: &&str| description["parameters"][*name].as_f64().expect("a camera file has all parameters");
    let parameters: Vec<f64> = kind.parameter_names().iter().map(value).collect();
    Camera::from_parameters(kind, &parameters).expect("the model takes its parameters")
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("paths of tests are UTF-8")
}

/// All events of a recording.
pub fn all_events(reader: &mut EventReader) -> Vec<Event> {
    let (mut events, mut batch) = (Vec::new(), Vec::new());
    while reader.next_batch(&mut batch).expect("it is whole") {
        events.append(&mut batch);
    }
    events
}

/// The simulated session in `fixtures`, with its truth.
pub fn session() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("fixtures").join("board")
}

/// Folder of the calibration from the session's stream.
pub fn session_calibration() -> PathBuf {
    made("session", &["calibrate", text(&session().join("events.dvraw")), "--board", BOARD])
}

/// Folder of a simulated recording of 5 s in which the camera turns about one axis only, with inertial samples and motion capture.
pub fn one_axis() -> PathBuf {
    let options = ["--motion", "one-axis", "--duration", "5s", "--imu", "davis346", "--motion-capture"];
    made("one-axis", &[&["simulate", "--board", BOARD], &options[..]].concat())
}

/// The folder that the program writes when it is run with `arguments` and `-o FOLDER`. Each is made
/// once for this very program, whatever the number of tests, processes and runs.
pub fn made(name: &str, arguments: &[&str]) -> PathBuf {
    let mut hasher = DefaultHasher::new();
    arguments.hash(&mut hasher);
    let folder = shelf().join(format!("{name}-{:016x}", hasher.finish()));
    let lock = fs::File::create(folder.with_extension("lock")).expect("the target folder can be written");
    lock.lock().expect("the target folder can be locked");
    if !folder.exists() {
        let part = folder.with_extension("part");
        let _ = fs::remove_dir_all(&part);
        succeed(&[arguments, &["-o", text(&part)]].concat());
        fs::rename(&part, &folder).expect("the target folder can be written");
    }
    folder
}

/// The folder of what was [`made`] by this program; what another build made is removed.
fn shelf() -> &'static Path {
    static SHELF: OnceLock<PathBuf> = OnceLock::new();
    SHELF.get_or_init(|| {
        let mut hasher = DefaultHasher::new();
        fs::read(program()).expect("evcal can be read").hash(&mut hasher);
        let shelves = program().with_file_name("end-to-end");
        let shelf = shelves.join(format!("{:016x}", hasher.finish()));
        if !shelf.exists() {
            let _ = fs::remove_dir_all(&shelves);
        }
        fs::create_dir_all(&shelf).expect("the target folder can be written");
        shelf
    })
}
