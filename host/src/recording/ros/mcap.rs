//! MCAP, the usual container of ROS 2.
//!
//! Records of u8 kind, u64 length and content: 3 a schema (the type of messages), 4 a channel (a topic), 5 a message, 6 a
//! chunk of such records (perhaps packed as LZ4 or Zstandard), 15 the end of the data. What follows is an index, which is
//! not needed.

use std::path::Path;

use super::container::{ChunkError, Container, MOST_UNPACKED, MessageHead, Topic, plain, unpack, unpack_beginning};
use super::fields::{Fields, MessageError, Wire};
use super::message::Kind;
use super::write::MCAP_OUTPUT;
use super::{events, extras};
use crate::recording::bytes::ByteReader;
use crate::recording::{FileFormat, RecordingError, Truncation};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// MCAP.
pub const FORMAT: FileFormat = FileFormat {
    output: Some(&MCAP_OUTPUT),
    streams: |path, _| events::summarise(open, path),
    frames: Some(|path, options, visit| extras::visit_frames(open, path, options, visit)),
    extras: Some(|path, options| extras::open(open, path, options)),
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
const DATA_END: u8 = 15;
/// Kind and length of a record.
const RECORD_HEAD: usize = 9;

/// Opens such a file of messages.
pub fn open(path: &Path) -> Result<Box<dyn Container>, RecordingError> {
    let mut file = ByteReader::open(path)?;
    file.seek(MAGIC.len() as u64)?;
    Ok(Box::new(Mcap {
        file,
        records: Vec::new(),
        position: 0,
        byte: 0,
        packed: Vec::new(),
        schemas: Vec::new(),
        channels: Vec::new(),
        topics: Vec::new(),
        message: (0, 0),
        truncated: None,
        ended: false,
    }))
}

struct Mcap {
    file: ByteReader,
    /// The records of a chunk, or one outside of chunks.
    records: Vec<u8>,
    position: usize,
    /// Where they are in the file.
    byte: u64,
    packed: Vec<u8>,
    /// Numbers and names of schemas.
    schemas: Vec<(u16, String)>,
    /// Number of a channel and the place of its topic.
    channels: Vec<(u16, usize)>,
    topics: Vec<Topic>,
    /// Where the message is in the records.
    message: (usize, usize),
    truncated: Option<Truncation>,
    ended: bool,
}

fn text(fields: &mut Fields) -> Result<String, MessageError> {
    Ok(String::from_utf8_lossy(fields.text("a name")?).into_owned())
}

/// The content of a chunk.
struct ChunkHead<'a> {
    /// Bytes that it unpacks to.
    size: u64,
    compression: &'a [u8],
    /// Bytes that it has packed.
    length: u64,
    packed: &'a [u8],
}

impl<'a> ChunkHead<'a> {
    fn of(content: &'a [u8]) -> Result<Self, MessageError> {
        let mut fields = Fields::new(Wire::Ros1, content)?;
        fields.u64("its head")?;
        fields.u64("its head")?;
        let size = fields.u64("its head")?;
        fields.u32("its head")?;
        let compression = fields.text("its head")?;
        let length = fields.u64("its head")?;
        Ok(Self { size, compression, length, packed: fields.rest() })
    }
}

impl Mcap {
    /// Takes the next record of the file, or the records of the next chunk; false at the end.
    fn next_records(&mut self) -> Result<bool, RecordingError> {
        loop {
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
                    self.file.read(&mut self.packed, length)?;
                    (self.position, self.byte) = (0, start);
                    self.unpack().map_err(|what| {
                        self.records.clear();
                        self.file.damaged(start, format!("a chunk is damaged: {what}"))
                    })?;
                    return Ok(true);
                }
                SCHEMA | CHANNEL | MESSAGE => {
                    self.file.read(&mut self.packed, length)?;
                    self.records.clear();
                    self.records.push(kind);
                    self.records.extend_from_slice(&length.to_le_bytes());
                    self.records.extend_from_slice(&self.packed);
                    (self.position, self.byte) = (0, start);
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

    /// Takes what there is of a chunk whose end is missing; false if it is nothing.
    fn take_beginning(&mut self, start: u64) -> Result<bool, RecordingError> {
        // A false length would have the rest of the file in memory.
        self.file.read(&mut self.packed, self.file.left().min(MOST_UNPACKED))?;
        (self.position, self.byte) = (0, start);
        self.records.clear();
        let Ok(ChunkHead { compression, packed, .. }) = ChunkHead::of(&self.packed) else { return Ok(false) };
        match compression {
            b"" => unpack_beginning(packed, &mut self.records),
            b"lz4" => unpack_beginning(lz4_flex::frame::FrameDecoder::new(packed), &mut self.records),
            b"zstd" => {
                if let Ok(decoder) = zstd::stream::read::Decoder::with_buffer(packed) {
                    unpack_beginning(decoder, &mut self.records);
                }
            }
            _ => {}
        }
        Ok(!self.records.is_empty())
    }

    fn unpack(&mut self) -> Result<(), ChunkError> {
        let ChunkHead { size, compression, length, packed } = ChunkHead::of(&self.packed)?;
        let packed = usize::try_from(length).ok().and_then(|length| packed.get(..length));
        let packed = packed.ok_or(ChunkError::Short)?;
        let records = &mut self.records;
        match compression {
            b"" => plain(packed, size, records),
            b"lz4" => unpack(lz4_flex::frame::FrameDecoder::new(packed), size, records),
            b"zstd" => {
                let decoder = zstd::stream::read::Decoder::with_buffer(packed)?;
                unpack(decoder, size, records)
            }
            _ => Err(ChunkError::Compression { known: "lz4 and zstd" }),
        }
    }

    /// Takes note of a schema or channel.
    fn describe(&mut self, kind: u8, from: usize, to: usize) -> Result<(), MessageError> {
        let content = self.records.get(from..to).unwrap_or_default();
        let mut fields = Fields::new(Wire::Ros1, content)?;
        let id = fields.u16("its number")?;
        if kind == SCHEMA {
            let name = text(&mut fields)?;
            self.schemas.retain(|(known, _)| *known != id);
            self.schemas.push((id, name));
            return Ok(());
        }
        let schema = fields.u16("its schema")?;
        let (name, encoding) = (text(&mut fields)?, text(&mut fields)?);
        let type_name = self.schemas.iter().find(|(known, _)| *known == schema);
        let type_name = type_name.map(|(_, name)| name.clone()).unwrap_or_default();
        let (known_kind, wire) = match encoding.as_str() {
            "cdr" => (Kind::of_type(&type_name), Wire::Cdr),
            "ros1" => (Kind::of_type(&type_name), Wire::Ros1),
            _ => (Kind::Other, Wire::Ros1),
        };
        if !self.channels.iter().any(|(known, _)| *known == id) {
            self.channels.push((id, self.topics.len()));
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
                    .describe(kind, start, end)
                    .map_err(|error| self.file.damaged(self.byte, format!("a channel is damaged: {error}")))?,
                MESSAGE => {
                    // Channel, number, and two times.
                    let channel = self.records.get(start..end).and_then(|content| content.first_chunk());
                    let channel = channel.map(|bytes| u16::from_le_bytes(*bytes));
                    let known = self.channels.iter().find(|(known, _)| Some(*known) == channel);
                    let Some(&(_, topic)) = known else {
                        return Err(self.file.damaged(self.byte, "a message is of a channel that is not known"));
                    };
                    self.message = ((start + 22).min(end), end);
                    return Ok(Some(MessageHead { topic, byte: self.byte }));
                }
                _ => {}
            }
        }
    }

    fn message(&self) -> &[u8] {
        self.records.get(self.message.0..self.message.1).unwrap_or_default()
    }

    fn topics(&self) -> &[Topic] {
        &self.topics
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
