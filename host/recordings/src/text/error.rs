//! What can be wrong with a line of a text file.

use crate::counted::counted;
use crate::options::{Columns, TimeUnit};

/// No line with an event is longer (bytes).
pub(crate) const MAX_LINE: u64 = 4096;

/// Why a line is no event.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LineError {
    /// Longer than any line of an event.
    #[error("is longer than {MAX_LINE} characters; is this a text file?")]
    TooLong,
    /// More or fewer fields than columns.
    #[error("has {}, not {} ({columns})", counted(*count as u64, "field", "fields"), columns.as_slice().len())]
    FieldCount {
        /// Fields of the line.
        count: usize,
        /// The columns expected.
        columns: Columns,
    },
    /// A time that is no number.
    #[error("{field:?} is not a time in {unit}")]
    Time {
        /// What stands there.
        field: String,
        /// The unit expected.
        unit: TimeUnit,
    },
    /// A coordinate that is no whole number.
    #[error("{field:?} is not a whole pixel in {axis}; raw events are needed, not undistorted ones")]
    Pixel {
        /// What stands there.
        field: String,
        /// x or y.
        axis: &'static str,
    },
    /// A polarity that is none.
    #[error("{0:?} is not a polarity (1 for ON, 0 or -1 for OFF)")]
    Polarity(String),
}
