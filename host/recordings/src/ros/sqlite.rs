//! Tables of an SQLite file, read row by row (<https://www.sqlite.org/fileformat2.html>).
//!
//! A file consists of pages of one size, the first of which begins with a header of 100 bytes. A table is a tree of pages:
//! those within it (kind 5) list others, those at its ends (kind 13) hold rows. What of a row does not fit goes on in a list
//! of overflow pages. Numbers are big-endian.

use std::path::Path;

use crate::bytes::{ByteReader, share};
use crate::error::{RecordingError, RecordingErrorKind};
use crate::read_report::Truncation;

/// How a file begins.
pub const MAGIC: &[u8] = b"SQLite format 3\0";
const HEADER: usize = 100;
const INNER: u8 = 5;
const LEAF: u8 = 13;
/// A deeper tree goes round in circles: with two branches a page it would have more pages than any file.
const DEEPEST: usize = 64;

/// The pages of a file.
pub struct Pages {
    file: ByteReader,
    size: usize,
    /// Bytes of a page that hold something.
    usable: usize,
    /// Pages that are whole, and how many there should be.
    count: u64,
    promised: u64,
    /// Pages read for the present table.
    read: u64,
    truncated: Option<Truncation>,
}

/// A table that is being read.
pub struct Table {
    /// The pages from the root to the present one.
    path: Vec<Page>,
    /// The page that comes next, if it is not read yet.
    next: Option<u32>,
}

/// A page of a table.
struct Page {
    number: u32,
    bytes: Vec<u8>,
    /// Its offset in the file.
    byte: u64,
    /// Where its own header begins.
    start: usize,
    /// Cells, and which is next.
    cells: usize,
    cell: usize,
}

/// A value of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// Nothing, or a number that is not whole.
    Other,
    /// A whole number.
    Whole(i64),
    /// A text or bytes.
    Bytes(&'a [u8]),
}

/// A table by its name.
pub struct Description {
    /// Its name.
    pub name: String,
    /// The names of its columns.
    pub columns: Vec<String>,
    root: u32,
}

impl Description {
    /// The rows of the table, from the first.
    pub fn open(&self) -> Table {
        Table { path: Vec::new(), next: Some(self.root) }
    }

    /// Which column has this name.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }
}

impl Pages {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// Where its header is damaged, or changes to it wait in another file.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut log = path.as_os_str().to_owned();
        log.push("-wal");
        if std::fs::metadata(&log).is_ok_and(|log| log.len() > 0) {
            let kind = RecordingErrorKind::Unmerged { log: log.into() };
            return Err(RecordingError::new(path, kind));
        }
        let mut file = ByteReader::open(path)?;
        let length = file.left();
        let Some(header) = file.array::<HEADER>()? else {
            return Err(file.damaged(0, "the header is not whole"));
        };
        let [a, b] = [header[16], header[17]];
        // 1 stands for 65536.
        let size = if [a, b] == [0, 1] { 65_536 } else { usize::from(u16::from_be_bytes([a, b])) };
        let usable = size.saturating_sub(header[20].into());
        if !size.is_power_of_two() || size < 512 || usable < 480 {
            return Err(file.damaged(16, "the size of its pages cannot be"));
        }
        if number(&header, 56) != Some(1) {
            return Err(file.damaged(56, "its texts are not in UTF-8"));
        }
        // The number of pages counts where the same change wrote it and the header.
        let valid = number(&header, 24) == number(&header, 92);
        let count = length / size as u64;
        let promised = number(&header, 28).filter(|_| valid).map_or(0, u64::from).max(length.div_ceil(size as u64));
        Ok(Self { file, size, usable, count, promised, read: 0, truncated: None })
    }

    /// The tables of the file. It may be cut off before all of them.
    ///
    /// # Errors
    /// Where the file is damaged.
    pub fn tables(&mut self) -> Result<Vec<Description>, RecordingError> {
        let mut schema = Table { path: Vec::new(), next: Some(1) };
        let (mut row, mut tables) = (Vec::new(), Vec::new());
        while let Some((_, byte)) = self.next(&mut schema, &mut row)? {
            let values = values(&row).ok_or_else(|| self.file.damaged(byte, "a row cannot be read"))?;
            if let [Value::Bytes(b"table"), Value::Bytes(name), _, Value::Whole(root), Value::Bytes(sql)] = values[..]
                && let Ok(root) = u32::try_from(root)
            {
                let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
                tables.push(Description { name: text(name), columns: columns(&text(sql)), root });
            }
        }
        Ok(tables)
    }

    /// Puts the next row of `table` into `row`; its number and the byte of its page. `None` at the end, also of a file that
    /// was cut off.
    ///
    /// # Errors
    /// Where the file is damaged. The rows behind the damaged row or page follow; where they cannot be found, none does, and
    /// [`Self::truncated`] says so.
    pub fn next(&mut self, table: &mut Table, row: &mut Vec<u8>) -> Result<Option<(i64, u64)>, RecordingError> {
        let next = self.next_row(table, row);
        match &next {
            Ok(Some(_)) => {}
            Ok(None) => self.end(table),
            Err(error) => {
                // A page is read twice where the tree is none: it could go on without end.
                if table.path.is_empty() || self.read > self.count {
                    if let RecordingErrorKind::Damaged { byte, what, .. } = &error.kind {
                        let lost = format!("rows of a table cannot be found: {what}");
                        self.truncated = Some(Truncation { byte: *byte, lost });
                    }
                    self.end(table);
                }
            }
        }
        next
    }

    fn end(&mut self, table: &mut Table) {
        *table = Table { path: Vec::new(), next: None };
        self.read = 0;
    }

    fn next_row(&mut self, table: &mut Table, row: &mut Vec<u8>) -> Result<Option<(i64, u64)>, RecordingError> {
        loop {
            if let Some(number) = table.next.take() {
                let parent = table.path.last().map_or(0, |page| page.byte);
                if table.path.len() == DEEPEST || table.path.iter().any(|page| page.number == number) {
                    return Err(self.file.damaged(parent, "its pages go round in circles"));
                }
                let Some(page) = self.page(number, parent)? else { return Ok(None) };
                table.path.push(page);
            }
            let Some(page) = table.path.last_mut() else { return Ok(None) };
            let byte = page.byte;
            let begun = match page.next_cell() {
                Ok(Cell::Child(number)) => {
                    table.next = Some(number);
                    continue;
                }
                Ok(Cell::End) => {
                    table.path.pop();
                    continue;
                }
                Ok(Cell::Row(start)) => self.begin_row(page, start, row),
                Err(what) => Err(what),
            };
            let Begun { id, length, overflow } = match begun {
                Ok(begun) => begun,
                Err(what) => {
                    // Its other cells are not to be trusted; its parent leads on.
                    table.path.pop();
                    return Err(self.file.damaged(byte, what));
                }
            };
            let whole = self.overflow(overflow, length, byte, row)?;
            return Ok(whole.then_some((id, byte)));
        }
    }

    /// Puts what the page has of the row at `start` into `row`.
    fn begin_row(&self, page: &Page, start: usize, row: &mut Vec<u8>) -> Result<Begun, &'static str> {
        let head = page.bytes.get(start..).and_then(|cell| {
            let (length, cell) = varint(cell)?;
            let (id, cell) = varint(cell)?;
            Some((usize::try_from(length).ok()?, id, cell))
        });
        let (length, id, cell) = head.ok_or("a row is damaged")?;
        let local = self.local(length);
        row.clear();
        row.extend_from_slice(cell.get(..local).ok_or("a row is longer than its page")?);
        let overflow = if local < length { number(cell, local) } else { Some(0) };
        Ok(Begun { id, length, overflow: overflow.ok_or("a row is longer than its page")? })
    }

    /// Bytes of a row of this length that are in its page.
    fn local(&self, length: usize) -> usize {
        let most = self.usable - 35;
        let least = (self.usable - 12) * 32 / 255 - 23;
        if length <= most {
            return length;
        }
        let filled = least + (length - least) % (self.usable - 4);
        if filled <= most { filled } else { least }
    }

    /// Appends the rest of a row of this length; false if the file is cut off before its end.
    fn overflow(&mut self, mut next: u32, length: usize, byte: u64, row: &mut Vec<u8>) -> Result<bool, RecordingError> {
        let mut bytes = Vec::new();
        while row.len() < length {
            if !self.read(next, byte, &mut bytes)? {
                return Ok(false);
            }
            next = number(&bytes, 0).unwrap_or(0);
            let part = (length - row.len()).min(self.usable - 4);
            let part = bytes.get(4..4 + part).ok_or_else(|| self.file.damaged(byte, "a row is damaged"))?;
            row.extend_from_slice(part);
        }
        Ok(true)
    }

    /// A page of a table, which the one at `parent` asks for; `None` if the file is cut off before its end.
    fn page(&mut self, number: u32, parent: u64) -> Result<Option<Page>, RecordingError> {
        let mut bytes = Vec::new();
        if !self.read(number, parent, &mut bytes)? {
            return Ok(None);
        }
        let byte = (u64::from(number) - 1) * self.size as u64;
        let start = if number == 1 { HEADER } else { 0 };
        let count = bytes.get(start + 3..).and_then(|rest| rest.first_chunk());
        match (bytes.get(start), count) {
            (Some(&(INNER | LEAF)), Some(count)) => {
                let cells = u16::from_be_bytes(*count).into();
                Ok(Some(Page { number, bytes, byte, start, cells, cell: 0 }))
            }
            _ => Err(self.file.damaged(byte, "a page of a table is of another kind")),
        }
    }

    /// Reads a page, which the one at `parent` asks for; false if the file is cut off before its end.
    fn read(&mut self, number: u32, parent: u64, bytes: &mut Vec<u8>) -> Result<bool, RecordingError> {
        let Some(index) = number.checked_sub(1).map(u64::from).filter(|index| *index < self.promised) else {
            return Err(self
                .file
                .damaged(parent, format!("page {number}, which the file does not have, is asked for")));
        };
        if index >= self.count {
            self.cut_off();
            return Ok(false);
        }
        self.read += 1;
        if self.read > self.count {
            return Err(self.file.damaged(parent, "its pages go round in circles"));
        }
        self.file.seek(index * self.size as u64)?;
        self.file.read(bytes, self.size as u64)?;
        Ok(true)
    }

    fn cut_off(&mut self) {
        let lost = format!("{} pages of the database are missing", self.promised - self.count);
        self.truncated = Some(Truncation { byte: self.count * self.size as u64, lost });
    }

    /// Which part of the pages was read for the present table, 0 to 1.
    pub fn done(&self) -> f64 {
        share(self.read, self.count)
    }

    /// Set when the file ends before its last page.
    pub fn truncated(&self) -> Option<&Truncation> {
        self.truncated.as_ref()
    }

    /// Looks at the end of the file, also where nothing has been asked for that is missing.
    pub fn finish(&mut self) {
        if self.count < self.promised {
            self.cut_off();
        }
    }

    /// An error about the page at `byte`.
    pub fn damaged(&self, byte: u64, what: impl Into<String>) -> RecordingError {
        self.file.damaged(byte, what)
    }
}

/// What is next in a page.
enum Cell {
    /// Another page.
    Child(u32),
    /// A row, and where it begins.
    Row(usize),
    End,
}

/// A row of which the part in its page was read.
struct Begun {
    id: i64,
    length: usize,
    /// The page in which it goes on.
    overflow: u32,
}

impl Page {
    fn next_cell(&mut self) -> Result<Cell, &'static str> {
        let index = self.cell;
        self.cell += 1;
        let inner = self.bytes.get(self.start) == Some(&INNER);
        if index > self.cells || index == self.cells && !inner {
            return Ok(Cell::End);
        }
        let start = if index == self.cells {
            // The page behind all cells of an inner page.
            self.start + 8
        } else {
            let pointers = self.start + if inner { 12 } else { 8 };
            let place = self.bytes.get(pointers + 2 * index..).and_then(|rest| rest.first_chunk());
            u16::from_be_bytes(*place.ok_or("a page is not as long as its list of rows")?).into()
        };
        if !inner {
            return Ok(Cell::Row(start));
        }
        number(&self.bytes, start).map(Cell::Child).ok_or("a page of a table is damaged")
    }
}

fn number(bytes: &[u8], from: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(from..)?.first_chunk()?))
}

/// A number of 1 to 9 bytes, and what follows it: 7 bits a byte, the ninth has 8.
fn varint(bytes: &[u8]) -> Option<(i64, &[u8])> {
    let mut value = 0_u64;
    for (index, byte) in bytes.iter().enumerate().take(9) {
        if index == 8 {
            return Some(((value << 8 | u64::from(*byte)).cast_signed(), bytes.get(9..)?));
        }
        value = value << 7 | u64::from(byte & 0x7f);
        if byte & 0x80 == 0 {
            return Some((value.cast_signed(), bytes.get(index + 1..)?));
        }
    }
    None
}

/// The values of a row.
pub fn values(row: &[u8]) -> Option<Vec<Value<'_>>> {
    let (length, rest) = varint(row)?;
    let mut types = row.get(row.len() - rest.len()..usize::try_from(length).ok()?)?;
    let mut content = row.get(usize::try_from(length).ok()?..)?;
    let mut values = Vec::new();
    while !types.is_empty() {
        let (kind, after) = varint(types)?;
        types = after;
        let length = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind,
            5 => 6,
            6 | 7 => 8,
            12.. => (kind - 12) / 2,
            _ => return None,
        };
        let (bytes, after) = content.split_at_checked(usize::try_from(length).ok()?)?;
        content = after;
        values.push(match kind {
            8 | 9 => Value::Whole(kind - 8),
            1..=6 => {
                let negative = bytes.first().is_some_and(|byte| byte & 0x80 != 0);
                Value::Whole(bytes.iter().fold(-i64::from(negative), |value, byte| value << 8 | i64::from(*byte)))
            }
            12.. => Value::Bytes(bytes),
            _ => Value::Other,
        });
    }
    Some(values)
}

/// The names of the columns in a text `CREATE TABLE name (column type, ...)`.
fn columns(sql: &str) -> Vec<String> {
    let inside = sql.split_once('(').map_or("", |(_, inside)| inside);
    let mut depth = 0_i32;
    let parts = inside.split(|character| {
        depth += match character {
            '(' => 1,
            ')' => -1,
            _ => 0,
        };
        depth == 0 && character == ','
    });
    let name =
        |part: &str| part.split_whitespace().next().map(|name| name.trim_matches(['"', '`', '[', ']']).to_owned());
    parts.filter_map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_as_many_bytes_as_they_need() {
        for (bytes, value) in [
            (vec![5], 5),
            (vec![0x81, 0], 128),
            (vec![0xff; 9], -1),
            (vec![0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 7], 7),
        ] {
            let with_more = [bytes.as_slice(), &[9, 9]].concat();
            assert_eq!(varint(&with_more), Some((value, [9_u8, 9].as_slice())));
            assert_eq!(varint(&bytes[..bytes.len() - 1]), None);
        }
    }

    #[test]
    fn rows_hold_values_of_every_kind() {
        let row = [9, 0, 1, 5, 7, 8, 9, 17, 18, 0xfe, 0xff, 0, 0, 0, 0, 7, 1, 2, 3, 4, 5, 6, 7, 8, b'a', b'b', 1, 2, 3];
        let expected = [
            Value::Other,
            Value::Whole(-2),
            Value::Whole(7 - (1 << 40)),
            Value::Other,
            Value::Whole(0),
            Value::Whole(1),
            Value::Bytes(b"ab"),
            Value::Bytes(&[1, 2, 3]),
        ];
        assert_eq!(values(&row).unwrap(), expected);
        for cut in 0..row.len() {
            assert_eq!(values(&row[..cut]), None);
        }
    }

    #[test]
    fn columns_are_found_in_their_definition() {
        let sql =
            "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL, \"data\" BLOB DEFAULT (f(1, 2)))";
        assert_eq!(columns(sql), ["id", "topic_id", "data"]);
    }
}
