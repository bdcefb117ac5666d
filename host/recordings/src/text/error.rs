//! Faults of a line in a text file.

use crate::counted::counted;
use crate::options::{Columns, TimeUnit};

/// Length limit of a line in bytes.
pub(crate) const MAX_LINE: u64 = 4096;

/// Reason why a line is not an event.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LineError {
    /// The line is too long.
    #[error("is longer than {MAX_LINE} characters; is this a text file?")]
    TooLong,
    /// The number of fields differs from the number of columns.
    #[error("has {}, not {} ({columns})", counted(*count as u64, "field", "fields"), columns.as_slice().len())]
    FieldCount {
        /// Number of fields in the line.
        count: usize,
        /// Expected columns.
        columns: Columns,
    },
    /// The time is not a number.
    #[error("{field:?} is not a time in {unit}")]
    Time {
        /// Text of the field.
        field: String,
        /// Expected unit.
        unit: TimeUnit,
    },
    /// A coordinate is not a whole number.
    #[error("{field:?} is not a whole pixel in {axis}; raw events are needed, not undistorted ones")]
    Pixel {
        /// Text of the field.
        field: String,
        /// `x` or `y`.
        axis: &'static str,
    },
    /// The polarity is invalid.
    #[error("{field:?} is not a polarity ({known})")]
    Polarity {
        /// Text of the field.
        field: String,
        /// Numbers for ON and OFF.
        known: String,
    },
}
