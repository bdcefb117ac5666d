//! Detection of the columns of a table of events and of the unit of its times, if the user does not give them.

use std::fmt;

use evcal_core::event::Polarity;
use evcal_files::remedies;

use crate::options::{Column, Columns, TimeUnit};

/// Reason why the columns of a text file or an array cannot be determined.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LayoutError {
    /// The file is not text.
    #[error("is not a text file")]
    NoText,
    /// The columns have names, but required ones are missing.
    #[error("the columns are named {0}; t, x, y and p were expected")]
    Names(String),
    /// The first line has two fields that are not a size.
    #[error("the first line, {0:?}, is neither an event nor the size of a sensor")]
    FirstLine(String),
    /// The array has no rows, or its rows were never written.
    #[error("contains no events: its array has no rows, or no row of it was written")]
    NoRows,
    /// No line consists of numbers.
    #[error("no line with numbers was found at its beginning; one line `t x y p` per event is expected")]
    NoNumbers,
    /// The columns have no names, and there are not four of them.
    #[error("it has {0} fields in a row and no names; t, x, y and p were expected")]
    FieldCount(usize),
    /// No order of columns fits the values.
    #[error("it is not clear which columns are time, x, y and polarity")]
    Unclear,
    /// An order was requested for a file with named columns.
    #[error("has named columns, so their order cannot be chosen")]
    Named,
    /// Several orders fit the values.
    #[error("the columns cannot be distinguished")]
    Ambiguous,
}

remedies! { LayoutError, say;
    Self::Names(_) | Self::FirstLine(_) | Self::FieldCount(_) | Self::Unclear | Self::Ambiguous =>
        "give its columns with {}, for example t,x,y,p", say.columns;
    Self::Named => "leave out {}", say.columns;
}

/// Number of rows that are examined.
pub const SAMPLE: usize = 2000;
/// Whole numbers above this are nanoseconds since 1970 (as microseconds they would be after the year 5000).
const LARGEST_MICROSECONDS: f64 = 1e17;
/// Whole numbers from this up to [`LARGEST_MICROSECONDS`] are microseconds since 1970 (from 2001 on).
const SINCE_1970: f64 = 1e15;
/// Fraction of times that may be less than the one before, if no other column can be the time.
const MOST_BACK: f64 = 0.1;
/// Times that are all multiples of 1000 are taken for nanoseconds if they change at least this often.
const ENOUGH_TIMES: usize = 20;

/// Two numbers that are unusual for polarities are taken for polarities if there are at least this many rows and each
/// number is in at least this fraction of them.
const ENOUGH_POLARITIES: usize = 20;
const LEAST_OF_A_POLARITY: f64 = 0.05;

/// Properties of one field of a row.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Its value, if it is a number.
    pub value: Option<f64>,
    /// `true` if it can be a polarity: 1, 0, −1 (all ones in an unsigned number), or a word for one.
    pub is_polarity: bool,
}

/// Numbers for ON and OFF in a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolarityCode {
    /// ON.
    pub on: f64,
    /// OFF.
    pub off: [f64; 2],
}

impl PolarityCode {
    /// 1 is ON, 0 and −1 are OFF.
    pub const USUAL: Self = Self { on: 1.0, off: [0.0, -1.0] };

    /// Determines the code from the first rows of a column. Of two numbers that are not the usual ones, the larger is
    /// ON, except that an unsigned number of all ones next to 1 is −1.
    pub fn from_values(column: impl Iterator<Item = Cell>, notes: &mut Vec<String>) -> Self {
        let Some(code) = two_numbers(column) else { return Self::USUAL };
        if code.off[0] < code.on {
            notes.push(format!("polarities {} and {} are taken for OFF and ON", code.off[0], code.on));
        }
        code
    }

    /// Returns the polarity that `value` stands for.
    pub fn polarity(self, value: f64) -> Option<Polarity> {
        if value == self.on { Some(Polarity::On) } else { self.off.contains(&value).then_some(Polarity::Off) }
    }
}

impl fmt::Display for PolarityCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::USUAL => f.write_str("1, 0 or -1"),
            Self { on, off: [off, _] } => write!(f, "{on} or {off}"),
        }
    }
}

/// Returns the code of a column that consists of two numbers, at least one of them unusual for a polarity.
fn two_numbers(column: impl Iterator<Item = Cell>) -> Option<PolarityCode> {
    let cells: Vec<(f64, bool)> = column.map(|cell| Some((cell.value?, cell.is_polarity))).collect::<Option<_>>()?;
    let &(off, is_off_usual) = cells.iter().min_by(|one, other| one.0.total_cmp(&other.0))?;
    let &(on, is_on_usual) = cells.iter().max_by(|one, other| one.0.total_cmp(&other.0))?;
    let count = |value: f64| cells.iter().filter(|cell| cell.0 == value).count();
    let (offs, ons) = (count(off), count(on));
    if off == on || offs + ons != cells.len() || on <= 1.0 && is_off_usual && is_on_usual {
        return None;
    }
    if off == 1.0 && is_on_usual {
        return Some(PolarityCode { on: off, off: [on; 2] });
    }
    let are_enough =
        cells.len() >= ENOUGH_POLARITIES && offs.min(ons) as f64 >= LEAST_OF_A_POLARITY * cells.len() as f64;
    are_enough.then_some(PolarityCode { on, off: [off; 2] })
}

/// Returns the content of a column with this name, and the unit if the name contains one.
pub fn of_name(name: &str) -> (Column, Option<TimeUnit>) {
    let name = event_name(name).to_lowercase();
    let mut words = name.split(|character: char| !character.is_alphanumeric()).filter(|word| !word.is_empty());
    match words.next() {
        Some("t" | "ts" | "time" | "times" | "timestamp" | "timestamps") => {
            (Column::T, words.find_map(|word| word.parse().ok()))
        }
        Some("x" | "xs") => (Column::X, None),
        Some("y" | "ys") => (Column::Y, None),
        Some("p" | "ps" | "pol" | "polarity" | "polarities" | "on") => (Column::P, None),
        _ => (Column::Ignored, None),
    }
}

/// Removes a prefix that marks a column as part of the events: `dataset_events_t` becomes `t`.
pub fn event_name(name: &str) -> &str {
    let name = name.strip_prefix("dataset_").unwrap_or(name);
    name.strip_prefix("events_").or_else(|| name.strip_prefix("event_")).unwrap_or(name)
}

/// Determines the columns by name, if t, x, y and p are all present, and the unit from the name of t.
pub fn from_names(names: &[&str]) -> (Option<Columns>, Option<TimeUnit>) {
    let known: Vec<_> = names.iter().map(|name| of_name(name)).collect();
    let unit = known.iter().filter_map(|(_, unit)| *unit).next_back();
    (Columns::new(known.into_iter().map(|(column, _)| column).collect()), unit)
}

/// Determines the columns by value: p contains only −1, 0 and 1 (apart from a few bad rows) or two other numbers, t does
/// not decrease, and x precedes y. A few decreases of t are allowed if no column is without them.
pub fn from_values(rows: &[Vec<Cell>], notes: &mut Vec<String>) -> Result<Columns, LayoutError> {
    let Some(width) = rows.first().map(Vec::len) else {
        return Err(LayoutError::NoRows);
    };
    if width != 4 {
        return Err(LayoutError::FieldCount(width));
    }
    let is_polarity = |index: usize| {
        let column = || rows.iter().filter_map(|row| row.get(index).copied());
        2 * column().filter(|cell| cell.is_polarity).count() >= rows.len() || two_numbers(column()).is_some()
    };
    let is_time = |index: usize, most_back: f64| {
        let values: Vec<f64> = rows.iter().filter_map(|row| row.get(index)?.value).collect();
        let back = values.windows(2).filter(|pair| pair[1] < pair[0]).count();
        back as f64 <= most_back * values.len() as f64 && values.first() != values.last()
    };
    // The usual order is tried first. It is also accepted if no column can be the time, for example because all times are equal.
    const ORDERS: [(usize, usize); 3] = [(0, 3), (3, 2), (2, 3)];
    let order = |most_back: f64| ORDERS.into_iter().find(|&(t, p)| is_polarity(p) && is_time(t, most_back));
    // A column of coordinates may also decrease rarely, if pixels are read out in order, so strict order is tried
    // first.
    let (t, p) = order(0.0)
        .or_else(|| order(MOST_BACK))
        .or_else(|| Some((0, 3)).filter(|&(_, p)| is_polarity(p)))
        .ok_or(LayoutError::Unclear)?;
    let mut columns = vec![Column::X; 4];
    let mut pixel = [Column::X, Column::Y].into_iter();
    for (index, slot) in columns.iter_mut().enumerate() {
        *slot = if index == t {
            Column::T
        } else if index == p {
            Column::P
        } else {
            pixel.next().unwrap_or(Column::Y)
        };
    }
    let columns = Columns::new(columns).ok_or(LayoutError::Ambiguous)?;
    notes.push(format!("the columns have no names: assumed {columns}"));
    Ok(columns)
}

/// A time unit that was determined from the values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuessedUnit {
    /// The unit.
    pub unit: TimeUnit,
    /// `true` if nanoseconds could also be microseconds.
    pub is_doubtful: bool,
}

impl From<TimeUnit> for GuessedUnit {
    fn from(unit: TimeUnit) -> Self {
        Self { unit, is_doubtful: false }
    }
}

/// Returns the unit of the times, unless it is `stated`, and the numbers for ON and OFF, from the first `rows` of a table
/// with these `columns`.
pub fn unit_and_code(
    rows: &[Vec<Cell>],
    columns: &[Column],
    stated: Option<TimeUnit>,
    notes: &mut Vec<String>,
) -> (GuessedUnit, PolarityCode) {
    let cells = |column: Column| {
        let index = columns.iter().position(|other| *other == column);
        rows.iter().filter_map(move |row| row.get(index?).copied())
    };
    let times = || cells(Column::T).filter_map(|cell| cell.value).collect::<Vec<f64>>();
    let unit = stated.map_or_else(|| unit_from_values(&times(), notes), GuessedUnit::from);
    (unit, PolarityCode::from_values(cells(Column::P), notes))
}

/// Determines the unit from the first times of a file.
fn unit_from_values(times: &[f64], notes: &mut Vec<String>) -> GuessedUnit {
    let largest = times.iter().fold(0f64, |largest, time| largest.max(time.abs()));
    let different = times.windows(2).filter(|pair| pair[0] != pair[1]).count();
    let are_thousands = different >= ENOUGH_TIMES && times.iter().all(|time| time % 1000.0 == 0.0);
    let (unit, reason) = if times.iter().any(|time| time.fract() != 0.0) {
        (TimeUnit::Seconds, "because they have decimals")
    } else if largest >= LARGEST_MICROSECONDS {
        (TimeUnit::Nanoseconds, "because of their size")
    } else if are_thousands && largest < SINCE_1970 {
        (TimeUnit::Nanoseconds, "because all are multiples of 1000")
    } else {
        (TimeUnit::Microseconds, "because they are whole numbers")
    };
    notes.push(format!("times are taken for {unit}, {reason}"));
    GuessedUnit { unit, is_doubtful: unit == TimeUnit::Nanoseconds && largest < SINCE_1970 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(rows: impl Iterator<Item = [u32; 4]>) -> String {
        let cell = |value: u32| Cell { value: Some(value.into()), is_polarity: value < 2 };
        let rows: Vec<Vec<Cell>> = rows.map(|row| row.map(cell).to_vec()).collect();
        from_values(&rows, &mut Vec::new()).map_or_else(|error| error.to_string(), |columns| columns.to_string())
    }

    /// With a sensor that is read out column by column, x decreases no more often than times that are slightly out of
    /// order.
    #[test]
    fn a_column_without_decreases_is_preferred_as_time() {
        let scan = |index: u32| [index % 320 / 4, index * 7 % 100 + 2, 5000 + index / 320, index / 3 % 2];
        assert_eq!(order((0..2000).map(scan)), "x,y,t,p");
        let scan = |index: u32| [index % 320 / 4, index * 7 % 100 + 2, index / 3 % 2, 5000 + index / 320];
        assert_eq!(order((0..2000).map(scan)), "x,y,p,t");
        // Every twentieth event has a time that is 13 too early.
        let exchanged = |index: u32| {
            let early = if index % 20 == 9 { 13 } else { 0 };
            [20 + index - early, index * 7 % 100 + 2, 50 - index % 37, 1]
        };
        assert_eq!(order((0..2000).map(exchanged)), "t,x,y,p");
    }
}
