//! What is wrong with the events of a recording: cause, severity, sentence and remedy of each symptom, for the verdict of a calibration
//! and for the check of a recording.

use super::{Cause, Finding, Severity};
use crate::advice::Advice;
use evcal_detection::detection::focus::EdgeWidth;
use evcal_detection::diagnosis::bad_pixels::{HotPixels, Repetition};
use evcal_detection::diagnosis::disorder::Disorder;
use evcal_detection::diagnosis::double_edges::DoubleEdges;
use evcal_detection::diagnosis::flicker::Flicker;
use evcal_detection::diagnosis::lost_events::LostEvents;
use evcal_detection::diagnosis::rounded::Rounded;
use evcal_detection::diagnosis::silent_lines::SilentLines;
use evcal_detection::diagnosis::time_steps::CoarseTimes;

/// Flicker with a larger share of events in alternating bursts of ON and OFF is a warning, because areas without edges
/// then send so many events that the readout saturates.
const STRONG_FLICKER: f64 = 0.75;

impl From<Flicker> for Finding {
    fn from(Flicker { frequency, share, fills_readout }: Flicker) -> Self {
        let (severity, reason) = if fills_readout {
            let late = "makes more events than the camera can send: their times are late";
            (Severity::Failure, format!("the light flickers at {frequency} Hz or more and {late}"))
        } else {
            let severity = if share > STRONG_FLICKER { Severity::Warning } else { Severity::Note };
            let percent = 100.0 * share;
            (
                severity,
                format!("the light flickers at {frequency} Hz, and the event rate varies with it by {percent:.0} %"),
            )
        };
        Self::new(Cause::Flicker, severity, reason, "use daylight or a lamp on direct current")
    }
}

/// Rows of symptoms with a sentence and a remedy: cause and severity of each.
macro_rules! findings {
    ($($(#[$reason:meta])* $symptom:ident => $cause:ident, $severity:ident;)*) => {$(
        $(#[$reason])*
        impl From<$symptom> for Finding {
            fn from(symptom: $symptom) -> Self {
                Self::new(Cause::$cause, Severity::$severity, symptom.to_string(), $symptom::ADVICE)
            }
        }
    )*};
}

findings! {
    HotPixels => HotPixels, Note;
    /// The same evidence counted twice makes σ too small.
    Repetition => RepeatedEvents, Warning;
    /// A camera between two cameras fits none of them.
    DoubleEdges => DoubleEdges, Failure;
    /// The uncertainty includes what they change.
    LostEvents => LostEvents, Warning;
    Disorder => OutOfOrder, Warning;
    /// Remaining distortion does not come from the lens.
    Rounded => Undistorted, Failure;
    CoarseTimes => CoarseTimes, Warning;
    EdgeWidth => Defocused, Warning;
}

impl From<&SilentLines> for Finding {
    fn from(lines: &SilentLines) -> Self {
        let (cause, severity, advice) = match lines {
            SilentLines::SmallerSensor { smaller, .. } => {
                (Cause::OtherSensorSize, Severity::Failure, Advice::NameSensor(Some(*smaller)))
            }
            SilentLines::Scaled { .. } => (Cause::Scaled, Severity::Failure, Rounded::ADVICE.into()),
            // A single silent line may be broken.
            SilentLines::CountedFromOne { columns, rows } => {
                let severity = if *columns && *rows { Severity::Failure } else { Severity::Warning };
                (Cause::CountedFromOne, severity, SilentLines::COUNT_FROM_ZERO.into())
            }
            SilentLines::Region { .. } | SilentLines::Corner { .. } => {
                let severity = if lines.is_large() { Severity::Warning } else { Severity::Note };
                (Cause::SilentArea, severity, SilentLines::ADVICE.into())
            }
            SilentLines::Lines { columns, .. } => {
                let cause = if columns.is_empty() { Cause::DeadRows } else { Cause::DeadColumns };
                (cause, Severity::Note, SilentLines::ADVICE.into())
            }
        };
        Self { cause, severity, reason: lines.to_string(), advice }
    }
}
