//! Advice on columns, rows and areas without events.

use crate::advice::Advice;
use evcal_detection::diagnosis::rounded::Rounded;
use evcal_detection::diagnosis::silent_lines::SilentLines;

/// Advice on silent lines and areas.
pub const IS_IT_BROKEN: &str = "is a region of interest set, or the sensor broken?";

/// Returns the advice on silent lines.
pub fn silent_advice(lines: &SilentLines) -> Advice {
    match lines {
        SilentLines::SmallerSensor { smaller, .. } => Advice::NameSensor(Some(*smaller)),
        SilentLines::Scaled { .. } => Rounded::ADVICE.into(),
        SilentLines::CountedFromOne { .. } => {
            "if the program that wrote the file counts from 1, subtract 1 there: otherwise the principal point is off by one pixel".into()
        }
        SilentLines::Region { .. } | SilentLines::Corner { .. } | SilentLines::Lines { .. } => IS_IT_BROKEN.into(),
    }
}
