//! Parsing a circle track.

use std::collections::BTreeMap;
use std::fmt::Write;

use evcal_core::pattern::Pattern;
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

use super::{CircleFrames, CircleLineError, CircleTrack, CircleTrackErrorKind, TrackSource, describe};
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn, UnorderedCircle, UnorderedFrame};

/// Time between successive circles (s) from which they belong to different frames.
const FRAME_GAP: f64 = 0.005;
/// Time (s) from which times get an origin of their own.
const LARGEST_TIME: f64 = 1e6;

/// Quantity of a column, with the factor that converts its numbers to seconds, pixels or pixels per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Quantity {
    Time,
    X,
    Y,
    Column,
    Row,
    Frame,
    Radius,
    Start,
    End,
    VelocityX,
    VelocityY,
}

const SEPARATORS: [char; 3] = [',', ';', '\t'];

/// Returns the quantity of a column name, and the divisor of its numbers.
fn quantity(name: &str) -> Option<(Quantity, f64)> {
    Some(match name.trim().to_lowercase().as_str() {
        "t_s" => (Quantity::Time, 1.0),
        "t_us" => (Quantity::Time, 1e6),
        "x_px" => (Quantity::X, 1.0),
        "y_px" => (Quantity::Y, 1.0),
        "column" | "col" => (Quantity::Column, 1.0),
        "row" => (Quantity::Row, 1.0),
        "frame" => (Quantity::Frame, 1.0),
        "radius_px" => (Quantity::Radius, 1.0),
        "t_start_s" => (Quantity::Start, 1.0),
        "t_start_us" => (Quantity::Start, 1e6),
        "t_end_s" => (Quantity::End, 1.0),
        "t_end_us" => (Quantity::End, 1e6),
        "vx_px_per_s" => (Quantity::VelocityX, 1.0),
        "vx_px_per_us" => (Quantity::VelocityX, 1e-6),
        "vy_px_per_s" => (Quantity::VelocityY, 1.0),
        "vy_px_per_us" => (Quantity::VelocityY, 1e-6),
        _ => return None,
    })
}

/// Returns `true` if `text`, the beginning of a file, has the line of names of a circle track.
pub fn is_circle_track(text: &str) -> bool {
    let names = text.lines().find(|line| !is_comment(line)).unwrap_or_default();
    let has = |wanted| {
        let mut quantities = names.split(SEPARATORS).filter_map(quantity);
        quantities.any(|(quantity, _)| quantity == wanted)
    };
    (has(Quantity::Time) || has(Quantity::Frame)) && has(Quantity::X) && has(Quantity::Y) || has_corners(text)
}

/// Returns `true` if `text` has the legend of mrcal's files of corners.
fn has_corners(text: &str) -> bool {
    text.lines().find_map(legend).is_some()
}

/// Returns the columns of filename, x and y in the legend of a file of corners: a comment with the names of the columns.
fn legend(line: &str) -> Option<[usize; 3]> {
    let names: Vec<&str> = line.trim().strip_prefix('#')?.split_whitespace().collect();
    let place = |wanted: &str| names.iter().position(|name| *name == wanted);
    Some([place("filename")?, place("x")?, place("y")?])
}

/// Rewrites a file of corners as a circle track. Each image has a line for every corner of the board, row by row; `-` stands for one that
/// was not found, and an image without the board has a single line.
fn of_corners(text: &str, pattern: &Pattern) -> String {
    let mut track = String::from("frame,x_px,y_px,column,row\n");
    let (mut places, mut image, mut number, mut index) = (None, "", 0_usize, 0_usize);
    for line in text.lines() {
        places = places.or_else(|| legend(line));
        let Some([file, x, y]) = places.filter(|_| !is_comment(line)) else { continue };
        let fields: Vec<&str> = line.split_whitespace().collect();
        let field = |column: usize| fields.get(column).copied().unwrap_or("-");
        if field(file) != image {
            (image, number, index) = (field(file), number + 1, 0);
        }
        if field(x) != "-" && field(y) != "-" {
            let (row, column) = (index / usize::from(pattern.columns), index % usize::from(pattern.columns));
            let _ = writeln!(track, "{number},{},{},{column},{row}", field(x), field(y));
        }
        index += 1;
    }
    track
}

fn is_comment(line: &str) -> bool {
    let line = line.trim_start_matches('\u{feff}').trim();
    line.is_empty() || line.starts_with('#')
}

/// One circle from the file, in seconds and pixels.
struct Row {
    line: u64,
    frame: Option<u64>,
    place: Option<(u32, u32)>,
    start: Option<f64>,
    end: Option<f64>,
    circle: UnorderedCircle,
}

/// Positions of the columns.
struct Columns {
    count: usize,
    /// Position in a line and divisor.
    places: BTreeMap<Quantity, (usize, f64)>,
    /// Subtracted from times, in seconds.
    origin: f64,
}

/// Returns the sensor in a text such as `346 x 260`.
fn size(text: &str) -> Option<Sensor> {
    let (width, height) = text.split_once('x')?;
    let side = |text: &str| text.trim().parse().ok().filter(|side| *side > 0);
    Some(Sensor::new(side(width)?, side(height)?))
}

/// Parses the bytes of a circle track; see [`super::read`].
pub fn parse(bytes: &[u8], pattern: &Pattern, recording: usize) -> Result<CircleTrack, CircleTrackErrorKind> {
    let text = String::from_utf8_lossy(bytes);
    let text = if has_corners(&text) { of_corners(&text, pattern).into() } else { text };
    let mut notes = Vec::new();
    let mut columns: Option<Columns> = None;
    let (mut origin_us, mut sensor) = (None, None);
    let mut rows: Vec<Row> = Vec::new();
    for (index, line) in text.split_inclusive('\n').enumerate() {
        let number = index as u64 + 1;
        if is_comment(line) {
            let stated = |name: &str| line.trim().strip_prefix(name).map(str::trim);
            origin_us = origin_us.or_else(|| stated("# time_origin_us ")?.parse::<i64>().ok());
            sensor = sensor.or_else(|| size(stated("# sensor ")?));
            continue;
        }
        let Some(columns) = &mut columns else {
            columns = Some(Columns::from_names(line, number, &mut notes)?);
            continue;
        };
        let fields: Vec<&str> = line.split(SEPARATORS).map(str::trim).collect();
        let row = columns.row(&fields, number);
        if !line.ends_with('\n') && (row.is_err() || columns.may_have_lost_digits()) {
            notes.push(format!("line {number} has no line end and may be incomplete; it was ignored"));
            break;
        }
        let mut row = row.map_err(|what| CircleTrackErrorKind::Line { line: number, what })?;
        if rows.is_empty() && origin_us.is_none() && row.circle.t.abs() > LARGEST_TIME {
            columns.origin = row.circle.t.floor();
            notes.push(format!("times are taken relative to {} s, the whole seconds of the first", columns.origin));
            row = columns.row(&fields, number).map_err(|what| CircleTrackErrorKind::Line { line: number, what })?;
        }
        rows.push(row);
    }
    if rows.is_empty() {
        return Err(CircleTrackErrorKind::Empty);
    }
    let circles = rows.len();
    let time_origin_us = origin_us.unwrap_or_else(|| columns.map_or(0, |columns| (columns.origin * 1e6) as i64));
    check_places(&rows, pattern)?;
    let frames = group(rows, &mut notes)?;
    let frames = arrange(frames, pattern, recording);
    Ok(CircleTrack { frames, source: TrackSource { sensor, time_origin_us }, circles, notes })
}

impl Columns {
    fn from_names(line: &str, number: u64, notes: &mut Vec<String>) -> Result<Self, CircleTrackErrorKind> {
        let names: Vec<&str> = line.trim_start_matches('\u{feff}').split(SEPARATORS).map(str::trim).collect();
        let mut places = BTreeMap::new();
        let mut ignored = Vec::new();
        for (index, name) in names.iter().enumerate() {
            match quantity(name) {
                Some((quantity, divisor)) => {
                    if places.insert(quantity, (index, divisor)).is_some() {
                        let what = CircleLineError::ColumnTwice((*name).to_owned());
                        return Err(CircleTrackErrorKind::Line { line: number, what });
                    }
                }
                None => ignored.push(*name),
            }
        }
        let needed = [(Quantity::Time, "t_s or t_us"), (Quantity::X, "x_px"), (Quantity::Y, "y_px")];
        let is_missing = |quantity: &Quantity| match quantity {
            Quantity::Time => !places.contains_key(quantity) && !places.contains_key(&Quantity::Frame),
            _ => !places.contains_key(quantity),
        };
        let missing = needed.into_iter().find(|(quantity, _)| is_missing(quantity)).map(|(_, name)| name).or(
            match (places.contains_key(&Quantity::Column), places.contains_key(&Quantity::Row)) {
                (true, false) => Some("row (there is a column)"),
                (false, true) => Some("column (there is a row)"),
                _ => None,
            },
        );
        if let Some(missing) = missing {
            return Err(CircleTrackErrorKind::Columns { line: number, missing });
        }
        if missing.is_none() && !places.contains_key(&Quantity::Time) {
            notes.push("no times: each frame is a view of its own, one second after the one before".to_owned());
        }
        if !ignored.is_empty() {
            notes.push(format!("ignored columns: {}", ignored.join(", ")));
        }
        Ok(Self { count: names.len(), places, origin: 0.0 })
    }

    /// Returns `true` if the last field of a line is used. If the end of the file cuts such a field, the line looks
    /// complete, but its last number may lack digits.
    fn may_have_lost_digits(&self) -> bool {
        self.places.values().any(|(index, _)| index + 1 == self.count)
    }

    fn row(&self, fields: &[&str], line: u64) -> Result<Row, CircleLineError> {
        if fields.len() != self.count {
            return Err(CircleLineError::FieldCount { count: fields.len(), expected: self.count });
        }
        let field = |quantity| {
            let (index, divisor) = self.places.get(&quantity)?;
            fields.get(*index).filter(|field| !field.is_empty()).map(|field| (*field, *divisor))
        };
        // Subtracted before the division, so that integer microseconds are exact.
        let number_after = |origin: f64, quantity, name| {
            let parsed = field(quantity).map(|(text, divisor)| {
                let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
                let value = value.map(|value| (value - origin * divisor) / divisor);
                value.ok_or_else(|| CircleLineError::Number { field: text.to_owned(), name })
            });
            parsed.transpose()
        };
        let number = |quantity, name| number_after(0.0, quantity, name);
        let time = |quantity, name| number_after(self.origin, quantity, name);
        let required =
            |number: Result<Option<f64>, CircleLineError>, name| number?.ok_or(CircleLineError::Missing(name));
        let whole = |quantity, name| {
            let parsed = field(quantity).map(|(text, _)| {
                text.parse::<u64>().map_err(|_| CircleLineError::WholeNumber { field: text.to_owned(), name })
            });
            parsed.transpose()
        };
        let place = |quantity, name| {
            whole(quantity, name)?
                .and_then(|value| u32::try_from(value).ok())
                .ok_or(CircleLineError::MissingPlace(name))
        };
        let radius = number(Quantity::Radius, "radius_px")?;
        if radius.is_some_and(|radius| radius <= 0.0) {
            let field = field(Quantity::Radius).map(|(text, _)| text.to_owned()).unwrap_or_default();
            return Err(CircleLineError::Radius { field });
        }
        let frame = whole(Quantity::Frame, "frame")?;
        let t = match self.places.contains_key(&Quantity::Time) {
            true => required(time(Quantity::Time, "time"), "time")?,
            false => frame.ok_or(CircleLineError::Missing("frame"))? as f64,
        };
        let velocity = (number(Quantity::VelocityX, "velocity")?, number(Quantity::VelocityY, "velocity")?);
        Ok(Row {
            line,
            frame,
            place: match self.places.contains_key(&Quantity::Column) {
                true => Some((place(Quantity::Column, "column")?, place(Quantity::Row, "row")?)),
                false => None,
            },
            start: time(Quantity::Start, "start of a time window")?,
            end: time(Quantity::End, "end of a time window")?,
            circle: UnorderedCircle {
                t,
                center: Vector2::new(
                    required(number(Quantity::X, "x_px"), "x_px")?,
                    required(number(Quantity::Y, "y_px"), "y_px")?,
                ),
                radius,
                velocity: velocity.0.zip(velocity.1).map(|(x, y)| Vector2::new(x, y)),
            },
        })
    }
}

fn check_places(rows: &[Row], pattern: &Pattern) -> Result<(), CircleTrackErrorKind> {
    let outside = |&(column, row): &(u32, u32)| column >= pattern.columns.into() || row >= pattern.rows.into();
    let places = || rows.iter().filter_map(|row| row.place.map(|place| (row.line, place)));
    let Some((line, (column, row))) = places().find(|(_, place)| outside(place)) else {
        return Ok(());
    };
    let needed = |side: fn((u32, u32)) -> u32| places().map(|(_, place)| u64::from(side(place)) + 1).max().unwrap_or(0);
    let (columns, rows) = (needed(|place| place.0), needed(|place| place.1));
    Err(CircleTrackErrorKind::OutsideBoard { line, column, row, board: describe(pattern), rows, columns })
}

/// Groups the circles of each frame, in the order of the file.
fn group(rows: Vec<Row>, notes: &mut Vec<String>) -> Result<Vec<Vec<Row>>, CircleTrackErrorKind> {
    let numbered = rows.iter().filter(|row| row.frame.is_some()).count();
    if numbered == rows.len() {
        let mut frames: BTreeMap<u64, Vec<Row>> = BTreeMap::new();
        for row in rows {
            let frame = frames.entry(row.frame.unwrap_or_default()).or_default();
            if let Some((column, place_row)) = row.place
                && frame.iter().any(|other| other.place == row.place)
            {
                let frame = row.frame.unwrap_or_default();
                let what = CircleLineError::PlaceTwice { column, row: place_row, frame };
                return Err(CircleTrackErrorKind::Line { line: row.line, what });
            }
            frame.push(row);
        }
        return Ok(frames.into_values().collect());
    }
    if numbered > 0 {
        let line = rows.iter().find(|row| row.frame.is_none()).map_or(0, |row| row.line);
        return Err(CircleTrackErrorKind::Line { line, what: CircleLineError::FrameNumber });
    }
    let mut frames: Vec<Vec<Row>> = Vec::new();
    for row in rows {
        match frames.last_mut() {
            Some(frame) if belongs_to(&row, frame) => frame.push(row),
            _ => frames.push(vec![row]),
        }
    }
    notes.push(format!("no frame numbers: {} frames were separated by their times", frames.len()));
    Ok(frames)
}

fn belongs_to(row: &Row, frame: &[Row]) -> bool {
    let near = frame.last().is_some_and(|last| (row.circle.t - last.circle.t).abs() <= FRAME_GAP);
    let repeated = row.place.is_some() && frame.iter().any(|other| other.place == row.place);
    near && !repeated
}

/// Computes the time windows of frames and sorts the frames by time.
fn arrange(frames: Vec<Vec<Row>>, pattern: &Pattern, recording: usize) -> CircleFrames {
    let window = |rows: &[Row]| {
        rows.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(start, end), row| {
            (start.min(row.start.unwrap_or(row.circle.t)), end.max(row.end.unwrap_or(row.circle.t)))
        })
    };
    let has_places = frames.iter().flatten().all(|row| row.place.is_some());
    if !has_places {
        let unordered = |rows: Vec<Row>| {
            let (start, end) = window(&rows);
            UnorderedFrame { start, end, circles: rows.iter().map(|row| row.circle).collect() }
        };
        let mut frames: Vec<UnorderedFrame> = frames.into_iter().map(unordered).collect();
        frames.sort_by(|a, b| (a.start + a.end).total_cmp(&(b.start + b.end)));
        return CircleFrames::Unordered(frames);
    }
    let ordered = |rows: Vec<Row>| {
        let (start, end) = window(&rows);
        let observed = |row: &Row| {
            let (column, place_row) = row.place?;
            let UnorderedCircle { t, center, radius, velocity } = row.circle;
            let index = place_row as usize * usize::from(pattern.columns) + column as usize;
            Some(ObservedCircle { index, t, center, radius, velocity })
        };
        let mut circles: Vec<ObservedCircle> = rows.iter().filter_map(observed).collect();
        circles.sort_by_key(|circle| circle.index);
        ReferenceFrame { recording, start, end, circles, seen_in: SeenIn::Circles }
    };
    let mut frames: Vec<ReferenceFrame> = frames.into_iter().map(ordered).collect();
    frames.sort_by(|a, b| a.t().total_cmp(&b.t()));
    CircleFrames::Ordered(frames)
}
