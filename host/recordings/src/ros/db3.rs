//! Bags of ROS 2 in SQLite: a table `topics` and a table `messages`, usually in order of recording. The order of the
//! index of the column `timestamp` counts.

use std::collections::BTreeMap;
use std::path::Path;

use super::container::{Container, MessageHead, Topic, unpack_message};
use super::fields::Wire;
use super::message::Kind;
use super::order::{Ordered, scan};
use super::sqlite::{self, Description, Pages, Table, Value, Walk};
use super::{events, extras};
use crate::bytes::share;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, Uses};
use crate::read_report::Truncation;

/// ROS 2 bag in SQLite.
pub const FORMAT: FileFormat = FileFormat {
    streams: |path, options| events::summarise(open, path, options),
    frames: Some(|path, options| extras::frames(open, path, options)),
    extras: Some(|path, options| extras::open(open, path, options)),
    uses: Uses { stream: true, ..Uses::NONE },
    ..FileFormat::of_events(
        "ROS 2 bag (SQLite)",
        |head| head.bytes.starts_with(sqlite::MAGIC),
        |path, options| events::open(FORMAT.name, open, path, options),
    )
};

struct Bag {
    pages: Pages,
    messages: Table,
    /// Index of the times, if rows are not in order of time, with the description of the messages.
    by_time: Option<(Walk, Description)>,
    /// Number of messages that were read, and number of all if the index contains it.
    count: (u64, u64),
    /// `true` if the index shows that no later message is earlier than the current one.
    is_settled: bool,
    /// Indices of the columns with the topic and the content of a message.
    columns: [usize; 2],
    /// Index of the column with the time of recording.
    time: Option<usize>,
    topics: Vec<Topic>,
    /// Indices of topics, by their number.
    indices: BTreeMap<i64, usize>,
    row: Vec<u8>,
    /// Content of the message, if it was compressed individually.
    unpacked: Vec<u8>,
}

/// Opens the bag at `path`.
pub fn open(path: &Path) -> Result<Box<dyn Container>, RecordingError> {
    let mut pages = Pages::open(path)?;
    let tables = pages.tables()?;
    let table = |name: &str, columns: &[&str]| {
        let found = tables.iter().find(|table| !table.is_index && table.name == name)?;
        Some((found, columns.iter().map(|column| found.column(column)).collect::<Option<Vec<_>>>()?))
    };
    let topics = table("topics", &["name", "type", "serialization_format"]);
    let messages = table("messages", &["topic_id", "data"]);
    let (Some((topics, topic_columns)), Some((messages, columns))) = (topics, messages) else {
        if let Some(truncated) = pages.truncated() {
            return Err(pages.damaged(truncated.byte, truncated.lost.clone()));
        }
        let names: Vec<&str> = tables.iter().map(|table| table.name.as_str()).collect();
        let what = format!("tables that are not those of a ROS 2 bag: {}", names.join(", "));
        return Err(RecordingError::new(path, RecordingErrorKind::NoEventStream(what)));
    };
    let known = read_topics(&mut pages, topics, &topic_columns)?;
    let columns = columns.try_into().unwrap_or_default();
    let time = messages.column("timestamp");
    let index = tables.iter().find(|index| index.orders(&messages.name, "timestamp"));
    let order = index.and_then(|index| Some((index, order_of(path, index).ok()??)));
    let by_time = order.filter(|(_, order)| !order.is_of_rows).map(|(index, _)| (index.walk(), messages.clone()));
    let (count, is_settled) = ((0, order.map_or(0, |(_, order)| order.count)), order.is_some());
    let bag = |pages: Pages, by_time: Option<(Walk, Description)>, known: (BTreeMap<i64, usize>, Vec<Topic>)| {
        let (indices, topics) = known;
        let (messages, row, unpacked) = (messages.open(), Vec::new(), Vec::new());
        Bag { pages, messages, by_time, count, is_settled, columns, time, topics, indices, row, unpacked }
    };
    let is_of_rows = by_time.is_some()
        && scan(&mut bag(Pages::open(path)?, None, known.clone())).is_some_and(|order| order.is_of_file());
    Ok(Box::new(Ordered::new(bag(pages, by_time.filter(|_| !is_of_rows), known))))
}

/// Order of an index.
#[derive(Clone, Copy)]
struct Order {
    /// `true` if the rows are in the same order.
    is_of_rows: bool,
    /// Number of entries.
    count: u64,
}

/// Reads the index of the times; `None` if the file is cut off.
fn order_of(path: &Path, index: &Description) -> Result<Option<Order>, RecordingError> {
    let (mut pages, mut walk) = (Pages::for_index(path)?, index.walk());
    let (mut order, mut last) = (Order { is_of_rows: true, count: 0 }, i64::MIN);
    while let Some((_, row)) = pages.next_entry(&mut walk)? {
        order.is_of_rows &= last <= row;
        order.count += 1;
        last = row;
    }
    Ok(pages.truncated().is_none().then_some(order))
}

/// Reads the topics, and returns them with their indices by number.
fn read_topics(
    pages: &mut Pages,
    table: &Description,
    columns: &[usize],
) -> Result<(BTreeMap<i64, usize>, Vec<Topic>), RecordingError> {
    let (mut rows, mut row) = (table.open(), Vec::new());
    let (mut indices, mut topics) = (BTreeMap::new(), Vec::new());
    while let Some((number, byte)) = pages.next(&mut rows, &mut row)? {
        let values = sqlite::values(&row).ok_or_else(|| pages.damaged(byte, "a topic cannot be read"))?;
        let text = |column: &usize| match values.get(*column) {
            Some(Value::Bytes(text)) => String::from_utf8_lossy(text).into_owned(),
            _ => String::new(),
        };
        let texts: Vec<String> = columns.iter().map(text).collect();
        let [name, type_name, format] = texts.as_slice() else { continue };
        let kind = if format == "cdr" { Kind::of_type(type_name) } else { Kind::Other };
        indices.entry(number).or_insert(topics.len());
        topics.push(Topic { name: name.clone(), type_name: type_name.clone(), kind, wire: Wire::Cdr });
    }
    Ok((indices, topics))
}

impl Bag {
    /// Reads the next row. Returns the offset of its page; `None` at the end.
    fn next_row(&mut self) -> Result<Option<u64>, RecordingError> {
        self.count.0 += 1;
        let Some((walk, messages)) = &mut self.by_time else {
            return Ok(self.pages.next(&mut self.messages, &mut self.row)?.map(|(_, byte)| byte));
        };
        match self.pages.next_entry(walk)? {
            Some((_, id)) => self.pages.row(messages, id, &mut self.row),
            None => Ok(None),
        }
    }
}

impl Container for Bag {
    fn next(&mut self) -> Result<Option<MessageHead>, RecordingError> {
        let Some(byte) = self.next_row()? else {
            self.pages.finish();
            return Ok(None);
        };
        let [topic, data] = self.columns;
        let values = sqlite::values(&self.row).unwrap_or_default();
        let time = match self.time.and_then(|time| values.get(time)) {
            Some(Value::Whole(time)) => *time,
            _ => i64::MIN,
        };
        let (Some(Value::Whole(topic)), Some(Value::Bytes(message))) = (values.get(topic), values.get(data)) else {
            return Err(self.pages.damaged(byte, "a message cannot be read"));
        };
        let Some(&topic) = self.indices.get(topic) else {
            return Err(self.pages.damaged(byte, "a message belongs to an unknown topic"));
        };
        unpack_message(message, &mut self.unpacked)
            .map_err(|error| self.pages.damaged(byte, format!("a message is damaged: {error}")))?;
        Ok(Some(MessageHead { topic, byte, time, is_settled: self.is_settled }))
    }

    fn message(&self) -> &[u8] {
        if !self.unpacked.is_empty() {
            return &self.unpacked;
        }
        let [_, data] = self.columns;
        match sqlite::values(&self.row).unwrap_or_default().get(data) {
            Some(Value::Bytes(message)) => message,
            _ => &[],
        }
    }

    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn listed(&mut self) -> Option<Vec<Topic>> {
        Some(self.topics.clone())
    }

    fn done(&self) -> f64 {
        let (read, all) = self.count;
        if all > 0 { share(read, all) } else { self.pages.done() }
    }

    fn truncated(&self) -> Option<&Truncation> {
        self.pages.truncated()
    }

    fn doubt(&self) -> Option<String> {
        self.pages.missing_log()
    }

    fn damaged(&self, byte: u64, what: String) -> RecordingError {
        self.pages.damaged(byte, what)
    }
}
