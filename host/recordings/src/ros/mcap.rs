//! MCAP, the usual container of ROS 2.
//!
//! The file consists of records of u8 kind, u64 length and content. Kinds are 3 a schema (the type of messages), 4 a
//! channel (a topic), 5 a message, 6 a chunk of such records (possibly compressed with LZ4 or Zstandard), 15 the end of
//! the data. A summary follows, which contains the times of the chunks (kind 8) and is not needed otherwise.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

use flate2::Crc;

use super::container::{
    Budget, ChunkError, Container, MOST_UNPACKED, MessageHead, Packing, Topic, read_record, unpack_message,
};
use super::fields::{Fields, MessageError, Wire};
use super::message::Kind;
use super::order::{ChunkOrder, IndexedChunk, Ordered, scan};
use super::write::MCAP_OUTPUT;
use super::{events, extras};
use crate::bytes::ByteReader;
use crate::error::RecordingError;
use crate::format::{FileFormat, Uses};
use crate::read_report::Truncation;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// MCAP.
pub const FORMAT: FileFormat = FileFormat {
    output: Some(&MCAP_OUTPUT),
    streams: |path, options| events::summarise(open, path, options),
    frames: Some(|path, options| extras::frames(open, path, options)),
    extras: Some(|path, options| extras::open(open, path, options)),
    uses: Uses { stream: true, ..Uses::NONE },
    ..FileFormat::of_events(
        "MCAP",
        |head| head.bytes.starts_with(MAGIC),
        |path, options| events::open(FORMAT.name, open, path, options),
    )
};

const SCHEMA: u8 = 3;
const CHANNEL: u8 = 4;
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const CHUNK_INDEX: u8 = 8;
const DATA_END: u8 = 15;
/// Size of a record's kind and length in bytes.
const RECORD_HEAD: usize = 9;
const FOOTER_RECORD: u8 = 2;
/// Size in bytes of the footer, which contains the position of the summary, and of the mark at the end of the file.
const FOOTER: u64 = 9 + 20 + 8;
/// Size limit of the summary in bytes.
const LONGEST_SUMMARY: u64 = 1 << 24;

/// Opens the MCAP file at `path`.
pub fn open(path: &Path) -> Result<Box<dyn Container>, RecordingError> {
    let mut mcap = Mcap::new(path)?;
    if let Some(Summary { chunks, .. }) = mcap.summary()? {
        mcap.order = ChunkOrder::new(chunks);
        if mcap.order.is_moved() {
            let mut read = Mcap::new(path)?;
            mcap.order = scan(&mut read).unwrap_or_default();
            // A chunk may use channels of a chunk that precedes it in the file.
            mcap.described = read.described;
        }
    }
    mcap.file.seek(MAGIC.len() as u64)?;
    Ok(Box::new(Ordered::new(mcap)))
}

/// The summary at the end of a file.
#[derive(Default)]
struct Summary {
    described: Described,
    chunks: Vec<IndexedChunk>,
}

impl Summary {
    fn add(&mut self, kind: u8, content: &[u8]) -> Result<(), MessageError> {
        match kind {
            SCHEMA | CHANNEL => self.described.add(kind, content)?,
            CHUNK_INDEX => {
                let mut fields = Fields::new(Wire::Ros1, content)?;
                let (start, _, byte) = (fields.u64("a time")?, fields.u64("a time")?, fields.u64("an offset")?);
                self.chunks.push(IndexedChunk { start: nanoseconds(start), byte });
            }
            _ => {}
        }
        Ok(())
    }
}

fn nanoseconds(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}

struct Mcap {
    file: ByteReader,
    order: ChunkOrder,
    /// `true` if no message of another chunk precedes those of the current one.
    is_settled: bool,
    /// The records of a chunk, or a single record outside of chunks.
    records: Vec<u8>,
    position: usize,
    /// Offset of the records in the file.
    byte: u64,
    packed: Vec<u8>,
    described: Described,
    /// Range of the current message in the records.
    message: (usize, usize),
    /// Content of the message, if it was compressed individually.
    unpacked: Vec<u8>,
    budget: Budget,
    truncated: Option<Truncation>,
    ended: bool,
}

fn text(fields: &mut Fields) -> Result<String, MessageError> {
    Ok(String::from_utf8_lossy(fields.text("a name")?).into_owned())
}

/// Returns the compression with this name.
fn packing(compression: &[u8]) -> Result<Packing, ChunkError> {
    match compression {
        b"" => Ok(Packing::Plain),
        b"lz4" => Ok(Packing::Lz4),
        b"zstd" => Ok(Packing::Zstandard),
        _ => Err(ChunkError::Compression { known: "lz4 and zstd" }),
    }
}

/// Head of a chunk, with its content.
struct ChunkHead<'a> {
    /// Decompressed size in bytes.
    size: u64,
    /// CRC-32 of the decompressed content; 0 if it was not computed.
    checksum: u32,
    compression: &'a [u8],
    /// Compressed size in bytes.
    length: u64,
    packed: &'a [u8],
}

impl<'a> ChunkHead<'a> {
    fn of(content: &'a [u8]) -> Result<Self, MessageError> {
        let mut fields = Fields::new(Wire::Ros1, content)?;
        fields.u64("its head")?;
        fields.u64("its head")?;
        let size = fields.u64("its head")?;
        let checksum = fields.u32("its head")?;
        let compression = fields.text("its head")?;
        let length = fields.u64("its head")?;
        Ok(Self { size, checksum, compression, length, packed: fields.rest() })
    }
}

impl Mcap {
    fn new(path: &Path) -> Result<Self, RecordingError> {
        let mut file = ByteReader::open(path)?;
        file.seek(MAGIC.len() as u64)?;
        let budget = Budget::of_file(file.length());
        Ok(Self {
            file,
            order: ChunkOrder::default(),
            is_settled: false,
            records: Vec::new(),
            position: 0,
            byte: 0,
            packed: Vec::new(),
            described: Described::default(),
            message: (0, 0),
            unpacked: Vec::new(),
            budget,
            truncated: None,
            ended: false,
        })
    }

    /// Reads the next record of the file, or the records of the next chunk. Returns `false` at the end.
    fn next_records(&mut self) -> Result<bool, RecordingError> {
        loop {
            match self.order.next() {
                None => {}
                Some(Some(byte)) => self.file.seek(byte)?,
                Some(None) => return Ok(false),
            }
            let start = self.file.position();
            let Some([kind, length @ ..]) = self.file.array::<RECORD_HEAD>()? else {
                return self.cut_off(start);
            };
            let length = u64::from_le_bytes(length);
            if length > self.file.left() {
                self.cut_off(start)?;
                return if kind == CHUNK { self.take_beginning(start) } else { Ok(false) };
            }
            match kind {
                CHUNK => {
                    read_record(&mut self.file, start, length, &mut self.packed)?;
                    (self.position, self.byte) = (0, start);
                    self.unpack().map_err(|what| {
                        self.records.clear();
                        what.of_chunk(&self.file, start)
                    })?;
                    self.is_settled = self.order.is_settled(start, times(&self.records));
                    return Ok(true);
                }
                SCHEMA | CHANNEL | MESSAGE => {
                    read_record(&mut self.file, start, length, &mut self.packed)?;
                    self.records.clear();
                    self.records.push(kind);
                    self.records.extend_from_slice(&length.to_le_bytes());
                    self.records.extend_from_slice(&self.packed);
                    (self.position, self.byte, self.is_settled) = (0, start, false);
                    return Ok(true);
                }
                DATA_END => {
                    self.ended = true;
                    return Ok(false);
                }
                _ => self.file.seek(self.file.position() + length)?,
            }
        }
    }

    fn cut_off(&mut self, byte: u64) -> Result<bool, RecordingError> {
        let lost = "the end of the data is missing".to_owned();
        self.truncated = Some(Truncation { byte, lost });
        self.ended = true;
        Ok(false)
    }

    /// Decompresses the available part of a chunk that is cut off. Returns `false` if it is empty.
    fn take_beginning(&mut self, start: u64) -> Result<bool, RecordingError> {
        // With a wrong length, this could be the whole rest of the file.
        self.file.read(&mut self.packed, self.file.left().min(MOST_UNPACKED))?;
        (self.position, self.byte, self.is_settled) = (0, start, false);
        self.records.clear();
        let Ok(ChunkHead { compression, packed, .. }) = ChunkHead::of(&self.packed) else { return Ok(false) };
        if let Ok(packing) = packing(compression) {
            packing.unpack_beginning(packed, &mut self.records);
        }
        Ok(!self.records.is_empty())
    }

    fn unpack(&mut self) -> Result<(), ChunkError> {
        let ChunkHead { size, checksum, compression, length, packed } = ChunkHead::of(&self.packed)?;
        let packed = usize::try_from(length).ok().and_then(|length| packed.get(..length));
        let packed = packed.ok_or(ChunkError::Short)?;
        packing(compression)?.unpack(packed, size, &mut self.records, &mut self.budget)?;
        let mut crc = Crc::new();
        if checksum != 0 {
            crc.update(&self.records);
        }
        if crc.sum() == checksum { Ok(()) } else { Err(ChunkError::Checksum { stated: checksum, found: crc.sum() }) }
    }

    /// Reads the summary, which follows all messages; `None` if there is none.
    fn summary(&mut self) -> Result<Option<Summary>, RecordingError> {
        let end = self.file.length().saturating_sub(FOOTER);
        self.file.seek(end)?;
        let Some([kind, _, _, _, _, _, _, _, _, start @ ..]) = self.file.array::<{ RECORD_HEAD + 8 }>()? else {
            return Ok(None);
        };
        let start = u64::from_le_bytes(start);
        if kind != FOOTER_RECORD || start == 0 || start >= end {
            return Ok(None);
        }
        self.file.seek(start)?;
        let mut bytes = Vec::new();
        self.file.read(&mut bytes, LONGEST_SUMMARY.min(end - start))?;
        let mut summary = Summary::default();
        Ok(records(&bytes).try_for_each(|(kind, content)| summary.add(kind, content)).is_ok().then_some(summary))
    }
}

/// Returns the kinds and contents of consecutive records.
fn records(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (&[kind, ref length @ ..], after) = bytes.split_first_chunk::<RECORD_HEAD>()?;
        let (content, after) = after.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
        bytes = after;
        Some((kind, content))
    })
}

/// Returns the time of recording of a message, which follows the numbers of the channel and of the message.
fn time(message: &[u8]) -> Option<i64> {
    Some(nanoseconds(u64::from_le_bytes(*message.get(6..)?.first_chunk()?)))
}

/// Returns the times of the messages in a chunk.
fn times(chunk: &[u8]) -> impl Iterator<Item = i64> {
    records(chunk).filter(|(kind, _)| *kind == MESSAGE).filter_map(|(_, message)| time(message))
}

/// Schemas and channels found so far.
#[derive(Default)]
struct Described {
    /// Names of schemas, by number.
    schemas: BTreeMap<u16, String>,
    /// Indices of topics, by number of the channel.
    channels: BTreeMap<u16, usize>,
    topics: Vec<Topic>,
}

impl Described {
    /// Adds a schema or channel.
    fn add(&mut self, kind: u8, content: &[u8]) -> Result<(), MessageError> {
        let mut fields = Fields::new(Wire::Ros1, content)?;
        let id = fields.u16("its number")?;
        if kind == SCHEMA {
            self.schemas.insert(id, text(&mut fields)?);
            return Ok(());
        }
        let schema = fields.u16("its schema")?;
        let (name, encoding) = (text(&mut fields)?, text(&mut fields)?);
        let type_name = self.schemas.get(&schema).cloned().unwrap_or_default();
        let (known_kind, wire) = match encoding.as_str() {
            "cdr" => (Kind::of_type(&type_name), Wire::Cdr),
            "ros1" => (Kind::of_type(&type_name), Wire::Ros1),
            _ => (Kind::Other, Wire::Ros1),
        };
        if let Entry::Vacant(channel) = self.channels.entry(id) {
            channel.insert(self.topics.len());
            self.topics.push(Topic { name, type_name, kind: known_kind, wire });
        }
        Ok(())
    }
}

impl Container for Mcap {
    fn next(&mut self) -> Result<Option<MessageHead>, RecordingError> {
        loop {
            let Some(head) = self.records.get(self.position..).filter(|rest| !rest.is_empty()) else {
                if self.ended || !self.next_records()? {
                    return Ok(None);
                }
                continue;
            };
            let end = head.split_first_chunk::<RECORD_HEAD>().and_then(|(&[_, ref length @ ..], _)| {
                let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
                let end = self.position.checked_add(RECORD_HEAD)?.checked_add(length)?;
                (end <= self.records.len()).then_some(end)
            });
            let (Some(end), Some(&kind)) = (end, head.first()) else {
                self.records.clear();
                if self.truncated.is_some() {
                    return Ok(None);
                }
                return Err(self.file.damaged(self.byte, "a record of a chunk is longer than the chunk"));
            };
            let start = self.position + RECORD_HEAD;
            self.position = end;
            match kind {
                SCHEMA | CHANNEL => self
                    .described
                    .add(kind, self.records.get(start..end).unwrap_or_default())
                    .map_err(|error| self.file.damaged(self.byte, format!("a channel is damaged: {error}")))?,
                MESSAGE => {
                    // Channel, number, and two times.
                    let content = self.records.get(start..end);
                    let time = content.and_then(time).unwrap_or(i64::MIN);
                    let channel = content.and_then(|content| content.first_chunk());
                    let channel = channel.map(|bytes| u16::from_le_bytes(*bytes));
                    let Some(&topic) = channel.and_then(|channel| self.described.channels.get(&channel)) else {
                        return Err(self.file.damaged(self.byte, "a message belongs to an unknown channel"));
                    };
                    self.message = ((start + 22).min(end), end);
                    self.unpacked.clear();
                    if self.described.topics.get(topic).is_some_and(|topic| topic.wire == Wire::Cdr) {
                        let message = self.records.get(self.message.0..end).unwrap_or_default();
                        unpack_message(message, &mut self.unpacked)
                            .map_err(|error| self.file.damaged(self.byte, format!("a message is damaged: {error}")))?;
                    }
                    return Ok(Some(MessageHead { topic, byte: self.byte, time, is_settled: self.is_settled }));
                }
                _ => {}
            }
        }
    }

    fn message(&self) -> &[u8] {
        if self.unpacked.is_empty() {
            self.records.get(self.message.0..self.message.1).unwrap_or_default()
        } else {
            &self.unpacked
        }
    }

    fn topics(&self) -> &[Topic] {
        &self.described.topics
    }

    fn listed(&mut self) -> Option<Vec<Topic>> {
        let position = self.file.position();
        let summary = self.summary().ok().flatten();
        self.file.seek(position).ok()?;
        Some(summary?.described.topics).filter(|topics| !topics.is_empty())
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
