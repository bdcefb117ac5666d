//! What can be wrong with a text file.

use super::MAX_LINE;
use crate::recording::{Columns, TimeUnit};

const ASK: &str = "say what the columns are, for example `t,x,y,p`";

/// Why the columns of a text file cannot be told.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LayoutError {
    /// Not a text file.
    #[error("is no text")]
    NoText,
    /// Names of which the needed ones are missing.
    #[error("the columns are named {0}, where t, x, y and p were expected; {ASK}")]
    Names(String),
    /// A first line of two fields that are no size.
    #[error("the first line, {0:?}, is neither an event nor the size of a sensor; {ASK}")]
    FirstLine(String),
    /// Not one line of numbers.
    #[error("no line with numbers was found at its beginning; a line `t x y p` per event is expected")]
    NoNumbers,
    /// More or fewer fields than four, without names.
    #[error("its lines have {0} fields and no names, where t, x, y and p were expected; {ASK}")]
    FieldCount(usize),
    /// No order of columns fits the values.
    #[error("it is not clear which columns are time, x, y and polarity; {ASK}")]
    Unclear,
    /// Several orders fit.
    #[error("the columns cannot be told apart; {ASK}")]
    Ambiguous,
}

/// Why a line is no event.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LineError {
    /// Longer than any line of an event.
    #[error("is longer than {MAX_LINE} characters; is this a text file?")]
    TooLong,
    /// More or fewer fields than columns.
    #[error("has {count} fields, not {} ({columns})", columns.as_slice().len())]
    FieldCount {
        /// Fields of the line.
        count: usize,
        /// The columns expected.
        columns: Columns,
    },
    /// A time that is no number.
    #[error("{field:?} is no time in {unit}")]
    Time {
        /// What stands there.
        field: String,
        /// The unit expected.
        unit: TimeUnit,
    },
    /// A coordinate that is no whole number.
    #[error("{field:?} is no whole pixel in {axis}; raw events are needed, not undistorted ones")]
    Pixel {
        /// What stands there.
        field: String,
        /// x or y.
        axis: &'static str,
    },
    /// A polarity that is none.
    #[error("{0:?} is no polarity (1 for ON, 0 or -1 for OFF)")]
    Polarity(String),
}
