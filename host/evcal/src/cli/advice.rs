//! Advice about errors, with options of the command line. The libraries return errors as data; advice depends on their caller.
//!
//! [`advice`] searches the chain of causes. An enum that wraps another error must therefore return it as its source: use
//! `#[error("{0}")]`, because `#[error(transparent)]` skips the wrapped error.

pub mod calibrate;
mod recordings;

use std::error::Error;

/// Returns the advice for the first error in the chain of causes of `error` that a module here knows.
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

/// Returns `error` and its advice in one sentence.
pub fn with_advice(error: &(dyn Error + 'static)) -> String {
    match advice(error) {
        Some(next) => format!("{error}; {next}"),
        None => error.to_string(),
    }
}
