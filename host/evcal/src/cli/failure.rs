//! Failures of subcommands.

use std::error::Error;
use std::process::ExitCode;

use evcal_calibrate::task::error::CalibrateError;
use evcal_files::remedy::{Remedy, Words};
use evcal_files::visible;
use evcal_report::output::failure;

use super::print;

/// Wrong arguments that clap does not detect; the exit code is 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}; see --help")]
pub struct UsageError(pub String);

/// The work is done and its result is negative; the exit code is 3.
#[derive(Debug, thiserror::Error)]
pub enum Negative {
    /// The finished calibration of the camera, the IMU or another camera.
    #[error(
        "the calibration is not good enough to be used; the verdict gives the reasons. With --accept-any the exit code is 0"
    )]
    Calibration,
    /// Two calibrations.
    #[error("the calibrations may be of different cameras")]
    Comparison,
    /// A recording.
    #[error("the recording is not good for a calibration; the last line above is the next step")]
    Recording,
}

/// Reason why a subcommand failed. `?` converts errors to it, with their remedies in the words of this program.
#[derive(Debug)]
pub struct Failure {
    error: Box<dyn Error + Send + Sync>,
    next: Option<String>,
    code: u8,
    /// What a calibration says about its failure, for `--json`.
    details: Option<Box<failure::Failure>>,
}

impl<E: Error + Remedy + Send + Sync + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { next: error.remedy(&Words::PROGRAM), ..Self::plain(error) }
    }
}

impl From<UsageError> for Failure {
    fn from(error: UsageError) -> Self {
        Self { code: 2, ..Self::plain(error) }
    }
}

impl From<Negative> for Failure {
    fn from(error: Negative) -> Self {
        Self { code: 3, ..Self::plain(error) }
    }
}

impl Failure {
    /// Creates the failure for an error without a remedy, or for a message.
    pub fn plain(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self { error: error.into(), next: None, code: 1, details: None }
    }

    /// Creates the failure of a calibration, which `details` and their files describe.
    pub fn of_calibration(error: &CalibrateError, details: failure::Failure) -> Self {
        let files: Vec<String> = details.files.iter().map(visible::path).collect();
        let files = if files.is_empty() { String::new() } else { format!("\n  details: {}", files.join(", ")) };
        let next = error.remedy(&Words::PROGRAM);
        Self { next, details: Some(Box::new(details)), ..Self::plain(format!("{error}{files}")) }
    }

    /// Returns `true` if the work is done and its result, which was printed, is negative.
    pub fn is_negative(&self) -> bool {
        self.code == 3
    }

    /// Returns the message and the remedy in one sentence.
    pub fn advised(&self) -> String {
        let Self { error, next, .. } = self;
        next.as_ref().map_or_else(|| error.to_string(), |next| format!("{error}; {next}"))
    }

    /// Prints the failure as JSON on standard output.
    pub fn print_json(&self) -> super::Outcome {
        match &self.details {
            Some(details) => print::json(details),
            None => print::json(&serde_json::json!({ "error": self.advised() })),
        }
    }

    /// Prints the message, its causes and the remedy; returns the exit code.
    pub fn print(&self) -> ExitCode {
        let mut printed = self.error.to_string();
        print::aside(&printed);
        let mut source = self.error.source();
        while let Some(cause) = source {
            // The text of many errors contains the text of their cause.
            let text = cause.to_string();
            if !printed.contains(&text) {
                print::detail(format_args!("  because: {text}"));
                printed = text;
            }
            source = cause.source();
        }
        if let Some(next) = &self.next {
            print::detail(format_args!("  next: {next}"));
        }
        ExitCode::from(self.code)
    }
}

#[cfg(test)]
mod tests {
    use super::super::help;
    use super::*;

    /// The table of options is in a library, which does not know them.
    #[test]
    fn the_words_of_the_program_are_its_options() {
        let command = help::command();
        let arguments = command.get_subcommands().flat_map(clap::Command::get_arguments);
        let known: Vec<&str> = arguments.filter_map(clap::Arg::get_long).collect();
        let table = format!("{:?}", Words::PROGRAM);
        let named = table.split(['"', ' ']).filter_map(|word| word.strip_prefix("--")).filter(|name| *name != "help");
        let unknown: Vec<&str> = named.clone().filter(|name| !known.contains(name)).collect();
        assert!(unknown.is_empty() && named.count() > 20, "{unknown:?}");
        assert!(!format!("{:?}", Words::PYTHON).contains("--"));
    }
}
