//! Shared parts of the end-to-end tests: running the program, and recordings and calibrations that are made once.

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

/// Exit code and output of a run of the program.
#[derive(Debug)]
pub struct Finished {
    /// Exit code; `None` after a signal.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// Returns the path of the program, built in the profile of this test.
///
/// Cargo builds it before the tests of the workspace run, but passes its path only to the tests of its own package. Panics if
/// the program is missing or older than its sources, because tests of an old program prove nothing.
pub fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let test = std::env::current_exe().expect("the test knows its own path");
        // target/PROFILE/deps/test, target/PROFILE/evcal.
        let profile = test.ancestors().nth(2).expect("cargo puts tests below its target folder");
        let program = profile.join(format!("evcal{}", std::env::consts::EXE_SUFFIX));
        let advice = "test the whole workspace, or build package evcal in this profile first";
        let built = modified(&program).unwrap_or_else(|error| panic!("{}: {error}: {advice}", program.display()));
        let crates = fs::read_dir(workspace().join("host")).expect("sources can be read");
        let crates = crates.map(|entry| entry.expect("sources can be read").path());
        for sources in crates.chain([workspace().join("core")]).map(|path| path.join("src")) {
            let newer = |source: &PathBuf| modified(source).is_ok_and(|time| time > built);
            if let Some(source) = sources_in(&sources).into_iter().find(newer) {
                panic!("{} is newer than {}: {advice}", source.display(), program.display());
            }
        }
        program
    })
}

fn modified(path: &Path) -> io::Result<SystemTime> {
    fs::metadata(path)?.modified()
}

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("")
}

/// Returns the source files of the program below `path`, in alphabetical order. Test modules are ignored.
fn sources_in(path: &Path) -> Vec<PathBuf> {
    if path.is_dir() {
        let entries = fs::read_dir(path).expect("sources can be read");
        let mut entries: Vec<PathBuf> = entries.map(|entry| entry.expect("sources can be read").path()).collect();
        entries.retain(|entry| !entry.ends_with("tests"));
        entries.sort();
        return entries.iter().flat_map(|entry| sources_in(entry)).collect();
    }
    let of_program = path.extension().is_some_and(|extension| extension == "rs") && !path.ends_with("tests.rs");
    if of_program { vec![path.to_owned()] } else { Vec::new() }
}

/// Stack of the program's threads in bytes, half of the default. A stack overflow crashes without a message.
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
    /// Lines on standard error, except the names of stages in progress.
    pub fn messages(&self) -> Vec<&str> {
        self.stderr.lines().filter(|line| !line.ends_with(" ...")).collect()
    }
}

/// Runs the program and returns its standard output. The program must succeed and write nothing on standard error except the
/// stages in progress.
pub fn succeed(arguments: &[&str]) -> String {
    let finished = evcal(arguments);
    assert_eq!(finished.code, Some(0), "{arguments:?}: {}", finished.stderr);
    assert_eq!(finished.messages(), [""; 0], "{arguments:?}");
    finished.stdout
}

/// Runs the program and returns the JSON that it prints.
pub fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&succeed(arguments)).expect("evcal prints JSON")
}

/// Reads a JSON file.
pub fn read_json(path: &Path) -> Value {
    let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Reads the camera of `calibration.json` or `truth.json`.
pub fn camera(file: &Path) -> Camera<f64> {
    let description = &read_json(file)["camera"];
    let kind = description["model"].as_str().and_then(ModelKind::from_name).expect("a camera file names its model");
    let value = |name: &&str| description["parameters"][*name].as_f64().expect("a camera file has all parameters");
    let parameters: Vec<f64> = kind.parameter_names().iter().map(value).collect();
    Camera::from_parameters(kind, &parameters).expect("the model takes its parameters")
}

/// Returns a path as an argument of the program.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("paths of tests are UTF-8")
}

/// Reads all events of a recording.
pub fn all_events(reader: &mut EventReader) -> Vec<Event> {
    let (mut events, mut batch) = (Vec::new(), Vec::new());
    while reader.next_batch(&mut batch).expect("the recording is undamaged") {
        events.append(&mut batch);
    }
    events
}

/// Folder of the simulated session in `fixtures`, with its ground truth.
pub fn session() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("fixtures").join("board")
}

/// Folder of the calibration from the session's stream.
pub fn session_calibration() -> PathBuf {
    made("session", &["calibrate", text(&session().join("events.dvraw")), "--board", BOARD])
}

/// Folder of a simulated recording of 5 s in which the camera rotates about one axis only, with IMU samples and motion capture.
pub fn one_axis() -> PathBuf {
    let options = ["--motion", "one-axis", "--duration", "5s", "--imu", "davis346", "--motion-capture"];
    made("one-axis", &[&["simulate", "--board", BOARD], &options[..]].concat())
}

/// Returns the folder that the program writes when it is run with `arguments` and `-o FOLDER`. Each folder is made once and
/// shared by all tests, processes and runs: a simulated recording until a source changes that determines it, any other result
/// until the program changes.
pub fn made(name: &str, arguments: &[&str]) -> PathBuf {
    let mut hasher = DefaultHasher::new();
    arguments.hash(&mut hasher);
    let simulated = arguments.first() == Some(&"simulate");
    let cache = if simulated { simulated_folder() } else { calculated_folder() };
    let folder = cache.join(format!("{name}-{:016x}", hasher.finish()));
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

/// Files and folders that determine the bytes of a simulated recording: the simulator, the board, the writers of recordings, the
/// settings files of the tests, and the versions of all dependencies.
const SOURCES_OF_RECORDINGS: [&str; 8] = [
    "Cargo.lock",
    "core/src",
    "host/evcal/src/cli/simulate.rs",
    "host/geometry/src",
    "host/recordings/src",
    "host/simulator/src",
    "tests/tests/calibration/rolling-shutter.json",
    "usb-davis/src",
];

/// Returns the folder that contains the simulated recordings of [`made`].
fn simulated_folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let paths = SOURCES_OF_RECORDINGS.map(|path| workspace().join(path));
        let files = paths.iter().flat_map(|path| if path.is_dir() { sources_in(path) } else { vec![path.clone()] });
        cache_folder(&program().with_file_name("simulated"), files)
    })
}

/// Returns the folder that contains the other results of [`made`].
fn calculated_folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| cache_folder(&program().with_file_name("end-to-end"), [program().to_owned()]))
}

/// Returns a folder in `parent` for what these files determine. Removes the folders for other contents of the files.
fn cache_folder(parent: &Path, files: impl IntoIterator<Item = PathBuf>) -> PathBuf {
    let mut hasher = DefaultHasher::new();
    for file in files {
        let bytes = fs::read(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        bytes.hash(&mut hasher);
    }
    let folder = parent.join(format!("{:016x}", hasher.finish()));
    if !folder.exists() {
        let _ = fs::remove_dir_all(parent);
    }
    fs::create_dir_all(&folder).expect("the target folder can be written");
    folder
}
