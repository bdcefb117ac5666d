//! Standard output, where a reader may leave early (`evcal info … | head`).

use std::fmt::Display;
use std::io::{ErrorKind, Write};

use serde::Serialize;

/// Prints `text` and a line end. A reader that has left is no error.
pub fn line(text: impl Display) -> super::Outcome {
    match writeln!(std::io::stdout().lock(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(format!("standard output: {error}").into()),
        _ => Ok(()),
    }
}

/// Prints `value` as JSON on one line.
pub fn json(value: &impl Serialize) -> super::Outcome {
    line(serde_json::to_string(value)?)
}

/// Prints `text`, which has its own line ends. A reader that has left is no error.
pub fn text(text: &str) -> super::Outcome {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(format!("standard output: {error}").into()),
        _ => Ok(()),
    }
}

/// Prints what is not part of the output, on standard error. Nobody need listen.
pub fn aside(text: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "evcal: {text}");
}
