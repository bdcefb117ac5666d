//! What the columns of a table of events are, and the unit of its times, where nobody says it.

use crate::options::{Column, Columns, TimeUnit};

/// Why the columns of a text file or an array cannot be told.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LayoutError {
    /// Not a text file.
    #[error("is no text")]
    NoText,
    /// Names of which the needed ones are missing.
    #[error("the columns are named {0}, where t, x, y and p were expected")]
    Names(String),
    /// A first line of two fields that are no size.
    #[error("the first line, {0:?}, is neither an event nor the size of a sensor")]
    FirstLine(String),
    /// An array without rows, or whose rows were never written.
    #[error("holds no events: its array has no rows, or none that was written")]
    NoRows,
    /// Not one line of numbers.
    #[error("no line with numbers was found at its beginning; a line `t x y p` per event is expected")]
    NoNumbers,
    /// More or fewer fields than four, without names.
    #[error("it has {0} fields in a row and no names, where t, x, y and p were expected")]
    FieldCount(usize),
    /// No order of columns fits the values.
    #[error("it is not clear which columns are time, x, y and polarity")]
    Unclear,
    /// An order was asked for where there is nothing to put in order.
    #[error("names its columns itself, so that none can be asked for")]
    Named,
    /// Several orders fit.
    #[error("the columns cannot be told apart")]
    Ambiguous,
}

/// How many rows are looked at.
pub const SAMPLE: usize = 2000;
/// Whole numbers above it are nanoseconds since 1970 (or, as microseconds, later than the year 5000).
const LARGEST_MICROSECONDS: f64 = 1e17;
/// Whole numbers from it on, up to the next, are microseconds since 1970 (from 2001 on).
const SINCE_1970: f64 = 1e15;
/// Share of times that may be less than the one before, where nothing else can be the time.
const MOST_BACK: f64 = 0.1;
/// From so many different times on, all multiples of 1000, they are taken for nanoseconds.
const ENOUGH_TIMES: usize = 20;

/// What one field of a row can be.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Its value, if it is a number.
    pub value: Option<f64>,
    /// Whether it can be a polarity.
    pub is_polarity: bool,
}

/// What a column of this name holds, and the unit that the name gives.
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

/// The name of a column as it stands behind what says that it is one of events: `t` of `dataset_events_t`.
pub fn event_name(name: &str) -> &str {
    let name = name.strip_prefix("dataset_").unwrap_or(name);
    name.strip_prefix("events_").or_else(|| name.strip_prefix("event_")).unwrap_or(name)
}

/// The columns by their names, if t, x, y and p are all there, and the unit that the name of t gives.
pub fn from_names(names: &[&str]) -> (Option<Columns>, Option<TimeUnit>) {
    let known: Vec<_> = names.iter().map(|name| of_name(name)).collect();
    let unit = known.iter().filter_map(|(_, unit)| *unit).next_back();
    (Columns::new(known.into_iter().map(|(column, _)| column).collect()), unit)
}

/// The columns by their values: p has, but for single bad rows, no values but −1, 0 and 1, t does not
/// decrease, and x stands before y. A few steps back are allowed where no column can be t without one.
pub fn from_values(rows: &[Vec<Cell>], notes: &mut Vec<String>) -> Result<Columns, LayoutError> {
    let Some(width) = rows.first().map(Vec::len) else {
        return Err(LayoutError::NoRows);
    };
    if width != 4 {
        return Err(LayoutError::FieldCount(width));
    }
    let is_polarity = |index: usize| {
        let fitting = rows.iter().filter(|row| row.get(index).is_some_and(|cell| cell.is_polarity)).count();
        2 * fitting >= rows.len()
    };
    let is_time = |index: usize, most_back: f64| {
        let values: Vec<f64> = rows.iter().filter_map(|row| row.get(index)?.value).collect();
        let back = values.windows(2).filter(|pair| pair[1] < pair[0]).count();
        back as f64 <= most_back * values.len() as f64 && values.first() != values.last()
    };
    // The usual order first; it is also the only one that is believed without a change of time.
    const ORDERS: [(usize, usize); 3] = [(0, 3), (3, 2), (2, 3)];
    let order = |most_back: f64| ORDERS.into_iter().find(|&(t, p)| is_polarity(p) && is_time(t, most_back));
    // Pixels that are read out in their order step back seldom, too.
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
    notes.push(format!("the columns have no names: taken for {columns}"));
    Ok(columns)
}

/// A unit of times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuessedUnit {
    /// The unit.
    pub unit: TimeUnit,
    /// `true` if nanoseconds may as well be microseconds.
    pub is_doubtful: bool,
}

impl From<TimeUnit> for GuessedUnit {
    fn from(unit: TimeUnit) -> Self {
        Self { unit, is_doubtful: false }
    }
}

/// The unit of the first times of a file.
pub fn unit_from_values(times: &[f64], notes: &mut Vec<String>) -> GuessedUnit {
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

    /// With a sensor that is read out column by column x steps back no more often than times that are not quite in order. It was taken for one.
    #[test]
    fn a_column_without_a_step_back_is_the_time_rather_than_one_with_some() {
        let scan = |index: u32| [index % 320 / 4, index * 7 % 100 + 2, 5000 + index / 320, index / 3 % 2];
        assert_eq!(order((0..2000).map(scan)), "x,y,t,p");
        let scan = |index: u32| [index % 320 / 4, index * 7 % 100 + 2, index / 3 % 2, 5000 + index / 320];
        assert_eq!(order((0..2000).map(scan)), "x,y,p,t");
        // Of every twentieth pair of events the second came first.
        let exchanged = |index: u32| {
            let early = if index % 20 == 9 { 13 } else { 0 };
            [20 + index - early, index * 7 % 100 + 2, 50 - index % 37, 1]
        };
        assert_eq!(order((0..2000).map(exchanged)), "t,x,y,p");
    }
}
