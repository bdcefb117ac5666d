//! Bags of ROS 1, version 2.0.
//!
//! The file has a line `#ROSBAG V2.0`, then records: u32 length and header, u32 length and data. A header is a sequence
//! of fields, u32 length and `name=value`. The field `op` is the kind of the record: 5 a chunk (records, possibly
//! compressed with bz2 or LZ4), 7 a connection (a topic and its type), 2 a message. The other kinds are an index,
//! which contains the times of the chunks (kind 6) and is not needed otherwise.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use super::chunked::{self, ChunkedFile, Index, Records};
use super::container::{ChunkError, Packing, Topic, read_record};
use super::fields::Wire;
use super::message::Kind;
use super::order::IndexedChunk;
use super::write::BAG_OUTPUT;
use super::{events, extras};
use crate::counted::counted;
use crate::error::RecordingError;
use crate::format::{FileFormat, Uses};

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

/// ROS bag.
pub const FORMAT: FileFormat = FileFormat {
    output: Some(&BAG_OUTPUT),
    streams: |path, options| events::summarise(chunked::open::<Bag>, path, options),
    frames: Some(|path, options| extras::frames(chunked::open::<Bag>, path, options)),
    extras: Some(|path, options| extras::open(chunked::open::<Bag>, path, options)),
    uses: Uses { stream: true, ..Uses::NONE },
    ..FileFormat::of_events(
        "ROS bag",
        |head| head.bytes.starts_with(MAGIC),
        |path, options| events::open(FORMAT.name, chunked::open::<Bag>, path, options),
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

/// The topics of a bag.
#[derive(Default)]
pub struct Bag {
    /// Header of a record outside of chunks.
    header: Vec<u8>,
    topics: Vec<Topic>,
    /// Indices of topics, by the number of the connection.
    connections: BTreeMap<u32, usize>,
    /// Indices of topics, by name and type.
    indices: BTreeMap<(String, String), usize>,
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
    /// Reads the length of the next part of a record. Returns `None` if the file ends before the end of that part.
    fn length(file: &mut ChunkedFile, record: u64) -> Result<Option<u64>, RecordingError> {
        let length = file.file.array()?.map(|bytes| u64::from(u32::from_le_bytes(bytes)));
        let left = file.file.left();
        if let Some(length) = length.filter(|length| *length <= left) {
            return Ok(Some(length));
        }
        let rest = counted(left, "byte of it is left", "bytes of it are left");
        file.end(record, format!("a record is incomplete: {rest}"));
        Ok(None)
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

impl Records for Bag {
    const MAGIC: &'static [u8] = MAGIC;

    fn index(ChunkedFile { file, .. }: &mut ChunkedFile) -> Result<Option<Index>, RecordingError> {
        let mut bytes = Vec::new();
        file.seek(MAGIC.len() as u64)?;
        file.read(&mut bytes, LONGEST_HEADER)?;
        let start = record(&bytes, 0)
            .and_then(|record| Some(u64::from_le_bytes(*field(record.header, b"index_pos")?.first_chunk()?)));
        let Some(start) = start.filter(|start| *start > MAGIC.len() as u64 && *start < file.length()) else {
            return Ok(None);
        };
        file.seek(start)?;
        file.read(&mut bytes, LONGEST_INDEX)?;
        let (mut index, mut position) = (Index::default(), 0);
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

    fn next_chunk(&mut self, file: &mut ChunkedFile) -> Result<bool, RecordingError> {
        while let Some(start) = file.seek_next()?.filter(|_| file.file.left() > 0) {
            let Some(header_length) = Self::length(file, start)? else { return Ok(false) };
            if !(SHORTEST_RECORD_HEADER..=LONGEST_RECORD_HEADER).contains(&header_length) {
                // Without this length, the next record cannot be found.
                let what = format!("the header of a record states a length of {header_length} bytes");
                file.end(start, format!("records cannot be found: {what}"));
                return Err(file.file.damaged(start, what));
            }
            file.file.read(&mut self.header, header_length)?;
            let Some(operation) = operation(&self.header) else {
                if let Some(length) = Self::length(file, start)? {
                    file.file.seek(file.file.position() + length)?;
                }
                return Err(file.file.damaged(start, "a record has an invalid header"));
            };
            let length = match Self::length(file, start)? {
                Some(length) => length,
                None if operation == CHUNK => {
                    file.read_beginning(start)?;
                    if let Ok(packing) = packing(&self.header) {
                        packing.unpack_beginning(&file.packed, &mut file.records);
                    }
                    return Ok(!file.records.is_empty());
                }
                None => return Ok(false),
            };
            match operation {
                CHUNK => {
                    read_record(&mut file.file, start, length, &mut file.packed)?;
                    file.begin(start);
                    let size = number(&self.header, b"size").map_or(0, u64::from);
                    let unpacked = packing(&self.header)
                        .and_then(|it| it.unpack(&file.packed, size, &mut file.records, &mut file.budget));
                    file.check(unpacked)?;
                    file.is_settled = file.order.is_settled(start, times(&file.records));
                    return Ok(true);
                }
                CONNECTION | MESSAGE => {
                    read_record(&mut file.file, start, length, &mut file.packed)?;
                    file.begin(start);
                    file.records.clear();
                    for part in [&self.header, &file.packed] {
                        file.records.extend_from_slice(&u32::try_from(part.len()).unwrap_or(u32::MAX).to_le_bytes());
                        file.records.extend_from_slice(part);
                    }
                    return Ok(true);
                }
                _ => file.file.seek(file.file.position() + length)?,
            }
        }
        Ok(false)
    }

    fn next_record(&mut self, file: &mut ChunkedFile) -> Result<Option<(usize, i64)>, RecordingError> {
        let position = file.position;
        let Some(record) = record(&file.records, position) else { return file.drop_rest() };
        let connection = number(record.header, b"conn");
        file.position += record.length;
        match operation(record.header) {
            Some(CONNECTION) if connection.is_some_and(|number| self.connections.contains_key(&number)) => {}
            Some(CONNECTION) => match connection.zip(topic(&record)) {
                Some((number, topic)) => self.connect(number, topic),
                None => return Err(file.damaged("a connection names no topic or no type")),
            },
            Some(MESSAGE) => {
                let Some(&topic) = connection.and_then(|connection| self.connections.get(&connection)) else {
                    return Err(file.damaged("a message belongs to an unknown connection"));
                };
                let time = time(record.header, b"time").unwrap_or(i64::MIN);
                file.message = file.position - record.data.len()..file.position;
                return Ok(Some((topic, time)));
            }
            _ => {}
        }
        Ok(None)
    }

    fn topics(&self) -> &[Topic] {
        &self.topics
    }
}
