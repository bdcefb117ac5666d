//! MCAP, the usual container of ROS 2.
//!
//! The file consists of records of u8 kind, u64 length and content. Kinds are 3 a schema (the type of messages), 4 a
//! channel (a topic), 5 a message, 6 a chunk of such records (possibly compressed with LZ4 or Zstandard), 15 the end of
//! the data. A summary follows, which contains the times of the chunks (kind 8) and is not needed otherwise.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use flate2::Crc;

use super::chunked::{self, ChunkedFile, Index, Records};
use super::container::{ChunkError, Packing, Topic, read_record, unpack_message};
use super::fields::{Fields, MessageError, Wire};
use super::message::Kind;
use super::order::IndexedChunk;
use super::write::MCAP_OUTPUT;
use super::{events, extras};
use crate::error::RecordingError;
use crate::format::{FileFormat, Uses};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// MCAP.
pub const FORMAT: FileFormat = FileFormat {
    output: Some(&MCAP_OUTPUT),
    streams: |path, options| events::summarise(chunked::open::<Mcap>, path, options),
    frames: Some(|path, options| extras::frames(chunked::open::<Mcap>, path, options)),
    extras: Some(|path, options| extras::open(chunked::open::<Mcap>, path, options)),
    uses: Uses { stream: true, ..Uses::NONE },
    ..FileFormat::of_events(
        "MCAP",
        |head| head.bytes.starts_with(MAGIC),
        |path, options| events::open(FORMAT.name, chunked::open::<Mcap>, path, options),
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
/// Size in bytes of the channel, the number and the two times of a message.
const MESSAGE_HEAD: usize = 22;
const FOOTER_RECORD: u8 = 2;
/// Size in bytes of the footer, which contains the position of the summary, and of the mark at the end of the file.
const FOOTER: u64 = 9 + 20 + 8;
/// Size limit of the summary in bytes.
const LONGEST_SUMMARY: u64 = 1 << 24;

fn nanoseconds(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}

/// Schemas and channels found so far.
#[derive(Default)]
pub struct Mcap {
    /// Names of schemas, by number.
    schemas: BTreeMap<u16, String>,
    /// Indices of topics, by number of the channel.
    channels: BTreeMap<u16, usize>,
    topics: Vec<Topic>,
    /// Content of the latest message, if it was compressed individually.
    unpacked: Vec<u8>,
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

/// Decompresses the current chunk.
fn unpack(file: &mut ChunkedFile) -> Result<(), ChunkError> {
    let ChunkHead { size, checksum, compression, length, packed } = ChunkHead::of(&file.packed)?;
    let packed = usize::try_from(length).ok().and_then(|length| packed.get(..length));
    let packed = packed.ok_or(ChunkError::Short)?;
    packing(compression)?.unpack(packed, size, &mut file.records, &mut file.budget)?;
    let mut crc = Crc::new();
    if checksum != 0 {
        crc.update(&file.records);
    }
    if crc.sum() == checksum { Ok(()) } else { Err(ChunkError::Checksum { stated: checksum, found: crc.sum() }) }
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

impl Mcap {
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

impl Records for Mcap {
    const MAGIC: &'static [u8] = MAGIC;

    fn index(ChunkedFile { file, .. }: &mut ChunkedFile) -> Result<Option<Index>, RecordingError> {
        let end = file.length().saturating_sub(FOOTER);
        file.seek(end)?;
        let Some([kind, _, _, _, _, _, _, _, _, start @ ..]) = file.array::<{ RECORD_HEAD + 8 }>()? else {
            return Ok(None);
        };
        let start = u64::from_le_bytes(start);
        if kind != FOOTER_RECORD || start == 0 || start >= end {
            return Ok(None);
        }
        file.seek(start)?;
        let mut bytes = Vec::new();
        file.read(&mut bytes, LONGEST_SUMMARY.min(end - start))?;
        let (mut described, mut chunks) = (Self::default(), Vec::new());
        let read = records(&bytes).try_for_each(|(kind, content)| match kind {
            SCHEMA | CHANNEL => described.add(kind, content),
            CHUNK_INDEX => {
                let mut fields = Fields::new(Wire::Ros1, content)?;
                let (start, _, byte) = (fields.u64("a time")?, fields.u64("a time")?, fields.u64("an offset")?);
                chunks.push(IndexedChunk { start: nanoseconds(start), byte });
                Ok(())
            }
            _ => Ok::<_, MessageError>(()),
        });
        Ok(read.is_ok().then_some(Index { topics: described.topics, chunks }))
    }

    fn next_chunk(&mut self, file: &mut ChunkedFile) -> Result<bool, RecordingError> {
        while let Some(start) = file.seek_next()? {
            let head = file.file.array::<RECORD_HEAD>()?;
            let head = head.map(|[kind, length @ ..]| (kind, u64::from_le_bytes(length)));
            let Some((kind, length)) = head.filter(|(_, length)| *length <= file.file.left()) else {
                file.end(start, "the end of the data is missing".to_owned());
                if head.is_none_or(|(kind, _)| kind != CHUNK) {
                    return Ok(false);
                }
                file.read_beginning(start)?;
                let Ok(ChunkHead { compression, packed, .. }) = ChunkHead::of(&file.packed) else { return Ok(false) };
                if let Ok(packing) = packing(compression) {
                    packing.unpack_beginning(packed, &mut file.records);
                }
                return Ok(!file.records.is_empty());
            };
            match kind {
                CHUNK => {
                    read_record(&mut file.file, start, length, &mut file.packed)?;
                    file.begin(start);
                    let unpacked = unpack(file);
                    file.check(unpacked)?;
                    file.is_settled = file.order.is_settled(start, times(&file.records));
                    return Ok(true);
                }
                SCHEMA | CHANNEL | MESSAGE => {
                    read_record(&mut file.file, start, length, &mut file.packed)?;
                    file.begin(start);
                    file.records.clear();
                    file.records.push(kind);
                    file.records.extend_from_slice(&length.to_le_bytes());
                    file.records.extend_from_slice(&file.packed);
                    return Ok(true);
                }
                DATA_END => {
                    file.ended = true;
                    return Ok(false);
                }
                _ => file.file.seek(file.file.position() + length)?,
            }
        }
        Ok(false)
    }

    fn next_record(&mut self, file: &mut ChunkedFile) -> Result<Option<(usize, i64)>, RecordingError> {
        let start = file.position + RECORD_HEAD;
        let Some((kind, content)) = records(file.records.get(file.position..).unwrap_or_default()).next() else {
            return file.drop_rest();
        };
        file.position = start + content.len();
        match kind {
            SCHEMA | CHANNEL => {
                self.add(kind, content).map_err(|error| file.damaged(format!("a channel is damaged: {error}")))?;
            }
            MESSAGE => {
                let channel = content.first_chunk().map(|bytes| u16::from_le_bytes(*bytes));
                let Some(&topic) = channel.and_then(|channel| self.channels.get(&channel)) else {
                    return Err(file.damaged("a message belongs to an unknown channel"));
                };
                file.message = (start + MESSAGE_HEAD).min(file.position)..file.position;
                self.unpacked.clear();
                if self.topics.get(topic).is_some_and(|topic| topic.wire == Wire::Cdr) {
                    unpack_message(content.get(MESSAGE_HEAD..).unwrap_or_default(), &mut self.unpacked)
                        .map_err(|error| file.damaged(format!("a message is damaged: {error}")))?;
                }
                return Ok(Some((topic, time(content).unwrap_or(i64::MIN))));
            }
            _ => {}
        }
        Ok(None)
    }

    fn message<'a>(&'a self, stored: &'a [u8]) -> &'a [u8] {
        if self.unpacked.is_empty() { stored } else { &self.unpacked }
    }

    fn topics(&self) -> &[Topic] {
        &self.topics
    }
}
