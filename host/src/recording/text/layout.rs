//! What the columns of a text file are: from the options, its line of names, or its values.

use super::{LayoutError, MAX_FIELDS, is_comment, number, split};
use crate::recording::{Column, Columns, MAX_SENSOR_SIZE, RecordingOptions, TimeUnit};
use evcal_core::sensor::Sensor;

/// How the lines of a file are to be read.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// The columns from left to right.
    pub columns: Columns,
    /// Unit of the time.
    pub time_unit: TimeUnit,
    /// Number of lines before the first event.
    pub first_line: u64,
    /// Width and height, if the file gives them.
    pub sensor: Option<Sensor>,
    /// What was guessed, in sentences.
    pub notes: Vec<String>,
}

/// How many lines are looked at.
const SAMPLE: usize = 2000;
/// Whole numbers above it are nanoseconds since 1970 (or, as microseconds, later than the year 5000).
const LARGEST_MICROSECONDS: f64 = 1e17;
/// From so many different times on, all multiples of 1000, they are taken for nanoseconds.
const ENOUGH_TIMES: usize = 20;

/// The parts of a file's beginning.
struct Parts<'a> {
    /// Lines before the first line of numbers.
    first_line: u64,
    names: Option<Vec<&'a str>>,
    sensor: Option<Sensor>,
    rows: Vec<Vec<&'a [u8]>>,
}

/// Finds the layout of a file that begins with `text`.
///
/// # Errors
/// [`LayoutError`], which says what is unclear and what to do.
pub fn find(text: &str, options: &RecordingOptions) -> Result<Layout, LayoutError> {
    let parts = parts(text)?;
    let mut notes = Vec::new();
    let named = parts.names.as_deref().map(columns_from_names);
    let (columns, unit_of_name) = match (&options.columns, named) {
        (Some(columns), named) => (columns.clone(), named.and_then(|(_, unit)| unit)),
        (None, Some((Some(columns), unit))) => (columns, unit),
        (None, Some((None, _))) => {
            return Err(LayoutError::Names(parts.names.unwrap_or_default().join(", ")));
        }
        (None, None) => (columns_from_values(&parts.rows, &mut notes)?, None),
    };
    let time_unit = match options.time_unit.or(unit_of_name) {
        Some(unit) => unit,
        None => unit_from_values(&times(&parts.rows, &columns), &mut notes),
    };
    Ok(Layout { columns, time_unit, first_line: parts.first_line, sensor: parts.sensor, notes })
}

fn fields(line: &str) -> Vec<&[u8]> {
    let mut fields = [&[][..]; MAX_FIELDS];
    let count = split(line.as_bytes(), &mut fields);
    fields.into_iter().take(count).collect()
}

fn parts(text: &str) -> Result<Parts<'_>, LayoutError> {
    let mut first_line = 0;
    let mut names = None;
    let mut sensor = None;
    let mut rows: Vec<Vec<&[u8]>> = Vec::new();
    for line in text.lines() {
        if rows.len() >= SAMPLE {
            break;
        }
        let line = line.trim();
        if !is_comment(line.as_bytes()) {
            let fields = fields(line);
            if fields.iter().all(|field| number::is_number(field) || number::polarity(field).is_some()) {
                // Two numbers at the very beginning are the size of the sensor.
                match (&fields[..], rows.is_empty(), sensor) {
                    ([width, height], true, None) => {
                        let size = sensor_size(width, height);
                        sensor = Some(size.ok_or_else(|| LayoutError::FirstLine(line.to_owned()))?);
                    }
                    _ => {
                        rows.push(fields);
                        continue;
                    }
                }
            } else if rows.is_empty() && names.is_none() {
                names = Some(name_list(line));
            } else {
                // A bad line among the events: the reader will name it.
                break;
            }
        } else if rows.is_empty() {
            let comment = line.trim_start_matches(['#', '%']).trim();
            if let Some(size) = sensor_comment(comment) {
                sensor = Some(size);
            }
            let list = name_list(comment);
            if columns_from_names(&list).0.is_some() {
                names = Some(list);
            }
        }
        if rows.is_empty() {
            first_line += 1;
        }
    }
    if !text.ends_with('\n') && rows.len() > 1 {
        // It may have lost digits.
        rows.pop();
    }
    Ok(Parts { first_line, names, sensor, rows })
}

fn sensor_size(width: &[u8], height: &[u8]) -> Option<Sensor> {
    let side = |field| number::pixel(field).filter(|side| (1..=MAX_SENSOR_SIZE).contains(side));
    Some(Sensor::new(side(width)?, side(height)?))
}

/// The size in a comment `sensor WIDTH x HEIGHT`.
fn sensor_comment(comment: &str) -> Option<Sensor> {
    let (width, height) = comment.strip_prefix("sensor ")?.split_once('x')?;
    sensor_size(width.trim().as_bytes(), height.trim().as_bytes())
}

/// The names in a line: with commas or semicolons if there are any, else with spaces.
fn name_list(line: &str) -> Vec<&str> {
    let names: Vec<&str> = if line.contains([',', ';', '\t']) {
        line.split([',', ';', '\t']).collect()
    } else {
        line.split_whitespace().collect()
    };
    names.into_iter().map(|name| name.trim().trim_matches('"')).collect()
}

/// The columns by their names, if t, x, y and p are all there, and the unit that the name of t gives.
fn columns_from_names(names: &[&str]) -> (Option<Columns>, Option<TimeUnit>) {
    let mut unit = None;
    let columns = names
        .iter()
        .map(|name| {
            let name = name.to_lowercase();
            let mut words = name.split(|character: char| !character.is_alphanumeric()).filter(|word| !word.is_empty());
            match words.next() {
                Some("t" | "ts" | "time" | "times" | "timestamp" | "timestamps") => {
                    unit = words.find_map(|word| word.parse().ok());
                    Column::T
                }
                Some("x") => Column::X,
                Some("y") => Column::Y,
                Some("p" | "pol" | "polarity" | "on") => Column::P,
                _ => Column::Ignored,
            }
        })
        .collect();
    (Columns::new(columns), unit)
}

/// The columns by their values: p has, but for single bad lines, no values but −1, 0 and 1, t does not
/// decrease, and x stands before y.
fn columns_from_values(rows: &[Vec<&[u8]>], notes: &mut Vec<String>) -> Result<Columns, LayoutError> {
    let Some(width) = rows.first().map(Vec::len) else {
        return Err(LayoutError::NoNumbers);
    };
    if width != 4 {
        return Err(LayoutError::FieldCount(width));
    }
    let is_polarity = |index: usize| {
        let fitting = rows.iter().filter_map(|row| number::polarity(row.get(index)?)).count();
        2 * fitting >= rows.len()
    };
    let is_time = |index: usize| {
        let values: Vec<f64> = rows.iter().filter_map(|row| number::value(row.get(index)?)).collect();
        let back = values.windows(2).filter(|pair| pair[1] < pair[0]).count();
        10 * back <= values.len() && values.first() != values.last()
    };
    // The usual order first; it is also the only one that is believed without a change of time.
    const ORDERS: [(usize, usize); 3] = [(0, 3), (3, 2), (2, 3)];
    let (t, p) = ORDERS
        .into_iter()
        .find(|&(t, p)| is_polarity(p) && is_time(t))
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

/// The times of the sample as they stand.
fn times(rows: &[Vec<&[u8]>], columns: &Columns) -> Vec<f64> {
    let Some(index) = columns.as_slice().iter().position(|&column| column == Column::T) else {
        return Vec::new();
    };
    rows.iter().filter_map(|row| number::value(row.get(index)?)).collect()
}

fn unit_from_values(times: &[f64], notes: &mut Vec<String>) -> TimeUnit {
    let largest = times.iter().fold(0f64, |largest, time| largest.max(time.abs()));
    let different = times.windows(2).filter(|pair| pair[0] != pair[1]).count();
    let (unit, reason) = if times.iter().any(|time| time.fract() != 0.0) {
        (TimeUnit::Seconds, "because they have decimals")
    } else if largest >= LARGEST_MICROSECONDS {
        (TimeUnit::Nanoseconds, "because of their size")
    } else if different >= ENOUGH_TIMES && times.iter().all(|time| time % 1000.0 == 0.0) {
        (TimeUnit::Nanoseconds, "because all are multiples of 1000")
    } else {
        (TimeUnit::Microseconds, "because they are whole numbers")
    };
    notes.push(format!("times are taken for {unit}, {reason}"));
    unit
}
