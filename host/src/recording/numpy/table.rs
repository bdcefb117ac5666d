//! Which arrays of a file are its events, and where their numbers are.

use std::io::Read;
use std::path::Path;

use evcal_core::sensor::Sensor;

use super::archive::{Member, Place};
use super::header::{self, Element, Header};
use crate::recording::bytes::BEFORE_IT;
use crate::recording::numbers::NumberType;
use crate::recording::{Column, RecordingError, RecordingErrorKind, columns};

/// More columns than this are none of events.
const MOST_COLUMNS: u64 = 16;

/// Rows of numbers.
pub struct Table {
    /// Where the fields of a row are, from left to right.
    pub parts: Vec<Part>,
    /// The names of the fields, if they have any.
    pub names: Option<Vec<String>>,
    /// Number of rows.
    pub count: u64,
}

/// Records of fields.
pub struct Part {
    /// Where they are.
    pub place: Place,
    /// Bytes there before the first one.
    pub skip: u64,
    /// Size of a record in bytes.
    pub record: usize,
    /// Offset and type of each field; no type where it is no number that is read.
    pub fields: Vec<(usize, Option<NumberType>)>,
}

impl Table {
    /// Number of fields.
    pub fn width(&self) -> usize {
        self.parts.iter().map(|part| part.fields.len()).sum()
    }
}

fn damaged(path: &Path, place: &Place, what: &str) -> RecordingError {
    let kind = RecordingErrorKind::Damaged { byte: place.start, what: what.to_owned(), advice: BEFORE_IT };
    RecordingError::new(path, kind)
}

fn header(path: &Path, place: &Place) -> Result<Header, RecordingError> {
    let mut bytes = Vec::new();
    let read = place.open(path)?.take(header::longest()).read_to_end(&mut bytes);
    read.map_err(|error| damaged(path, place, &format!("the array is damaged: {error}")))?;
    Header::parse(&bytes).map_err(|what| damaged(path, place, what))
}

/// The table of an array that has rows of several fields.
fn table(header: &Header, place: &Place) -> Option<Table> {
    let part = |skip, record, fields| Part { place: place.clone(), skip: header.length + skip, record, fields };
    match (&header.element, header.shape.as_slice()) {
        (Element::Record(fields, size), _) => {
            let named = || fields.iter().filter(|field| !field.name.is_empty());
            let names = Some(named().map(|field| field.name.clone()).collect());
            let fields = named().map(|field| (field.offset, field.number)).collect();
            Some(Table { parts: vec![part(0, *size, fields)], names, count: header.count() })
        }
        (Element::Number(number), &[first, second]) => {
            let as_rows = (2..=MOST_COLUMNS).contains(&second);
            let (rows, width) = if as_rows { (first, second) } else { (second, first) };
            if !(2..=MOST_COLUMNS).contains(&width) {
                return None;
            }
            let parts = if as_rows == header.fortran_order {
                // One column after the other.
                let column = |column| part(column * rows * number.size as u64, number.size, vec![(0, Some(*number))]);
                (0..width).map(column).collect()
            } else {
                let fields = (0..width as usize).map(|column| (column * number.size, Some(*number))).collect();
                vec![part(0, width as usize * number.size, fields)]
            };
            Some(Table { parts, names: None, count: rows })
        }
        _ => None,
    }
}

/// The events of the array at `place`.
pub fn of_array(path: &Path, place: Place) -> Result<Table, RecordingError> {
    let header = header(path, &place)?;
    table(&header, &place).ok_or_else(|| {
        let kind = RecordingErrorKind::NoEventStream(format!("an array of shape {:?} without fields", header.shape));
        RecordingError::new(path, kind)
    })
}

/// An array of one number an event.
fn single(header: &Header) -> Option<NumberType> {
    match (&header.element, header.shape.as_slice()) {
        (Element::Number(number), [_] | [_, 1] | [1, _]) => Some(*number),
        _ => None,
    }
}

/// The events of an archive: of the array `wanted`, else of those named t, x, y and p, else of the first array that has
/// rows. The name of the array, if it is one.
pub fn of_archive(
    path: &Path,
    members: &[Member],
    wanted: Option<&str>,
) -> Result<(Table, Option<String>), RecordingError> {
    let heads: Result<Vec<_>, _> = members.iter().map(|member| header(path, &member.place)).collect();
    let heads = heads?;
    let arrays = || members.iter().zip(&heads);
    let list = || members.iter().map(|member| member.name.clone()).collect::<Vec<_>>().join(", ");
    if wanted.is_none()
        && let Some(table) = of_columns(path, arrays)?
    {
        return Ok((table, None));
    }
    let mut tables = arrays().filter(|(member, _)| wanted.is_none_or(|wanted| wanted == member.name));
    let found = tables.find_map(|(member, header)| Some((table(header, &member.place)?, Some(member.name.clone()))));
    found.ok_or_else(|| {
        let kind = match wanted {
            Some(wanted) => RecordingErrorKind::NoSuchStream { wanted: wanted.to_owned(), available: list() },
            None => RecordingErrorKind::NoEventStream(list()),
        };
        RecordingError::new(path, kind)
    })
}

/// The table of four arrays, if there are any with these names.
fn of_columns<'a, I: Iterator<Item = (&'a Member, &'a Header)>>(
    path: &Path,
    arrays: impl Fn() -> I,
) -> Result<Option<Table>, RecordingError> {
    let mut parts: Vec<Part> = Vec::new();
    let mut names = Vec::new();
    let mut counts = Vec::new();
    for column in [Column::T, Column::X, Column::Y, Column::P] {
        let named = arrays().filter(|(member, _)| columns::of_name(&member.name).0 == column);
        let usable = named.filter_map(|(member, header)| Some((member, header, single(header)?)));
        // `t` rather than `t_offset`.
        let Some((member, header, number)) = usable.min_by_key(|(member, ..)| member.name.len()) else {
            return Ok(None);
        };
        let fields = vec![(0, Some(number))];
        parts.push(Part { place: member.place.clone(), skip: header.length, record: number.size, fields });
        names.push(member.name.clone());
        counts.push(header.count());
    }
    let count = counts.first().copied().unwrap_or(0);
    match (parts.iter().zip(&counts).zip(&names)).find(|((_, other), _)| **other != count) {
        Some(((part, other), name)) => {
            let what = format!("the array {name} has {other} elements, {} has {count}", names.join(", "));
            Err(damaged(path, &part.place, &what))
        }
        None => Ok(Some(Table { parts, names: Some(names), count })),
    }
}

/// The size of the sensor, where arrays `width` and `height` of one element give it.
pub fn sensor(path: &Path, members: &[Member]) -> Option<Sensor> {
    let side = |name: &str| {
        let member = members.iter().find(|member| member.name == name)?;
        let header = header(path, &member.place).ok()?;
        let Element::Number(number) = header.element else { return None };
        let mut bytes = Vec::new();
        member.place.open(path).ok()?.take(header.length + 8).read_to_end(&mut bytes).ok()?;
        number.read(bytes.get(usize::try_from(header.length).ok()?..)?)?.pixel().filter(|_| header.count() == 1)
    };
    Some(Sensor::new(side("width")?, side("height")?))
}
