//! Columns, rows and areas without events: of a sensor of another size, of coordinates that were scaled or counted from 1, of a region of
//! interest, or of a broken sensor.

use std::fmt;

use evcal_core::sensor::Sensor;
use event_recordings::likely_sensor::likely_sensor;
use serde::Serialize;

/// A line without events is silent if the median active line has at least this number of events.
const FEWEST_OF_LINE: u64 = 1000;
/// If this share of both the columns and the rows between active ones is silent, the coordinates were scaled.
const MANY_SILENT: f64 = 0.15;
/// Largest number of adjacent silent columns or rows if coordinates were scaled.
const LARGEST_STEP: usize = 8;
/// Number of active lines beside a silent one that are compared.
const NEIGHBOURS: usize = 8;
/// Next to a silent line, the nearest active line has at least this number of events, and this share of the mean of its
/// [`NEIGHBOURS`]. Beyond the places that a board reaches, the number decreases from line to line instead.
const FEWEST_OF_EDGE: u64 = 20;
const SHARE_OF_EDGE: f64 = 0.3;
/// Smallest number of adjacent silent lines at a border that are an area.
const AREA: usize = 8;
/// Share of a side from which, and up to which, a part of it is called a half.
const HALF: std::ops::Range<f64> = 0.4..0.6;
/// Smallest share of the sensor of a large area.
const LARGE_AREA: f64 = 0.2;
/// Smallest share of the sensor's width and height that a silent corner has.
const CORNER: f64 = 0.24;

/// Meaning of columns and rows without events.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SilentLines {
    /// All events lie on the pixels of a smaller common sensor.
    SmallerSensor {
        /// The smaller sensor.
        smaller: Sensor,
        /// Stated size of the sensor.
        stated: Sensor,
    },
    /// Columns and rows between active ones are silent everywhere: the coordinates were scaled.
    Scaled {
        /// Number of silent columns.
        columns: usize,
        /// Number of silent rows.
        rows: usize,
    },
    /// The first column or the first row is silent, or both, and all others are active: the pixels are counted from 1.
    CountedFromOne {
        /// `true` if columns are.
        columns: bool,
        /// `true` if rows are.
        rows: bool,
    },
    /// Events come from these columns and rows only, first and last: a region of interest is set, or a part of the sensor is broken.
    Region {
        /// The sensor.
        sensor: Sensor,
        /// First and last active column.
        columns: [u16; 2],
        /// First and last active row.
        rows: [u16; 2],
    },
    /// A corner of the sensor is silent.
    Corner {
        /// First and last silent column.
        columns: [u16; 2],
        /// First and last silent row.
        rows: [u16; 2],
    },
    /// Single columns and rows are silent: they are broken.
    Lines {
        /// The columns.
        columns: Vec<u16>,
        /// The rows.
        rows: Vec<u16>,
    },
}

impl SilentLines {
    /// Remedy for areas and single lines.
    pub const ADVICE: &str = "is a region of interest set, or the sensor broken?";
    /// Remedy for pixels that are counted from 1.
    pub const COUNT_FROM_ZERO: &str = "if the program that wrote the file counts from 1, subtract 1 there: otherwise the principal point is off by one pixel";

    /// Returns `true` if the sensor without events is large enough to be the reason why the board is not found, or covers little of
    /// the image.
    pub fn is_large(&self) -> bool {
        self.silent_area() >= LARGE_AREA
    }

    /// Returns the meaning of silent columns and rows, from the number of events of each pixel, row by row of `width` pixels;
    /// `None` without any, or if there are too few events.
    pub fn found(events: &[u32], width: usize) -> Option<Self> {
        let mut columns = vec![0_u64; width];
        let mut rows = Vec::new();
        for row in events.chunks_exact(width.max(1)) {
            columns.iter_mut().zip(row).for_each(|(column, count)| *column += u64::from(*count));
            rows.push(row.iter().map(|count| u64::from(*count)).sum::<u64>());
        }
        let is_active = |count: &&u64| **count > 0;
        let median = |lines: &[u64]| {
            let mut active: Vec<u64> = lines.iter().filter(is_active).copied().collect();
            active.sort_unstable();
            active.get(active.len() / 2).copied()
        };
        if median(&columns)? < FEWEST_OF_LINE || median(&rows)? < FEWEST_OF_LINE {
            return None;
        }
        let stated = Sensor::new(u16::try_from(width).ok()?, u16::try_from(rows.len()).ok()?);
        let (across, down) = (Profile::new(&columns)?, Profile::new(&rows)?);
        if let Some(smaller) = smaller_sensor(stated, &across, &down) {
            return Some(Self::SmallerSensor { smaller, stated });
        }
        if let (Some(columns), Some(rows)) = (scaled(&columns), scaled(&rows)) {
            return Some(Self::Scaled { columns, rows });
        }
        let is_first_silent = [&across, &down].map(Profile::is_only_first_silent);
        if let [columns, rows] = is_first_silent
            && (columns || rows)
            && (columns || across.is_active())
            && (rows || down.is_active())
        {
            return Some(Self::CountedFromOne { columns, rows });
        }
        if across.is_cut() || down.is_cut() {
            return Some(Self::Region { sensor: stated, columns: across.region(), rows: down.region() });
        }
        if let Some((columns, rows)) = silent_corner(events, stated) {
            return Some(Self::Corner { columns, rows });
        }
        let (columns, rows) = (across.silent(), down.silent());
        (!columns.is_empty() || !rows.is_empty()).then_some(Self::Lines { columns, rows })
    }

    /// Returns the share of the sensor without events, if it is an area.
    pub fn silent_area(&self) -> f64 {
        let length = |[first, last]: [u16; 2]| f64::from(last - first) + 1.0;
        match self {
            Self::Region { sensor, columns, rows } => {
                1.0 - length(*columns) * length(*rows) / (f64::from(sensor.width) * f64::from(sensor.height))
            }
            // A corner is a quarter or more.
            Self::Corner { .. } => 0.25,
            _ => 0.0,
        }
    }
}

/// States what is silent.
impl fmt::Display for SilentLines {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SmallerSensor { smaller, stated } => {
                write!(f, "all events lie on {smaller} of the stated {stated} pixels")
            }
            Self::Scaled { columns, rows } => write!(
                f,
                "{columns} columns and {rows} rows between others send nothing: the coordinates of the events were scaled"
            ),
            Self::CountedFromOne { columns: true, rows: true } => {
                write!(f, "column 0 and row 0 send nothing, and all others do: coordinates seem to count from 1")
            }
            Self::CountedFromOne { columns, .. } => {
                let (line, axis) = if *columns { ("column", "x") } else { ("row", "y") };
                write!(f, "{line} 0 sends nothing, and all others do: {axis} seems to count from 1")
            }
            Self::Region { sensor, columns, rows } => f.write_str(&region(*sensor, *columns, *rows)),
            Self::Corner { columns: [left, right], rows: [top, bottom] } => {
                let side = if *left == 0 { "left" } else { "right" };
                let end = if *top == 0 { "upper" } else { "lower" };
                write!(
                    f,
                    "the {end} {side} corner of the sensor sends nothing (columns {left} to {right}, rows {top} to {bottom})"
                )
            }
            Self::Lines { columns, rows } => {
                let parts: Vec<String> = [(columns, "column"), (rows, "row")]
                    .iter()
                    .filter_map(|(lines, name)| listed(lines, name))
                    .collect();
                let verb = if columns.len() + rows.len() == 1 { "sends" } else { "send" };
                write!(f, "{} of the sensor {verb} nothing", parts.join(" and "))
            }
        }
    }
}

/// Names the lines, at most eight of them.
fn listed(lines: &[u16], name: &str) -> Option<String> {
    const NAMED: usize = 8;
    let named: Vec<String> = lines.iter().take(NAMED).map(ToString::to_string).collect();
    let more = if lines.len() > NAMED { " and more" } else { "" };
    match lines.len() {
        0 => None,
        1 => Some(format!("1 {name} ({})", named.join(", "))),
        count => Some(format!("{count} {name}s ({}{more})", named.join(", "))),
    }
}

/// Describes a region by its silent side, or by its columns and rows if there are several.
fn region(sensor: Sensor, columns: [u16; 2], rows: [u16; 2]) -> String {
    let (width, height) = (sensor.width, sensor.height);
    let [left, right, top, bottom] =
        [columns[0], width - 1 - columns[1], rows[0], height - 1 - rows[1]].map(usize::from);
    let side = |place: &str, line: &str, count: usize, [first, last]: [u16; 2], all: u16| {
        let part = if HALF.contains(&(count as f64 / f64::from(all))) { "half" } else { "part" };
        format!("the {place} {part} of the sensor sends nothing ({line} {first} to {last} of {all})")
    };
    match [left, right, top, bottom] {
        [_, 0, 0, 0] => side("left", "columns", left, [0, columns[0].saturating_sub(1)], width),
        [0, _, 0, 0] => side("right", "columns", right, [columns[1] + 1, width - 1], width),
        [0, 0, _, 0] => side("upper", "rows", top, [0, rows[0].saturating_sub(1)], height),
        [0, 0, 0, _] => side("lower", "rows", bottom, [rows[1] + 1, height - 1], height),
        _ => format!(
            "only columns {} to {} and rows {} to {} of the sensor's {sensor} pixels send events",
            columns[0], columns[1], rows[0], rows[1]
        ),
    }
}

/// The numbers of events of all columns, or of all rows.
struct Profile<'a> {
    events: &'a [u64],
    /// First and last active line.
    first: usize,
    last: usize,
}

impl<'a> Profile<'a> {
    fn new(events: &'a [u64]) -> Option<Self> {
        let is_active = |count: &u64| *count > 0;
        Some(Self { events, first: events.iter().position(is_active)?, last: events.iter().rposition(is_active)? })
    }

    /// Returns `true` if active lines end abruptly at silent ones; `inner` are the active lines from there on.
    fn is_abrupt(inner: impl Iterator<Item = u64>) -> bool {
        let inner: Vec<u64> = inner.take(NEIGHBOURS).collect();
        let mean = inner.iter().sum::<u64>() as f64 / inner.len().max(1) as f64;
        inner.first().is_some_and(|&edge| edge >= FEWEST_OF_EDGE && edge as f64 >= SHARE_OF_EDGE * mean)
    }

    /// Returns `true` if the lines before the first active one are silent, rather than beyond the reach of the board.
    fn is_silent_before(&self) -> bool {
        self.first > 0 && Self::is_abrupt(self.events.iter().skip(self.first).copied())
    }

    /// Returns `true` if the lines after the last active one are silent, rather than beyond the reach of the board.
    fn is_silent_after(&self) -> bool {
        self.last + 1 < self.events.len() && Self::is_abrupt(self.events.iter().take(self.last + 1).rev().copied())
    }

    fn is_only_first_silent(&self) -> bool {
        self.first == 1
            && self.is_silent_before()
            && self.last + 1 == self.events.len()
            && self.events.iter().skip(1).all(|count| *count > 0)
    }

    fn is_active(&self) -> bool {
        self.events.iter().all(|count| *count > 0)
    }

    /// Returns `true` if many lines at a border are silent.
    fn is_cut(&self) -> bool {
        (self.first >= AREA && self.is_silent_before())
            || (self.last + AREA < self.events.len() && self.is_silent_after())
    }

    /// Returns the first and the last line that are not silent.
    fn region(&self) -> [u16; 2] {
        let first = if self.is_silent_before() { self.first } else { 0 };
        let last = if self.is_silent_after() { self.last } else { self.events.len() - 1 };
        [first, last].map(|line| u16::try_from(line).unwrap_or(u16::MAX))
    }

    /// Returns the silent lines.
    fn silent(&self) -> Vec<u16> {
        let [first, last] = self.region().map(usize::from);
        let is_silent = |line: usize| {
            // Lines beyond the reach of the board have no events either.
            line < first || line > last || (self.first..=self.last).contains(&line)
        };
        let lines = self.events.iter().enumerate().filter(|(line, count)| **count == 0 && is_silent(*line));
        lines.filter_map(|(line, _)| u16::try_from(line).ok()).collect()
    }
}

/// Returns the lines of pixels without events if most lines have many.
pub(super) fn dead_lines(events: &[u64]) -> Vec<u16> {
    let mut sorted = events.to_vec();
    sorted.sort_unstable();
    if sorted.get(sorted.len() / 2).is_none_or(|median| *median < FEWEST_OF_LINE) {
        return Vec::new();
    }
    (0..).zip(events).filter(|(_, events)| **events == 0).map(|(line, _)| line).collect()
}

/// Returns the smaller common sensor whose pixels are exactly the active ones, at the first column and at the first or the last row (if
/// rows are counted from below).
fn smaller_sensor(stated: Sensor, across: &Profile, down: &Profile) -> Option<Sensor> {
    let [column, row] = [across, down].map(|profile| u16::try_from(profile.last - profile.first).ok());
    let (column, row) = (column?, row?);
    let is_at_a_border = across.first == 0 && (down.first == 0 || down.last + 1 == down.events.len());
    let fills = |smaller: &Sensor| smaller.width == column + 1 && smaller.height == row + 1 && *smaller != stated;
    likely_sensor(column, row).filter(|smaller| is_at_a_border && fills(smaller))
}

/// Returns the first and the last silent column and row of a corner without events.
fn silent_corner(events: &[u32], sensor: Sensor) -> Option<([u16; 2], [u16; 2])> {
    let (width, height) = (usize::from(sensor.width), usize::from(sensor.height));
    for (is_right, is_lower) in [(false, false), (true, false), (false, true), (true, true)] {
        // Column and row count from the corner.
        let count = |column: usize, row: usize| {
            let x = if is_right { width.checked_sub(column + 1) } else { Some(column) };
            let y = if is_lower { height.checked_sub(row + 1) } else { Some(row) };
            x.zip(y).and_then(|(x, y)| events.get(y * width + x)).map_or(0, |count| u64::from(*count))
        };
        let silent = |row: usize| (0..width).take_while(|&column| count(column, row) == 0).count();
        let smallest = |side: usize| (CORNER * side as f64) as usize;
        let high = (0..height).take_while(|&row| silent(row) > smallest(width)).count();
        let wide = (0..high).map(silent).min().unwrap_or(0);
        if high <= smallest(height) || wide >= width || high >= height {
            continue;
        }
        let beside = (wide..width).map(|column| (0..high).map(|row| count(column, row)).sum::<u64>());
        let below = (high..height).map(|row| (0..wide).map(|column| count(column, row)).sum::<u64>());
        if !Profile::is_abrupt(beside) || !Profile::is_abrupt(below) {
            continue;
        }
        let ends = |count: usize, all: u16, is_far: bool| {
            let count = u16::try_from(count).ok()?;
            Some(if is_far { [all - count, all - 1] } else { [0, count - 1] })
        };
        return Some((ends(wide, sensor.width, is_right)?, ends(high, sensor.height, is_lower)?));
    }
    None
}

/// Returns the number of silent lines between active ones if many are silent, but nowhere more than [`LARGEST_STEP`]
/// adjacent ones.
fn scaled(lines: &[u64]) -> Option<usize> {
    let is_active = |count: &u64| *count > 0;
    let (first, last) = (lines.iter().position(is_active)?, lines.iter().rposition(is_active)?);
    let inner = lines.get(first..=last)?;
    let silent = inner.iter().filter(|count| **count == 0).count();
    let largest = inner.split(is_active).map(<[u64]>::len).max()?;
    (silent as f64 > MANY_SILENT * inner.len() as f64 && largest <= LARGEST_STEP).then_some(silent)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAVIS: Sensor = Sensor::new(346, 260);

    /// Events of a sensor whose pixel (x, y) has this number of events.
    fn counted(sensor: Sensor, count: impl Fn(u16, u16) -> u32) -> Option<SilentLines> {
        let pixels = (0..sensor.height).flat_map(|y| (0..sensor.width).map(move |x| (x, y)));
        let events: Vec<u32> = pixels.map(|(x, y)| count(x, y)).collect();
        SilentLines::found(&events, usize::from(sensor.width))
    }

    /// Events of a sensor whose pixel (x, y) has events if `is_active`.
    fn found(sensor: Sensor, is_active: impl Fn(u16, u16) -> bool) -> Option<SilentLines> {
        counted(sensor, |x, y| if is_active(x, y) { 20 } else { 0 })
    }

    fn words(sensor: Sensor, is_active: impl Fn(u16, u16) -> bool) -> String {
        found(sensor, is_active).map(|silent| silent.to_string()).unwrap_or_default()
    }

    #[test]
    fn silent_columns_and_rows_are_explained() {
        let large = Sensor::new(640, 480);
        assert_eq!(found(DAVIS, |_, _| true), None);
        let lines =
            |columns: &[u16], rows: &[u16]| Some(SilentLines::Lines { columns: columns.to_vec(), rows: rows.to_vec() });
        assert_eq!(found(DAVIS, |x, _| x != 7 && x != 90), lines(&[7, 90], &[]));
        assert_eq!(found(DAVIS, |x, y| x != 7 && y != 0 && y != 259), lines(&[7], &[0, 259]));
        assert_eq!(
            words(DAVIS, |x, y| x != 7 && y != 0 && y != 259),
            "1 column (7) and 2 rows (0, 259) of the sensor send nothing"
        );
        assert_eq!(words(DAVIS, |_, y| y != 100), "1 row (100) of the sensor sends nothing");
        let smaller = Some(SilentLines::SmallerSensor { smaller: DAVIS, stated: large });
        assert_eq!(found(large, |x, y| DAVIS.contains(x, y)), smaller);
        // Coordinates times 1.5, or 2.
        let scaled = |columns, rows| Some(SilentLines::Scaled { columns, rows });
        assert_eq!(found(Sensor::new(519, 390), |x, y| x % 3 < 2 && y % 3 < 2), scaled(172, 129));
        assert_eq!(found(DAVIS, |x, y| x % 2 == 0 && y % 2 == 0), scaled(172, 129));
    }

    /// A sensor that is only too high was not reported; with rows counted from below, its upper rows are silent.
    #[test]
    fn a_stated_sensor_with_more_rows_is_too_large() {
        let stated = Sensor::new(346, 288);
        let smaller = Some(SilentLines::SmallerSensor { smaller: DAVIS, stated });
        assert_eq!(found(stated, |_, y| y < 260), smaller);
        assert_eq!(found(stated, |_, y| y >= 28), smaller);
        assert!(matches!(found(stated, |_, y| (14..274).contains(&y)), Some(SilentLines::Region { .. })));
    }

    /// Coordinates from 1, cut at the size of the sensor, move the principal point by one pixel.
    #[test]
    fn coordinates_from_one_are_detected_although_they_were_cut_at_the_sensor() {
        let from_one = |columns, rows| Some(SilentLines::CountedFromOne { columns, rows });
        assert_eq!(found(DAVIS, |x, y| x > 0 && y > 0), from_one(true, true));
        // A broken last row as well.
        assert_ne!(found(DAVIS, |x, y| x > 0 && y > 0 && y < 259), from_one(true, true));
        // Along one axis only.
        assert_eq!(found(DAVIS, |x, _| x > 0), from_one(true, false));
        assert_eq!(found(DAVIS, |_, y| y > 0), from_one(false, true));
        let text = found(DAVIS, |_, y| y > 0).map(|lines| lines.to_string());
        assert_eq!(text.as_deref(), Some("row 0 sends nothing, and all others do: y seems to count from 1"));
        // A broken column or row as well.
        assert_ne!(found(DAVIS, |x, y| x > 0 && y != 7), from_one(true, false));
        // The board hardly reaches the border, and there is no noise: fewer and fewer events from line to line.
        let reach = |x: u16, y: u16| u32::from(x.min(y)).min(20);
        assert_eq!(counted(DAVIS, reach), None);
    }

    #[test]
    fn a_silent_area_is_named() {
        type IsActive = fn(u16, u16) -> bool;
        let cases: [(IsActive, &str); 7] = [
            (|_, y| y < 130, "the lower half of the sensor sends nothing (rows 130 to 259 of 260)"),
            (|_, y| y >= 130, "the upper half of the sensor sends nothing (rows 0 to 129 of 260)"),
            (|x, _| x < 173, "the right half of the sensor sends nothing (columns 173 to 345 of 346)"),
            (|x, _| x >= 60, "the left part of the sensor sends nothing (columns 0 to 59 of 346)"),
            (
                |x, y| (40..300).contains(&x) && (20..200).contains(&y),
                "only columns 40 to 299 and rows 20 to 199 of the sensor's 346 x 260 pixels send events",
            ),
            (
                |x, y| x >= 173 || y >= 130,
                "the upper left corner of the sensor sends nothing (columns 0 to 172, rows 0 to 129)",
            ),
            (
                |x, y| x < 240 || y < 190,
                "the lower right corner of the sensor sends nothing (columns 240 to 345, rows 190 to 259)",
            ),
        ];
        for (is_active, text) in cases {
            assert_eq!(words(DAVIS, is_active), text);
        }
        // The board is never in a corner, and there is no noise.
        let round = |x: u16, y: u16| u32::from(x + y).saturating_sub(160).min(20);
        assert_eq!(counted(DAVIS, round), None);
        let faint = |x: u16, y: u16| u32::from(x.min(y)).saturating_sub(80).min(20);
        assert_eq!(counted(DAVIS, faint), None);
    }

    #[test]
    fn few_events_do_not_make_a_line_silent() {
        assert_eq!(dead_lines(&[0, 999, 999]), [0_u16; 0]);
        assert_eq!(dead_lines(&[0, 1000, 1000]), [0]);
        assert_eq!(dead_lines(&[]), [0_u16; 0]);
        let lines = |count: u32| counted(Sensor::new(20, 15), |x, _| if x == 4 { 0 } else { count });
        assert_eq!(lines(50), None);
        assert!(lines(80).is_some());
    }
}
