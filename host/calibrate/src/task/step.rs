//! The current step of a calibration, for progress messages.

use std::fmt;

/// The current step of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<'a> {
    /// Description.
    pub text: &'a str,
    /// Progress of the step, 0 to 1; `None` if it is not known.
    pub done: Option<f64>,
}

impl fmt::Display for Step<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text)
    }
}
