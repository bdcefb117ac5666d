//! Other programs that read evcal's files. `tools/setup/readers.sh` installs them.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::program;

/// Debian's Python, which has the packages that are not on PyPI.
pub const SYSTEM_PYTHON: &str = "/usr/bin/python3";

/// Returns the Python with OpenCV, PyYAML, dv-processing, rosbags, mcap and faery, below the target folder.
pub fn python() -> PathBuf {
    let target = program().ancestors().nth(2).expect("cargo puts programs below its target folder");
    let python = target.join("readers/bin/python");
    assert!(python.exists(), "{} is missing: run tools/setup/readers.sh", python.display());
    python
}

/// Runs a script in `tests/readers` with `question` as its input and returns its answer.
pub fn ask(python: &Path, script: &str, question: &Value) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("readers").join(script);
    let mut command = Command::new(python);
    command.arg(&script).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap_or_else(|error| panic!("{}: {error}", python.display()));
    let mut input = child.stdin.take().expect("standard input is piped");
    input.write_all(question.to_string().as_bytes()).expect("the script reads its input");
    drop(input);
    let output = child.wait_with_output().expect("the script ends");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{} (was tools/setup/readers.sh run?): {errors}", script.display());
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{}: {error}: {errors}", script.display()))
}

/// Runs a program that must succeed, and returns what it prints.
pub fn run(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).output();
    let output = output.unwrap_or_else(|error| panic!("{program}: {error}: run tools/setup/readers.sh"));
    assert!(output.status.success(), "{program} {arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}
