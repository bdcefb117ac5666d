//! Reader of the tables in an SQLite file, row by row (<https://www.sqlite.org/fileformat2.html>).
//!
//! A file consists of pages of one size, the first of which begins with a header of 100 bytes. A table is a tree of
//! pages: inner pages (kind 5) list others, leaves (kind 13) contain rows. An index is a tree of inner pages (kind 2) and
//! leaves (kind 10) with the values of a column and the numbers of their rows, in order of the values. The part of a row that does not fit in its
//! page is in a list of overflow pages. Numbers are big-endian.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::bytes::{ByteReader, share};
use crate::counted::counted;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::read_report::Truncation;

/// First bytes of a file.
pub const MAGIC: &[u8] = b"SQLite format 3\0";
/// Suffix of the write-ahead log, and the version of files that use one (byte 19 of the header).
const LOG: &str = "-wal";
const WITH_LOG: u8 = 2;
/// First bytes of a rollback journal that has to be applied.
const JOURNAL: &[u8; 8] = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7";
const HEADER: usize = 100;
const INNER: u8 = 5;
const LEAF: u8 = 13;
const INDEX_INNER: u8 = 2;
const INDEX_LEAF: u8 = 10;
/// Depth limit of a tree. A deeper one is cyclic, because with two branches per page it would have more pages than any
/// file.
const DEEPEST: usize = 64;

/// Reader of the pages of a file.
pub struct Pages {
    file: ByteReader,
    size: usize,
    /// Number of usable bytes per page.
    usable: usize,
    /// Number of whole pages, and number of pages according to the header.
    count: u64,
    promised: u64,
    /// Number of pages read for the current table.
    read: u64,
    truncated: Option<Truncation>,
    /// `true` if the latest changes may have been in a write-ahead log, which is not there.
    has_log: bool,
}

/// Position in a table that is being read.
pub struct Table {
    /// Pages from the root to the current one.
    path: Vec<Page>,
    /// Number of the next page, if it has not been read.
    next: Option<u32>,
}

/// Position in an index that is being read.
pub struct Walk {
    /// Pages from the root to the current one.
    path: Vec<Page>,
    /// Number of the next page, if it has not been read.
    next: Option<u32>,
}

/// A page of a table or an index.
struct Page {
    number: u32,
    bytes: Vec<u8>,
    /// Offset of the page in the file.
    byte: u64,
    /// Offset of the page's own header in `bytes`.
    start: usize,
    /// Number of cells, and index of the next cell; in an inner page of an index, of the next child or cell.
    cells: usize,
    cell: usize,
}

/// A value of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// NULL, or a number that is not an integer.
    Other,
    /// An integer.
    Whole(i64),
    /// Text or bytes.
    Bytes(&'a [u8]),
}

/// Description of a table, or of an index of one.
#[derive(Clone)]
pub struct Description {
    /// Name of the table.
    pub name: String,
    /// `true` for an index.
    pub is_index: bool,
    /// Names of its columns.
    pub columns: Vec<String>,
    root: u32,
}

impl Description {
    /// Starts reading the table at its first row.
    pub fn open(&self) -> Table {
        Table { path: Vec::new(), next: Some(self.root) }
    }

    /// Starts reading the index at its lowest value.
    pub fn walk(&self) -> Walk {
        Walk { path: Vec::new(), next: Some(self.root) }
    }

    /// `true` if this is an index of the column `name` of the table `table` in ascending order.
    pub fn orders(&self, table: &str, name: &str) -> bool {
        self.is_index && self.name == table && matches!(self.columns.as_slice(), [column] if column == name)
    }

    /// Returns the index of the column with this name.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }
}

/// Returns the path of a file that SQLite keeps next to the database at `path`.
fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

impl Pages {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// If its header is damaged, or if a write-ahead log or a journal contains changes to it.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let (log, journal) = (beside(path, LOG), beside(path, "-journal"));
        if std::fs::metadata(&log).is_ok_and(|log| log.len() > 0) {
            return Err(RecordingError::new(path, RecordingErrorKind::Unmerged { log }));
        }
        // SQLite clears the first bytes of a journal that is not needed any more.
        let mut start = [0; JOURNAL.len()];
        if File::open(&journal).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == *JOURNAL {
            return Err(RecordingError::new(path, RecordingErrorKind::Interrupted { journal }));
        }
        Self::with_buffer(path, 1 << 18)
    }

    /// Opens the file at `path` to read single pages of it.
    pub fn for_index(path: &Path) -> Result<Self, RecordingError> {
        Self::with_buffer(path, 1 << 12)
    }

    fn with_buffer(path: &Path, buffer: usize) -> Result<Self, RecordingError> {
        let mut file = ByteReader::with_buffer(path, buffer)?;
        let length = file.left();
        let Some(header) = file.array::<HEADER>()? else {
            return Err(file.damaged(0, "the header is incomplete"));
        };
        let [a, b] = [header[16], header[17]];
        // 1 means 65536.
        let size = if [a, b] == [0, 1] { 65_536 } else { usize::from(u16::from_be_bytes([a, b])) };
        let usable = size.saturating_sub(header[20].into());
        if !size.is_power_of_two() || size < 512 || usable < 480 {
            return Err(file.damaged(16, "the page size is invalid"));
        }
        if number(&header, 56) != Some(1) {
            return Err(file.damaged(56, "its text is not in UTF-8"));
        }
        // The number of pages is valid only if it was written together with the header.
        let valid = number(&header, 24) == number(&header, 92);
        let count = length / size as u64;
        let promised = number(&header, 28).filter(|_| valid).map_or(0, u64::from).max(length.div_ceil(size as u64));
        let has_log = header[19] == WITH_LOG && !beside(path, LOG).exists();
        Ok(Self { file, size, usable, count, promised, read: 0, truncated: None, has_log })
    }

    /// Returns the tables of the file, and the indices of their columns. If the file is cut off, some may be missing.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn tables(&mut self) -> Result<Vec<Description>, RecordingError> {
        let mut schema = Table { path: Vec::new(), next: Some(1) };
        let (mut row, mut tables) = (Vec::new(), Vec::new());
        while let Some((_, byte)) = self.next(&mut schema, &mut row)? {
            let values = values(&row).ok_or_else(|| self.file.damaged(byte, "a row cannot be read"))?;
            if let [Value::Bytes(kind), _, Value::Bytes(table), Value::Whole(root), Value::Bytes(sql)] = values[..]
                && let Ok(root) = u32::try_from(root)
            {
                let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
                let (name, sql, is_index) = (text(table), text(sql), kind == b"index");
                // A partial index lacks rows, and a descending one has another order.
                let is_other = |word: &str| sql.split_whitespace().any(|part| part.trim_end_matches(')') == word);
                if kind == b"table" || is_index && !is_other("WHERE") && !is_other("DESC") {
                    tables.push(Description { name, is_index, columns: columns(&sql), root });
                }
            }
        }
        Ok(tables)
    }

    /// Reads the next row of `table` into `row`. Returns its number and the offset of its page; `None` at the end, also
    /// if the file is cut off.
    ///
    /// # Errors
    /// If the file is damaged. The rows after the damaged row or page can still be read. If they cannot be found,
    /// reading ends, and [`Self::truncated`] contains the position.
    pub fn next(&mut self, table: &mut Table, row: &mut Vec<u8>) -> Result<Option<(i64, u64)>, RecordingError> {
        let next = self.next_row(table, row);
        match &next {
            Ok(Some(_)) => {}
            Ok(None) => self.end(table),
            Err(error) => {
                // If more pages were read than exist, the tree is cyclic, and reading would never end.
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

    /// Reads the next entry of an index of whole numbers: the number, and the number of its row. `None` at the end, also
    /// if the file is cut off.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn next_entry(&mut self, walk: &mut Walk) -> Result<Option<(i64, i64)>, RecordingError> {
        loop {
            if let Some(number) = walk.next.take() {
                let parent = walk.path.last().map_or(0, |page| page.byte);
                if walk.path.len() == DEEPEST {
                    return Err(self.file.damaged(parent, "its pages form a cycle"));
                }
                let Some(page) = self.page(number, parent, [INDEX_INNER, INDEX_LEAF])? else { return Ok(None) };
                walk.path.push(page);
            }
            let Some(page) = walk.path.last_mut() else {
                self.read = 0;
                return Ok(None);
            };
            let is_inner = page.bytes.get(page.start) == Some(&INDEX_INNER);
            let (step, byte) = (page.cell, page.byte);
            page.cell += 1;
            // In an inner page, children and cells alternate.
            let (cell, is_child) = if is_inner { (step / 2, step.is_multiple_of(2)) } else { (step, false) };
            if cell > page.cells || cell == page.cells && !is_child {
                walk.path.pop();
                continue;
            }
            let damaged = || self.file.damaged(byte, "an entry of an index is damaged");
            let start = page.cell_start(cell).ok_or_else(damaged)?;
            if is_child {
                walk.next = Some(number(&page.bytes, start).ok_or_else(damaged)?);
                continue;
            }
            let entry = page.bytes.get(if is_inner { start + 4 } else { start }..).and_then(|cell| {
                let (length, content) = varint(cell)?;
                let values = values(content.get(..usize::try_from(length).ok()?)?)?;
                match values.as_slice() {
                    [Value::Whole(value), Value::Whole(row)] => Some((*value, *row)),
                    _ => None,
                }
            });
            return entry.ok_or_else(damaged).map(Some);
        }
    }

    /// Reads the row `id` of `table` into `row`. Returns the offset of its page; `None` if the file is cut off before
    /// its end.
    ///
    /// # Errors
    /// If the file is damaged or has no such row.
    pub fn row(&mut self, table: &Description, id: i64, row: &mut Vec<u8>) -> Result<Option<u64>, RecordingError> {
        let (mut next, mut parent) = (table.root, 0);
        self.read = 0;
        for _ in 0..DEEPEST {
            let Some(page) = self.page(next, parent, [INNER, LEAF])? else { return Ok(None) };
            let byte = page.byte;
            let is_inner = page.bytes.get(page.start) == Some(&INNER);
            // The first row of a leaf with this number, or the first child whose last row has at least this number.
            let id_of = |start: usize| {
                let cell = page.bytes.get(start + if is_inner { 4 } else { 0 }..)?;
                Some(if is_inner { varint(cell)?.0 } else { varint(varint(cell)?.1)?.0 })
            };
            let fits =
                |start: &usize| id_of(*start).is_some_and(|found| if is_inner { found >= id } else { found == id });
            let found = (0..page.cells).filter_map(|cell| page.cell_start(cell)).find(fits);
            if is_inner {
                let child = found.or_else(|| page.cell_start(page.cells)).and_then(|start| number(&page.bytes, start));
                next = child.ok_or_else(|| self.file.damaged(byte, "a page of a table is damaged"))?;
                parent = byte;
                continue;
            }
            let start = found.ok_or_else(|| self.file.damaged(byte, format!("row {id} of a table is missing")))?;
            let begun = self.begin_row(&page, start, row).map_err(|what| self.file.damaged(byte, what))?;
            let whole = self.overflow(begun.overflow, begun.length, byte, row)?;
            return Ok(whole.then_some(byte));
        }
        Err(self.file.damaged(parent, "its pages form a cycle"))
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
                    return Err(self.file.damaged(parent, "its pages form a cycle"));
                }
                let Some(page) = self.page(number, parent, [INNER, LEAF])? else { return Ok(None) };
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
                    // The other cells of the page may be damaged too, so reading continues in its parent.
                    table.path.pop();
                    return Err(self.file.damaged(byte, what));
                }
            };
            let whole = self.overflow(overflow, length, byte, row)?;
            return Ok(whole.then_some((id, byte)));
        }
    }

    /// Reads the part of the row at `start` that is in its page into `row`.
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

    /// Returns the number of bytes of a row of this `length` that are stored in its own page.
    fn local(&self, length: usize) -> usize {
        let most = self.usable - 35;
        let least = (self.usable - 12) * 32 / 255 - 23;
        if length <= most {
            return length;
        }
        let filled = least + (length - least) % (self.usable - 4);
        if filled <= most { filled } else { least }
    }

    /// Appends the rest of a row of this length. Returns `false` if the file is cut off before its end.
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

    /// Reads a page of one of these kinds, to which the page at `parent` refers. Returns `None` if the file is cut off
    /// before its end.
    fn page(&mut self, number: u32, parent: u64, kinds: [u8; 2]) -> Result<Option<Page>, RecordingError> {
        let mut bytes = Vec::new();
        if !self.read(number, parent, &mut bytes)? {
            return Ok(None);
        }
        let byte = (u64::from(number) - 1) * self.size as u64;
        let start = if number == 1 { HEADER } else { 0 };
        let count = bytes.get(start + 3..).and_then(|rest| rest.first_chunk());
        match (bytes.get(start), count) {
            (Some(kind), Some(count)) if kinds.contains(kind) => {
                let cells = u16::from_be_bytes(*count).into();
                Ok(Some(Page { number, bytes, byte, start, cells, cell: 0 }))
            }
            _ => Err(self.file.damaged(byte, "a page of a table has the wrong kind")),
        }
    }

    /// Reads a page, to which the page at `parent` refers. Returns `false` if the file is cut off before its end.
    fn read(&mut self, number: u32, parent: u64, bytes: &mut Vec<u8>) -> Result<bool, RecordingError> {
        let Some(index) = number.checked_sub(1).map(u64::from).filter(|index| *index < self.promised) else {
            return Err(self.file.damaged(parent, format!("it refers to page {number}, which does not exist")));
        };
        if index >= self.count {
            self.cut_off();
            return Ok(false);
        }
        self.read += 1;
        if self.read > self.count {
            return Err(self.file.damaged(parent, "its pages form a cycle"));
        }
        self.file.seek(index * self.size as u64)?;
        self.file.read(bytes, self.size as u64)?;
        Ok(true)
    }

    fn cut_off(&mut self) {
        let lost =
            counted(self.promised - self.count, "page of the database is missing", "pages of the database are missing");
        self.truncated = Some(Truncation { byte: self.count * self.size as u64, lost });
    }

    /// Fraction of the pages that has been read for the current table, 0 to 1.
    pub fn done(&self) -> f64 {
        share(self.read, self.count)
    }

    /// Names a write-ahead log that may be missing. SQLite removes it when a database is closed, so it is missing only
    /// if the database was copied while it was open.
    pub fn missing_log(&self) -> Option<String> {
        self.has_log.then(|| {
            format!(
                "the database was written with a write-ahead log: if it was copied during the recording, its latest messages are missing, because there is no file with the suffix {LOG}"
            )
        })
    }

    /// End of the file, if it comes before its last page.
    pub fn truncated(&self) -> Option<&Truncation> {
        self.truncated.as_ref()
    }

    /// Checks whether pages at the end of the file are missing, even if none of them was needed.
    pub fn finish(&mut self) {
        if self.count < self.promised {
            self.cut_off();
        }
    }

    /// Creates an error about the page at `byte`.
    pub fn damaged(&self, byte: u64, what: impl Into<String>) -> RecordingError {
        self.file.damaged(byte, what)
    }
}

/// Next element of a page.
enum Cell {
    /// The number of another page.
    Child(u32),
    /// The offset of a row.
    Row(usize),
    End,
}

/// A row whose part in its page has been read.
struct Begun {
    id: i64,
    length: usize,
    /// Number of the page with the rest of the row.
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
        let start = self.cell_start(index).ok_or("a page is shorter than its list of rows")?;
        if !inner {
            return Ok(Cell::Row(start));
        }
        number(&self.bytes, start).map(Cell::Child).ok_or("a page of a table is damaged")
    }
}

impl Page {
    /// Returns the offset of a cell, or of the number of the last child of an inner page, which has no cell.
    fn cell_start(&self, cell: usize) -> Option<usize> {
        let is_inner = matches!(self.bytes.get(self.start), Some(&(INNER | INDEX_INNER)));
        if cell >= self.cells && is_inner {
            return Some(self.start + 8);
        }
        let pointers = self.start + if is_inner { 12 } else { 8 };
        let offset = self.bytes.get(pointers + 2 * cell..)?.first_chunk()?;
        Some(u16::from_be_bytes(*offset).into())
    }
}

fn number(bytes: &[u8], from: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(from..)?.first_chunk()?))
}

/// Reads a number of 1 to 9 bytes: 7 bits per byte, 8 in the ninth. Returns it with the bytes that follow.
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

/// Returns the values of a row.
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

/// Returns the names of the columns in a text `CREATE TABLE name (column type, ...)`.
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
    fn numbers_use_as_few_bytes_as_needed() {
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
    fn rows_contain_values_of_every_kind() {
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
    fn columns_are_found_in_the_table_definition() {
        let sql =
            "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL, \"data\" BLOB DEFAULT (f(1, 2)))";
        assert_eq!(columns(sql), ["id", "topic_id", "data"]);
    }
}
