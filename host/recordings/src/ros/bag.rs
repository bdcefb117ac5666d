//! Bags of ROS 1, version 2.0.
//!
//! The file has a line `#ROSBAG V2.0`, then records: u32 length and header, u32 length and data. A header is a sequence
//! of fields, u32 length and `name=value`. The field `op` is the kind of the record: 5 a chunk (records, possibly
//! compressed with bz2 or LZ4), 7 a connection (a topic and its type), 2 a message. The other kinds are an index,
//! which contains the times of the chunks (kind 6) and is not needed otherwise.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

use super::container::{Budget, ChunkError, Container, MOST_UNPACKED, MessageHead, Packing, Topic, read_record};
use super::fields::Wire;
use super::message::Kind;
use super::order::{ChunkOrder, IndexedChunk, Ordered, scan};
use super::write::BAG_OUTPUT;
use super::{events, extras};
use crate::bytes::ByteReader;
use crate::counted::counted;
use crate::error::RecordingError;
use crate::format::{FileFormat, Uses};
use crate::read_report::Truncation;

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

/// ROS bag.
pub const FORMAT: FileFormat = FileFormat {
    output: Some(&BAG_OUTPUT),
    streams: |path, options| events::summarise(open, path, options),
    frames: Some(|path, options| extras::frames(open, path, options)),
    extras: Some(|path, options| extras::open(open, path, options)),
    uses: Uses { stream: true, ..Uses::NONE },
    ..FileFormat::of_events(
        "ROS bag",
        |head| head.bytes.starts_with(MAGIC),
        |path, options| events::open(FORMAT.name, open, path, options),
    )
};

const CHUNK: u8 = 5;
const CHUNK_INFO: u8 = 6;
const CONNECTION: u8 = 7;
const MESSAGE: u8 = 2;
/// Length limits of a record header in bytes. It contains at least `op`.
const LONGEST_RECORD_HEADER: u64 = 1 << 16;
const SHORTEST_RECORD_HEADER: u64 = 8;
/// Length limits in bytes of the file header and of the index. An hour of events has an index of some megabytes.
const LONGEST_HEADER: u64 = 1 << 13;
const LONGEST_INDEX: u64 = 1 << 26;

/// Opens the bag at `path`.
pub fn open(path: &Path) -> Result<Box<dyn Container>, RecordingError> {
    let mut bag = Bag::new(path)?;
    if let Some(Index { chunks, .. }) = bag.index()? {
        bag.order = ChunkOrder::new(chunks);
        if bag.order.is_moved() {
            let mut read = Bag::new(path)?;
            bag.order = scan(&mut read).unwrap_or_default();
            // A chunk may use connections of a chunk that precedes it in the file.
            (bag.topics, bag.connections, bag.indices) = (read.topics, read.connections, read.indices);
        }
    }
    bag.file.seek(MAGIC.len() as u64)?;
    Ok(Box::new(Ordered::new(bag)))
}

/// The index at the end of a bag.
struct Index {
    topics: Vec<Topic>,
    chunks: Vec<IndexedChunk>,
}

struct Bag {
    file: ByteReader,
    order: ChunkOrder,
    /// `true` if no message of another chunk precedes those of the current one.
    is_settled: bool,
    chunk: Chunk,
    header: Vec<u8>,
    packed: Vec<u8>,
    budget: Budget,
    topics: Vec<Topic>,
    /// Indices of topics, by the number of the connection.
    connections: BTreeMap<u32, usize>,
    /// Indices of topics, by name and type.
    indices: BTreeMap<(String, String), usize>,
    /// Range of the current message in the chunk.
    message: (usize, usize),
    truncated: Option<Truncation>,
    ended: bool,
}

/// A decompressed chunk. A message outside of chunks is treated as a chunk.
#[derive(Default)]
struct Chunk {
    bytes: Vec<u8>,
    position: usize,
    /// Offset of the chunk in the file.
    byte: u64,
}

/// A record: its header, its data, and its total length in bytes.
struct Record<'a> {
    header: &'a [u8],
    data: &'a [u8],
    length: usize,
}

fn part(bytes: &[u8], from: usize) -> Option<&[u8]> {
    let length = u32::from_le_bytes(*bytes.get(from..)?.first_chunk()?);
    bytes.get(from + 4..)?.get(..usize::try_from(length).ok()?)
}

fn record(bytes: &[u8], from: usize) -> Option<Record<'_>> {
    let header = part(bytes, from)?;
    let data = part(bytes, from + 4 + header.len())?;
    Some(Record { header, data, length: 8 + header.len() + data.len() })
}

/// Returns the value of a field in a header.
fn field<'a>(header: &'a [u8], name: &[u8]) -> Option<&'a [u8]> {
    let mut position = 0;
    while let Some(field) = part(header, position) {
        position += 4 + field.len();
        let equals = field.iter().position(|&byte| byte == b'=')?;
        if field.get(..equals) == Some(name) {
            return field.get(equals + 1..);
        }
    }
    None
}

fn number(header: &[u8], name: &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(*field(header, name)?.first_chunk()?))
}

/// Returns the time in ns of a field with seconds and nanoseconds.
fn time(header: &[u8], name: &[u8]) -> Option<i64> {
    let time = u64::from_le_bytes(*field(header, name)?.first_chunk()?);
    Some((time & 0xffff_ffff) as i64 * 1_000_000_000 + (time >> 32) as i64)
}

/// Returns the times of the messages in a chunk.
fn times(chunk: &[u8]) -> impl Iterator<Item = i64> {
    let mut position = 0;
    let records = std::iter::from_fn(move || {
        let record = record(chunk, position)?;
        position += record.length;
        Some(record.header)
    });
    records.filter(|header| operation(header) == Some(MESSAGE)).filter_map(|header| time(header, b"time"))
}

fn operation(header: &[u8]) -> Option<u8> {
    field(header, b"op")?.first().copied()
}

/// Returns the compression of a chunk with this header.
fn packing(header: &[u8]) -> Result<Packing, ChunkError> {
    match field(header, b"compression").unwrap_or_default() {
        b"none" => Ok(Packing::Plain),
        b"lz4" => Ok(Packing::Lz4),
        b"bz2" => Ok(Packing::Bzip2),
        _ => Err(ChunkError::Compression { known: "none, bz2 and lz4" }),
    }
}

/// Returns the topic in the record of a connection.
fn topic(record: &Record) -> Option<Topic> {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let name = text(field(record.header, b"topic")?);
    let type_name = text(field(record.data, b"type")?);
    Some(Topic { kind: Kind::of_type(&type_name), name, type_name, wire: Wire::Ros1 })
}

impl Bag {
    fn new(path: &Path) -> Result<Self, RecordingError> {
        let mut file = ByteReader::open(path)?;
        file.seek(MAGIC.len() as u64)?;
        let budget = Budget::of_file(file.length());
        Ok(Self {
            file,
            order: ChunkOrder::default(),
            is_settled: false,
            chunk: Chunk::default(),
            header: Vec::new(),
            packed: Vec::new(),
            budget,
            topics: Vec::new(),
            connections: BTreeMap::new(),
            indices: BTreeMap::new(),
            message: (0, 0),
            truncated: None,
            ended: false,
        })
    }

    /// Reads the index, which follows all chunks; `None` if there is none.
    fn index(&mut self) -> Result<Option<Index>, RecordingError> {
        let mut bytes = Vec::new();
        self.file.seek(MAGIC.len() as u64)?;
        self.file.read(&mut bytes, LONGEST_HEADER)?;
        let start = record(&bytes, 0)
            .and_then(|record| Some(u64::from_le_bytes(*field(record.header, b"index_pos")?.first_chunk()?)));
        let Some(start) = start.filter(|start| *start > MAGIC.len() as u64 && *start < self.file.length()) else {
            return Ok(None);
        };
        self.file.seek(start)?;
        self.file.read(&mut bytes, LONGEST_INDEX)?;
        let (mut index, mut position) = (Index { topics: Vec::new(), chunks: Vec::new() }, 0);
        while let Some(record) = record(&bytes, position) {
            match operation(record.header) {
                Some(CONNECTION) => index.topics.extend(topic(&record)),
                Some(CHUNK_INFO) => {
                    let start = time(record.header, b"start_time");
                    let byte = field(record.header, b"chunk_pos").and_then(|byte| byte.first_chunk());
                    let byte = byte.map(|byte| u64::from_le_bytes(*byte));
                    index.chunks.extend(start.zip(byte).map(|(start, byte)| IndexedChunk { start, byte }));
                }
                _ => break,
            }
            position += record.length;
        }
        Ok((!index.topics.is_empty()).then_some(index))
    }

    /// Reads the next record with content as the current chunk. Returns `false` at the end.
    fn next_chunk(&mut self) -> Result<bool, RecordingError> {
        loop {
            match self.order.next() {
                None => {}
                Some(Some(byte)) => self.file.seek(byte)?,
                Some(None) => return Ok(false),
            }
            let start = self.file.position();
            if self.file.left() == 0 {
                return Ok(false);
            }
            let Some(header_length) = self.length(start)? else { return Ok(false) };
            if !(SHORTEST_RECORD_HEADER..=LONGEST_RECORD_HEADER).contains(&header_length) {
                // Without this length, the next record cannot be found.
                let what = format!("the header of a record states a length of {header_length} bytes");
                let lost = format!("records cannot be found: {what}");
                self.truncated = Some(Truncation { byte: start, lost });
                self.ended = true;
                return Err(self.file.damaged(start, what));
            }
            self.file.read(&mut self.header, header_length)?;
            let Some(operation) = operation(&self.header) else {
                if let Some(length) = self.length(start)? {
                    self.file.seek(self.file.position() + length)?;
                }
                return Err(self.file.damaged(start, "a record has an invalid header"));
            };
            let Some(length) = self.length(start)? else {
                return if operation == CHUNK { self.take_beginning(start) } else { Ok(false) };
            };
            match operation {
                CHUNK => {
                    read_record(&mut self.file, start, length, &mut self.packed)?;
                    self.unpack(start)?;
                    self.is_settled = self.order.is_settled(start, times(&self.chunk.bytes));
                    return Ok(true);
                }
                CONNECTION | MESSAGE => {
                    read_record(&mut self.file, start, length, &mut self.packed)?;
                    let bytes = &mut self.chunk.bytes;
                    bytes.clear();
                    for part in [&self.header, &self.packed] {
                        bytes.extend_from_slice(&u32::try_from(part.len()).unwrap_or(u32::MAX).to_le_bytes());
                        bytes.extend_from_slice(part);
                    }
                    (self.chunk.position, self.chunk.byte) = (0, start);
                    self.is_settled = false;
                    return Ok(true);
                }
                _ => self.file.seek(self.file.position() + length)?,
            }
        }
    }

    /// Reads the length of the next part of a record. Returns `None` if the file ends before the end of that part.
    fn length(&mut self, record: u64) -> Result<Option<u64>, RecordingError> {
        let length = self.file.array()?.map(|bytes| u64::from(u32::from_le_bytes(bytes)));
        if let Some(length) = length.filter(|length| *length <= self.file.left()) {
            return Ok(Some(length));
        }
        let lost = format!(
            "a record is incomplete: {}",
            counted(self.file.left(), "byte of it is left", "bytes of it are left")
        );
        self.truncated = Some(Truncation { byte: record, lost });
        self.ended = true;
        Ok(None)
    }

    /// Decompresses the available part of a chunk that is cut off. Returns `false` if it is empty.
    fn take_beginning(&mut self, start: u64) -> Result<bool, RecordingError> {
        // With a wrong length, this could be the whole rest of the file.
        self.file.read(&mut self.packed, self.file.left().min(MOST_UNPACKED))?;
        match packing(&self.header) {
            Ok(packing) => packing.unpack_beginning(&self.packed, &mut self.chunk.bytes),
            Err(_) => self.chunk.bytes.clear(),
        }
        (self.chunk.position, self.chunk.byte) = (0, start);
        self.is_settled = false;
        Ok(!self.chunk.bytes.is_empty())
    }

    fn unpack(&mut self, start: u64) -> Result<(), RecordingError> {
        let size = number(&self.header, b"size").map_or(0, u64::from);
        let done = packing(&self.header)
            .and_then(|packing| packing.unpack(&self.packed, size, &mut self.chunk.bytes, &mut self.budget));
        (self.chunk.position, self.chunk.byte) = (0, start);
        done.map_err(|what| {
            self.chunk.bytes.clear();
            what.of_chunk(&self.file, start)
        })
    }

    fn connect(&mut self, connection: u32, topic: Topic) {
        if let Entry::Vacant(vacant) = self.connections.entry(connection) {
            let index = self.indices.entry((topic.name.clone(), topic.type_name.clone())).or_insert(self.topics.len());
            vacant.insert(*index);
            if *index == self.topics.len() {
                self.topics.push(topic);
            }
        }
    }
}

impl Container for Bag {
    fn next(&mut self) -> Result<Option<MessageHead>, RecordingError> {
        loop {
            if self.chunk.position >= self.chunk.bytes.len() {
                if self.ended || !self.next_chunk()? {
                    return Ok(None);
                }
                continue;
            }
            let position = self.chunk.position;
            let Some(record) = record(&self.chunk.bytes, position) else {
                self.chunk.bytes.clear();
                if self.truncated.is_some() {
                    return Ok(None);
                }
                return Err(self.file.damaged(self.chunk.byte, "a record of a chunk is longer than the chunk"));
            };
            let (operation, connection) = (operation(record.header), number(record.header, b"conn"));
            let (length, data, time) = (record.length, record.data.len(), time(record.header, b"time"));
            self.chunk.position += length;
            match operation {
                Some(CONNECTION) if connection.is_some_and(|number| self.connections.contains_key(&number)) => {}
                Some(CONNECTION) => match connection.zip(topic(&record)) {
                    Some((number, topic)) => self.connect(number, topic),
                    None => return Err(self.file.damaged(self.chunk.byte, "a connection names no topic or no type")),
                },
                Some(MESSAGE) => {
                    let Some(&topic) = connection.and_then(|connection| self.connections.get(&connection)) else {
                        return Err(self.file.damaged(self.chunk.byte, "a message belongs to an unknown connection"));
                    };
                    self.message = (position + length - data, position + length);
                    let (byte, is_settled) = (self.chunk.byte, self.is_settled);
                    return Ok(Some(MessageHead { topic, byte, time: time.unwrap_or(i64::MIN), is_settled }));
                }
                _ => {}
            }
        }
    }

    fn message(&self) -> &[u8] {
        self.chunk.bytes.get(self.message.0..self.message.1).unwrap_or_default()
    }

    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn listed(&mut self) -> Option<Vec<Topic>> {
        let position = self.file.position();
        let index = self.index().ok().flatten();
        self.file.seek(position).ok()?;
        Some(index?.topics)
    }

    fn done(&self) -> f64 {
        self.file.done()
    }

    fn truncated(&self) -> Option<&Truncation> {
        self.truncated.as_ref()
    }

    fn damaged(&self, byte: u64, what: String) -> RecordingError {
        self.file.damaged(byte, what)
    }
}
