//! Runs of the program.

use std::path::Path;
use std::process::{Command, Output};

use crate::printed_commands::assert_accepted;

/// Runs the program with these arguments. The program must accept the commands that it prints.
pub fn evcal(arguments: &[&str]) -> Output {
    let output = Command::new(env!("CARGO_BIN_EXE_evcal")).args(arguments).output().unwrap();
    assert_accepted(&output);
    output
}

/// Its standard error.
pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Standard output of a run that succeeds.
pub fn succeed(arguments: &[&str]) -> String {
    let output = evcal(arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

/// Standard error of a run that fails.
pub fn fail(arguments: &[&str]) -> String {
    let output = evcal(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    stderr(&output)
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
