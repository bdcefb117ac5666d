//! Printing to standard output, whose reader may close the pipe early (`evcal info … | head`), and to standard error. Control characters from
//! files never reach a terminal: see [`visible`].

use std::fmt::Display;
use std::io::{self, ErrorKind, IsTerminal as _, Write};

use evcal_files::visible;
use serde::Serialize;

/// Prints `text` and a line end. A closed pipe is not an error.
pub fn line(text: impl Display) -> super::Outcome {
    styled(visible::lines(&text.to_string()))
}

/// Prints as [`line`] does, but keeps colours of the program. Untrusted parts of `text` must have been made [`visible`] before.
pub fn styled(text: impl Display) -> super::Outcome {
    written(writeln!(io::stdout().lock(), "{text}"))
}

/// Prints `value` as JSON on one line.
pub fn json(value: &impl Serialize) -> super::Outcome {
    line(serde_json::to_string(value)?)
}

/// Prints `text` without adding a line end. Control characters are escaped only if standard output is a terminal. A
/// closed pipe is not an error.
pub fn text(text: &str) -> super::Outcome {
    let mut output = io::stdout().lock();
    written(match output.is_terminal() {
        true => output.write_all(visible::lines(text).as_bytes()),
        false => output.write_all(text.as_bytes()),
    })
}

fn written(written: io::Result<()>) -> super::Outcome {
    match written {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(format!("standard output: {error}").into()),
        _ => Ok(()),
    }
}

/// Prints a message on standard error; ignores errors.
pub fn aside(text: impl Display) {
    detail(format_args!("evcal: {text}"));
}

/// Prints a line that continues the previous message on standard error.
pub fn detail(text: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{}", visible::lines(&text.to_string()));
}
