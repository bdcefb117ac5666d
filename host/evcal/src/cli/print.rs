//! Standard output, where a reader may leave early (`evcal info … | head`), and standard error. Nothing that comes from a file reaches
//! a terminal as a control character: see [`visible`].

use std::fmt::Display;
use std::io::{self, ErrorKind, IsTerminal as _, Write};

use evcal_files::visible;
use serde::Serialize;

/// Prints `text` and a line end. A reader that has left is no error.
pub fn line(text: impl Display) -> super::Outcome {
    styled(visible::lines(&text.to_string()))
}

/// As [`line`], of a text with colours of the program's own. What is in it from outside must have been made [`visible`] before.
pub fn styled(text: impl Display) -> super::Outcome {
    written(writeln!(io::stdout().lock(), "{text}"))
}

/// Prints `value` as JSON on one line.
pub fn json(value: &impl Serialize) -> super::Outcome {
    line(serde_json::to_string(value)?)
}

/// Prints `text`, which has its own line ends, as it is unless somebody looks at it. A reader that has left is no error.
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

/// Prints what is not part of the output, on standard error. Nobody need listen.
pub fn aside(text: impl Display) {
    detail(format_args!("evcal: {text}"));
}

/// Prints a line that belongs to the one before it on standard error.
pub fn detail(text: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{}", visible::lines(&text.to_string()));
}
