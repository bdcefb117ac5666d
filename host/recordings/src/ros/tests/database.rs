//! SQLite files of ROS 2, built page by page.

use super::Messages;

const PAGE: usize = 512;

/// Encodes a number in 1 to 3 bytes.
fn varint(value: usize) -> Vec<u8> {
    let seven = |shift: usize| (value >> shift & 0x7f) as u8;
    match value {
        0..0x80 => vec![seven(0)],
        0x80..0x4000 => vec![seven(7) | 0x80, seven(0)],
        _ => vec![seven(14) | 0x80, seven(7) | 0x80, seven(0)],
    }
}

enum Field<'a> {
    Null,
    Number(u8),
    Time(i64),
    Text(&'a str),
    Bytes(&'a [u8]),
}

fn row(fields: &[Field]) -> Vec<u8> {
    let (mut types, mut content) = (Vec::new(), Vec::new());
    for field in fields {
        let (kind, bytes) = match field {
            Field::Null => (0, Vec::new()),
            Field::Number(value) => (1, vec![*value]),
            Field::Time(value) => (6, value.to_be_bytes().to_vec()),
            Field::Text(text) => (13 + 2 * text.len(), text.as_bytes().to_vec()),
            Field::Bytes(bytes) => (12 + 2 * bytes.len(), bytes.to_vec()),
        };
        types.extend(varint(kind));
        content.extend(bytes);
    }
    [&varint(types.len() + 1)[..], &types, &content].concat()
}

/// Builds a leaf (kind 13) or an inner page (5) with these cells. An inner page also has `last`, its last child.
fn page(kind: u8, cells: &[Vec<u8>], last: Option<u32>, header: &[u8]) -> Vec<u8> {
    let mut page = header.to_vec();
    page.extend([&[kind, 0, 0][..], &(cells.len() as u16).to_be_bytes(), &[0, 0, 0]].concat());
    page.extend(last.iter().flat_map(|last| last.to_be_bytes()));
    let mut end = PAGE;
    for cell in cells {
        end -= cell.len();
        page.extend((end as u16).to_be_bytes());
    }
    assert!(page.len() <= end);
    page.resize(end, 0);
    cells.iter().rev().for_each(|cell| page.extend(cell));
    page
}

/// Builds the cell of a row. The part that is too long for it goes to overflow pages, which are appended to `pages`.
fn cell(id: usize, row: &[u8], pages: &mut Vec<Vec<u8>>) -> Vec<u8> {
    let head = [varint(row.len()), varint(id)].concat();
    if row.len() <= PAGE - 35 {
        return [&head[..], row].concat();
    }
    let filled = 39 + (row.len() - 39) % (PAGE - 4);
    let local = if filled <= PAGE - 35 { filled } else { 39 };
    let (here, rest) = row.split_at(local);
    let cell = [&head[..], here, &(pages.len() as u32 + 1).to_be_bytes()].concat();
    let count = rest.len().div_ceil(PAGE - 4);
    for (index, part) in rest.chunks(PAGE - 4).enumerate() {
        let next = if index + 1 < count { pages.len() as u32 + 2 } else { 0 };
        let mut page = [&next.to_be_bytes()[..], part].concat();
        page.resize(PAGE, 0);
        pages.push(page);
    }
    cell
}

/// Builds a bag with two messages per page, without an index.
pub fn bag(messages: &Messages) -> Vec<u8> {
    build(messages, None)
}

/// Builds a bag with these times of the messages, and an index of them.
pub fn indexed_bag(messages: &Messages, times: &[i64]) -> Vec<u8> {
    build(messages, Some(times))
}

fn build(messages: &Messages, times: Option<&[i64]>) -> Vec<u8> {
    let mut topics: Vec<(&str, &str)> = Vec::new();
    // Page 1 contains the schema, page 2 the topics, page 3 the root of the messages.
    let mut pages = vec![Vec::new(); 3];
    let mut children: Vec<(u32, usize)> = Vec::new();
    for (index, part) in messages.chunks(2).enumerate() {
        let mut cells = Vec::new();
        for (offset, (name, type_name, message)) in part.iter().enumerate() {
            let known = topics.iter().position(|(known, _)| known == name);
            let topic = known.unwrap_or(topics.len()) as u8 + 1;
            if known.is_none() {
                topics.push((name, type_name));
            }
            let time = times.map_or(-1, |times| times[2 * index + offset]);
            let fields = [Field::Null, Field::Number(topic), Field::Time(time), Field::Bytes(message)];
            cells.push(cell(2 * index + offset + 1, &row(&fields), &mut pages));
        }
        // Two long rows do not fit in a page.
        for (offset, cell) in cells.iter().enumerate() {
            pages.push(page(13, std::slice::from_ref(cell), None, &[]));
            children.push((pages.len() as u32, 2 * index + offset + 1));
        }
    }
    let last = children.pop().unwrap();
    let inner: Vec<_> = children.iter().map(|(page, id)| [&page.to_be_bytes()[..], &varint(*id)].concat()).collect();
    pages[2] = page(5, &inner, Some(last.0), &[]);
    let topic = |(index, (name, type_name)): (usize, &(&str, &str))| {
        let fields = [Field::Null, Field::Text(name), Field::Text(type_name), Field::Text("cdr"), Field::Text("")];
        cell(index + 1, &row(&fields), &mut Vec::new())
    };
    pages[1] = page(13, &topics.iter().enumerate().map(topic).collect::<Vec<_>>(), None, &[]);
    let root = times.map(|times| index(times, &mut pages));
    pages[0] = first_page(pages.len() as u32, root);
    pages.concat()
}

/// Appends the pages of an index of these times: leaves of ten entries below an inner page, whose cells are entries
/// too. Returns the number of the root.
fn index(times: &[i64], pages: &mut Vec<Vec<u8>>) -> u8 {
    let mut entries: Vec<(i64, u8)> = times.iter().zip(1..).map(|(time, id)| (*time, id)).collect();
    entries.sort_unstable();
    let entry = |(time, id): (i64, u8)| {
        let row = row(&[Field::Time(time), Field::Number(id)]);
        [varint(row.len()), row].concat()
    };
    let (mut inner, mut last) = (Vec::new(), 0);
    for part in entries.chunks(11) {
        let (leaf, above) = part.split_at(part.len().min(10));
        pages.push(page(10, &leaf.iter().map(|it| entry(*it)).collect::<Vec<_>>(), None, &[]));
        last = pages.len() as u32;
        inner.extend(above.iter().map(|it| [last.to_be_bytes().to_vec(), entry(*it)].concat()));
    }
    if inner.len() == entries.chunks(11).len() {
        pages.push(page(10, &[], None, &[]));
        last = pages.len() as u32;
    }
    pages.push(page(2, &inner, Some(last), &[]));
    pages.len() as u8
}

fn first_page(count: u32, index: Option<u8>) -> Vec<u8> {
    let mut header = b"SQLite format 3\0".to_vec();
    header.extend([2, 0, 1, 1, 0, 64, 32, 32, 0, 0, 0, 1]);
    header.extend(count.to_be_bytes());
    header.resize(100, 0);
    (header[59], header[95]) = (1, 1);
    let item = |id: usize, kind: &str, name: &str, root: u8, sql: &str| {
        let fields = [Field::Text(kind), Field::Text(name), Field::Text(name), Field::Number(root), Field::Text(sql)];
        cell(id, &row(&fields), &mut Vec::new())
    };
    let table = |id: usize, name: &str, root: u8, sql: &str| item(id, "table", name, root, sql);
    let topics = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, offered_qos_profiles)";
    let messages = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)";
    let sql = "CREATE INDEX i ON messages (timestamp ASC)";
    let index = index.map(|root| item(3, "index", "messages", root, sql));
    let tables = [table(1, "topics", 2, topics), table(2, "messages", 3, messages)];
    page(13, &tables.into_iter().chain(index).collect::<Vec<_>>(), None, &header)
}
