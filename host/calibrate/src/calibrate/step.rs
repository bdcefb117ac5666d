//! What is going on, for somebody who waits.

use std::fmt;

/// What a calibration is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<'a> {
    /// In words.
    pub text: &'a str,
    /// Which part of it is done, 0 to 1; `None` where that is not known.
    pub done: Option<f64>,
}

impl fmt::Display for Step<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text)
    }
}
