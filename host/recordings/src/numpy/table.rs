//! Selection of the arrays in a file that contain its events, and their location.

use std::io::Read;
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;

use super::archive::{EXTENSION, Location, Member};
use super::header::{self, Element, HeadError, Header};
use crate::columns;
use crate::error::{RecordingError, RecordingErrorKind, Usable};
use crate::numbers::NumberType;
use crate::options::Column;

/// Largest number of columns in a table of events.
const MOST_COLUMNS: u64 = 16;

/// A table of numbers.
pub struct Table {
    /// Parts of a row, from left to right.
    pub parts: Vec<Part>,
    /// Names of the fields, if they have any.
    pub names: Option<Vec<String>>,
    /// Number of rows.
    pub count: u64,
}

/// Consecutive records of fields.
pub struct Part {
    /// Location of the array that contains them.
    pub location: Location,
    /// Number of bytes in the array before the first record.
    pub skip: u64,
    /// Size of a record in bytes.
    pub record: usize,
    /// Offset and type of each field. The type is `None` if it is not a supported number.
    pub fields: Vec<(usize, Option<NumberType>)>,
}

impl Table {
    /// Number of fields.
    pub fn width(&self) -> usize {
        self.parts.iter().map(|part| part.fields.len()).sum()
    }
}

fn damaged(path: &Path, location: &Location, what: &str) -> RecordingError {
    RecordingError::damaged(location.file(path), location.start, what, Usable::Before)
}

/// Reads the header of the array `name` at `location`.
fn header(path: &Path, name: &str, location: &Location) -> Result<Header, RecordingError> {
    let mut bytes = Vec::new();
    let read = location.open(path)?.take(header::longest()).read_to_end(&mut bytes);
    read.map_err(|error| damaged(path, location, &format!("the array is damaged: {error}")))?;
    Header::parse(&bytes).map_err(|error| match error {
        HeadError::Damaged(what) => damaged(path, location, what),
        HeadError::Elements(what) => {
            RecordingError::new(location.file(path), RecordingErrorKind::Elements { array: name.to_owned(), what })
        }
    })
}

/// Returns the table of an array, if its rows have several fields.
fn table(header: &Header, location: &Location) -> Option<Table> {
    let part = |skip, record, fields| Part { location: location.clone(), skip: header.length + skip, record, fields };
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
                // Columns are contiguous.
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

/// Returns the events of the array at `path`. If the array is only one column, the other columns are read from the
/// files next to it.
pub fn of_array(path: &Path) -> Result<Table, RecordingError> {
    let (name, location) = (path.file_stem().unwrap_or_default().to_string_lossy(), Location::whole(path)?);
    let header = header(path, &name, &location)?;
    let is_column = single(&header).is_some() || header.shape.get(1) == Some(&2);
    if is_column && let Some(table) = of_files(path, &name)? {
        return Ok(table);
    }
    table(&header, &location).ok_or_else(|| {
        let kind =
            RecordingErrorKind::NoEventStream(format!("an array of shape {:?} without named fields", header.shape));
        RecordingError::new(path, kind)
    })
}

/// Returns the files with the events of the array at `path`.
pub fn files(path: &Path) -> Vec<PathBuf> {
    let parts = of_array(path).map_or_else(|_| Vec::new(), |table| table.parts);
    let mut files: Vec<PathBuf> = parts.iter().map(|part| part.location.file(path).to_owned()).collect();
    files.push(path.to_owned());
    files.sort();
    files.dedup();
    files
}

/// Returns the file in `folder` whose name means times of events, if there is exactly one.
pub fn times_in(folder: &Path) -> Option<PathBuf> {
    let names = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.file_name());
    let is_time = |name: &str| name.strip_suffix(EXTENSION).and_then(event_column) == Some(Column::T);
    let mut times = names.filter(|name| name.to_str().is_some_and(is_time));
    match (times.next(), times.next()) {
        (Some(name), None) => Some(folder.join(name)),
        _ => None,
    }
}

/// Returns the events of the file `name` at `path` and of the files next to it with the other columns and the same
/// prefix.
fn of_files(path: &Path, name: &str) -> Result<Option<Table>, RecordingError> {
    let Some(front) = event_column(name).and_then(|_| name.strip_suffix(columns::event_name(name))) else {
        return Ok(None);
    };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).map_err(|error| RecordingError::io(folder, error))?;
    let name_of = |entry: &std::fs::DirEntry| Some(entry.file_name().to_str()?.strip_suffix(EXTENSION)?.to_owned());
    let mut names: Vec<String> = entries.flatten().filter_map(|entry| name_of(&entry)).collect();
    names.retain(|name| name.strip_suffix(columns::event_name(name)) == Some(front) && event_column(name).is_some());
    names.sort();
    let member = |name: String| {
        let location = Location::sibling(folder.join(format!("{name}{EXTENSION}")))?;
        Ok(Member { name, location })
    };
    let members = names.into_iter().map(member).collect::<Result<Vec<_>, RecordingError>>()?;
    let head = |member: &Member| header(path, &member.name, &member.location);
    let heads = members.iter().map(head).collect::<Result<Vec<_>, _>>()?;
    of_columns(path, &members.iter().zip(&heads).collect::<Vec<_>>())
}

/// Returns the number type of an array with one number per event.
fn single(header: &Header) -> Option<NumberType> {
    match (&header.element, header.shape.as_slice()) {
        (Element::Number(number), [_] | [_, 1] | [1, _]) => Some(*number),
        _ => None,
    }
}

/// A table of an archive, with the name of its array if it is a single one.
pub type Named = (Table, Option<String>);

/// Returns the tables of an archive that can be its events, the most likely first. If an array is `wanted`, only that
/// one. Otherwise the arrays named t, x, y and p, then arrays with such fields, then arrays whose names begin with
/// `event`, then all others that have rows.
///
/// # Errors
/// If there is no such table.
pub fn of_archive(path: &Path, members: &[Member], wanted: Option<&str>) -> Result<Vec<Named>, RecordingError> {
    // Arrays of Python objects, for example, may be stored with the events.
    let head = |member: &Member| match header(path, &member.name, &member.location) {
        Err(error) if !matches!(error.kind, RecordingErrorKind::Elements { .. }) => Err(error),
        head => Ok(head),
    };
    let heads = members.iter().map(head).collect::<Result<Vec<_>, _>>()?;
    let list = || members.iter().map(|member| member.name.clone()).collect::<Vec<_>>().join(", ");
    let arrays: Vec<Array> =
        members.iter().zip(&heads).filter_map(|(member, head)| Some((member, head.as_ref().ok()?))).collect();
    let mut found: Vec<(usize, Named)> = Vec::new();
    if wanted.is_none() {
        found.extend(of_columns(path, &arrays)?.map(|table| (0, (table, None))));
    }
    for (member, header) in arrays.iter().filter(|(member, _)| wanted.is_none_or(|wanted| wanted == member.name)) {
        let Some(table) = table(header, &member.location) else { continue };
        let has_names = table.names.as_ref().is_some_and(|names| {
            columns::from_names(&names.iter().map(String::as_str).collect::<Vec<_>>()).0.is_some()
        });
        let rank = match (has_names, member.name.to_lowercase().starts_with("event")) {
            (true, _) => 1,
            (false, true) => 2,
            (false, false) => 3,
        };
        found.push((rank, (table, Some(member.name.clone()))));
    }
    found.sort_by_key(|(rank, _)| *rank);
    if !found.is_empty() {
        return Ok(found.into_iter().map(|(_, named)| named).collect());
    }
    // The error about a relevant array that is not supported is more useful than a list.
    let of_use = |member: &Member| match wanted {
        Some(wanted) => wanted == member.name,
        None => event_column(&member.name).is_some(),
    };
    let unread = members.iter().zip(heads).filter(|(member, _)| of_use(member)).find_map(|(_, head)| head.err());
    Err(unread.unwrap_or_else(|| {
        let kind = match wanted {
            Some(wanted) => RecordingErrorKind::NoSuchStream { wanted: wanted.to_owned(), available: list() },
            None => RecordingErrorKind::NoEventStream(list()),
        };
        RecordingError::new(path, kind)
    }))
}

/// An array of an archive, with its header.
type Array<'a> = (&'a Member, &'a Header);

/// Returns the column of events that an array of this name contains. For `xy`, which contains two, returns the first.
fn event_column(name: &str) -> Option<Column> {
    match columns::of_name(name).0 {
        Column::Ignored => (columns::event_name(name) == "xy").then_some(Column::X),
        column => Some(column),
    }
}

/// Returns the table of the arrays t, x, y and p, or t, xy and p, if they are present.
fn of_columns(path: &Path, arrays: &[Array]) -> Result<Option<Table>, RecordingError> {
    let mut parts: Vec<Part> = Vec::new();
    let mut names = Vec::new();
    let mut counts = Vec::new();
    let xy = arrays.iter().find_map(|(member, header)| match (&header.element, header.shape.as_slice()) {
        (Element::Number(number), &[count, 2]) if columns::event_name(&member.name) == "xy" => {
            Some((member, header, *number, count))
        }
        _ => None,
    });
    for column in [Column::T, Column::X, Column::Y, Column::P] {
        let named = arrays.iter().filter(|(member, _)| columns::of_name(&member.name).0 == column);
        let usable = named.filter_map(|(member, header)| Some((member, header, single(header)?)));
        // Prefers `t` to `t_offset`.
        match (usable.min_by_key(|(member, ..)| member.name.len()), column, xy) {
            (Some((member, header, number)), ..) => {
                let fields = vec![(0, Some(number))];
                parts.push(Part {
                    location: member.location.clone(),
                    skip: header.length,
                    record: number.size,
                    fields,
                });
                names.push(header::with_unit(columns::event_name(&member.name), header.unit.as_deref()));
                counts.push(header.count());
            }
            (None, Column::X | Column::Y, Some((member, header, number, count))) => {
                let second = usize::from(column == Column::Y);
                let (size, location) = (number.size, member.location.clone());
                let (skip, record, offset) = if header.fortran_order {
                    (second as u64 * count * size as u64, size, 0)
                } else {
                    (0, 2 * size, second * size)
                };
                parts.push(Part { location, skip: header.length + skip, record, fields: vec![(offset, Some(number))] });
                names.push(if column == Column::X { "x" } else { "y" }.to_owned());
                counts.push(count);
            }
            _ => return Ok(None),
        }
    }
    let count = counts.first().copied().unwrap_or(0);
    match (parts.iter().zip(&counts).zip(&names)).find(|((_, other), _)| **other != count) {
        Some(((part, other), name)) => {
            let what = format!("the array {name} has {other} elements; {} has {count}", names.join(", "));
            Err(damaged(path, &part.location, &what))
        }
        None => Ok(Some(Table { parts, names: Some(names), count })),
    }
}

/// Returns the size of the sensor, if arrays `width` and `height` of one element contain it.
pub fn sensor(path: &Path, members: &[Member]) -> Option<Sensor> {
    let side = |name: &str| {
        let member = members.iter().find(|member| member.name == name)?;
        let header = header(path, name, &member.location).ok()?;
        let Element::Number(number) = header.element else { return None };
        let mut bytes = Vec::new();
        member.location.open(path).ok()?.take(header.length + 8).read_to_end(&mut bytes).ok()?;
        number.read(bytes.get(usize::try_from(header.length).ok()?..)?)?.pixel().filter(|_| header.count() == 1)
    };
    Some(Sensor::new(side("width")?, side("height")?))
}
