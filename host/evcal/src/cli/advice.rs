//! What to do about an error, in the words of the command line. The libraries say what is wrong, as data; what to do next depends
//! on who called them.
//!
//! An error is looked for along its chain of causes: an enum that wraps another error has it as its source, for which
//! `#[error("{0}")]` serves and `#[error(transparent)]` does not, since that passes over the wrapped error.

pub mod calibrate;
mod recordings;

use std::error::Error;

/// The one thing to do next about `error`, if there is one to name: about the first error of its chain of causes that one of the
/// modules here knows.
pub fn advice(error: &(dyn Error + 'static)) -> Option<String> {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(next) = recordings::advice(error).or_else(|| calibrate::advice(error)) {
            return Some(next);
        }
        cause = error.source();
    }
    None
}

/// `error` and what to do about it, in one sentence.
pub fn with_advice(error: &(dyn Error + 'static)) -> String {
    match advice(error) {
        Some(next) => format!("{error}; {next}"),
        None => error.to_string(),
    }
}
