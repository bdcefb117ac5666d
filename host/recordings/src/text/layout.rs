//! Detection of the columns of a text file: from the options, its header line, or its values.

use super::{Fields, is_comment, number};
use crate::columns::{self, Cell, GuessedUnit, LayoutError, PolarityCode, SAMPLE};
use crate::options::{Columns, RecordingOptions, TimeUnit};
use crate::reader::MAX_SENSOR_SIZE;
use evcal_core::sensor::Sensor;

/// Layout of the lines of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// The columns from left to right.
    pub columns: Columns,
    /// Unit of the times.
    pub time_unit: TimeUnit,
    /// `true` if nanoseconds were guessed and could also be microseconds.
    pub is_unit_doubtful: bool,
    /// Numbers for ON and OFF.
    pub code: PolarityCode,
    /// Number of lines before the first event.
    pub first_line: u64,
    /// Width and height of the sensor, if the file contains them.
    pub sensor: Option<Sensor>,
    /// Guesses, in sentences.
    pub notes: Vec<String>,
}

/// Parts of the beginning of a file.
struct Parts<'a> {
    /// Number of lines before the first line of numbers.
    first_line: u64,
    names: Option<Vec<&'a str>>,
    /// Unit of the times, if the title has it after the names.
    unit: Option<TimeUnit>,
    sensor: Option<Sensor>,
    rows: Vec<Vec<&'a [u8]>>,
}

/// Determines the layout of a file that begins with `text`.
///
/// # Errors
/// [`LayoutError`] if the columns are unclear.
pub fn find(text: &str, options: &RecordingOptions) -> Result<Layout, LayoutError> {
    let parts = parts(text)?;
    let rows: Vec<Vec<Cell>> = parts.rows.iter().map(|row| row.iter().map(cell).collect()).collect();
    let mut notes = Vec::new();
    let named = parts.names.as_deref().map(columns::from_names);
    let (columns, unit_of_name) = match (&options.columns, named) {
        (Some(columns), named) => (columns.clone(), named.and_then(|(_, unit)| unit)),
        (None, Some((Some(columns), unit))) => (columns, unit),
        (None, Some((None, _))) => {
            return Err(LayoutError::Names(parts.names.unwrap_or_default().join(", ")));
        }
        (None, None) if parts.rows.is_empty() => return Err(LayoutError::NoNumbers),
        (None, None) => (columns::from_values(&rows, &mut notes)?, None),
    };
    let stated = options.time_unit.or(parts.unit).or(unit_of_name);
    let (GuessedUnit { unit: time_unit, is_doubtful }, code) =
        columns::unit_and_code(&rows, columns.as_slice(), stated, &mut notes);
    let Parts { first_line, sensor, .. } = parts;
    Ok(Layout { columns, time_unit, is_unit_doubtful: is_doubtful, code, first_line, sensor, notes })
}

/// `true` if a line of `text` names the columns of events.
pub fn is_named(text: &str) -> bool {
    text.lines().any(|line| columns::from_names(&name_list(line)).0.is_some())
}

fn parts(text: &str) -> Result<Parts<'_>, LayoutError> {
    let mut first_line = 0;
    let mut names = None;
    let mut unit = None;
    let mut sensor = None;
    let mut rows: Vec<Vec<&[u8]>> = Vec::new();
    for line in text.lines() {
        if rows.len() >= SAMPLE {
            break;
        }
        let line = line.trim();
        if !is_comment(line.as_bytes()) {
            let fields: Vec<&[u8]> = Fields::of(line.as_bytes()).collect();
            if is_row(&fields) {
                // Two numbers before the first event are the size of the sensor.
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
                let mut list = name_list(line);
                if let Some((time_unit, size)) = end_of_title(&list) {
                    list.truncate(4);
                    (unit, sensor) = (Some(time_unit), Some(size));
                }
                sensor = sensor.or_else(|| sensor_of_names(&list));
                names = Some(list);
            } else {
                // An invalid line among the events, which the reader reports.
                break;
            }
        } else if rows.is_empty() {
            let comment = line.trim_start_matches(['#', '%']).trim();
            if let Some(size) = sensor_comment(comment) {
                sensor = Some(size);
            }
            let list = name_list(comment);
            if columns::from_names(&list).0.is_some() {
                sensor = sensor.or_else(|| sensor_of_names(&list));
                names = Some(list);
            }
        }
        if rows.is_empty() {
            first_line += 1;
        }
    }
    if !text.ends_with('\n') && rows.len() > 1 {
        // The last line is incomplete and may have lost digits.
        rows.pop();
    }
    Ok(Parts { first_line, names, unit, sensor, rows })
}

/// Returns `true` if these fields are an event and not a header. Fields of unused columns may be empty, except the
/// first field: a line that begins with an empty field is a header whose first column has no name and contains row
/// numbers, as pandas writes it.
fn is_row(fields: &[&[u8]]) -> bool {
    let is_number = |field: &[u8]| number::is_number(field) || number::polarity(field, PolarityCode::USUAL).is_some();
    fields.first().is_none_or(|first| is_number(first))
        && fields.iter().all(|field| field.is_empty() || is_number(field))
}

fn sensor_size(width: &[u8], height: &[u8]) -> Option<Sensor> {
    let side = |field| number::pixel(field).filter(|side| (1..=MAX_SENSOR_SIZE).contains(side));
    Some(Sensor::new(side(width)?, side(height)?))
}

/// Returns the unit of the times and the size of the sensor in evcal's title, `t,x,y,p,us,346x260`.
fn end_of_title(names: &[&str]) -> Option<(TimeUnit, Sensor)> {
    let ["t", "x", "y", "p", unit, size] = names else { return None };
    let (width, height) = size.split_once('x')?;
    Some((unit.parse().ok()?, sensor_size(width.as_bytes(), height.as_bytes())?))
}

/// Returns the size in names such as `x@346` and `y@260`, as faery writes them.
fn sensor_of_names(names: &[&str]) -> Option<Sensor> {
    let side = |axis| names.iter().find_map(|name| name.strip_prefix(axis)?.strip_prefix('@'));
    sensor_size(side("x")?.as_bytes(), side("y")?.as_bytes())
}

/// Parses the size in a comment `sensor WIDTH x HEIGHT`, or `geometry:WIDTH,HEIGHT` as Prophesee's programs write it.
fn sensor_comment(comment: &str) -> Option<Sensor> {
    let of_sensor = || comment.strip_prefix("sensor ")?.split_once('x');
    let of_geometry = || comment.strip_prefix("geometry:")?.split_once([',', 'x']);
    let (width, height) = of_sensor().or_else(of_geometry)?;
    sensor_size(width.trim().as_bytes(), height.trim().as_bytes())
}

/// Splits a line into names, at commas, semicolons and tabs if there are any, else at spaces.
fn name_list(line: &str) -> Vec<&str> {
    let names: Vec<&str> = if line.contains([',', ';', '\t']) {
        line.split([',', ';', '\t']).collect()
    } else {
        line.split_whitespace().collect()
    };
    names.into_iter().map(|name| name.trim().trim_matches('"')).collect()
}

fn cell(field: &&[u8]) -> Cell {
    Cell { value: number::value(field), is_polarity: number::polarity(field, PolarityCode::USUAL).is_some() }
}
