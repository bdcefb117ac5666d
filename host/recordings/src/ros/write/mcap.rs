//! Writer of MCAP: chunks compressed with Zstandard, an index, and a summary.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};

use super::sink::{CHUNK_BYTES, Sink, TopicDefinition};
use crate::encode::WriteError;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const COMPRESSION: &str = "zstd";
const LEVEL: i32 = 1;

/// An MCAP file under construction.
pub struct Mcap {
    output: BufWriter<File>,
    /// Number of bytes written.
    position: u64,
    /// Schemas and channels of all topics.
    descriptions: Vec<u8>,
    chunk: Vec<u8>,
    /// Time in ns and offset of the messages in the chunk, by channel.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
    /// Number of messages of each channel.
    counts: BTreeMap<u16, u64>,
    /// Earliest and latest time of all messages in ns.
    times: Option<(u64, u64)>,
    chunk_records: Vec<u8>,
    chunks: u32,
    topics: u16,
}

fn record(kind: u8, content: &[u8]) -> Vec<u8> {
    [&[kind][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

/// Returns a text or an array, preceded by its length in bytes.
fn sized(bytes: &[u8]) -> Result<Vec<u8>, WriteError> {
    let length = u32::try_from(bytes.len()).map_err(|_| WriteError::TooLarge)?;
    Ok([&length.to_le_bytes(), bytes].concat())
}

fn texts(texts: &[&str]) -> Result<Vec<u8>, WriteError> {
    Ok(texts.iter().map(|text| sized(text.as_bytes())).collect::<Result<Vec<_>, _>>()?.concat())
}

/// Returns the schemas and channels of the topics, numbered from 1.
fn descriptions(topics: &[TopicDefinition]) -> Result<Vec<u8>, WriteError> {
    let mut bytes = Vec::new();
    for (number, topic) in (1_u16..).zip(topics) {
        let number = number.to_le_bytes();
        let schema = texts(&[topic.type_name, "ros2msg", topic.definition])?;
        bytes.extend(record(3, &[&number[..], &schema].concat()));
        let channel = texts(&[topic.name, "cdr"])?;
        bytes.extend(record(4, &[&number[..], &number, &channel, &[0; 4]].concat()));
    }
    Ok(bytes)
}

impl Mcap {
    pub fn new(file: File, topics: &[TopicDefinition]) -> Result<Self, WriteError> {
        let mut mcap = Self {
            output: BufWriter::with_capacity(1 << 18, file),
            position: 0,
            descriptions: descriptions(topics)?,
            chunk: Vec::new(),
            index: BTreeMap::new(),
            counts: BTreeMap::new(),
            times: None,
            chunk_records: Vec::new(),
            chunks: 0,
            topics: topics.len() as u16,
        };
        mcap.write(MAGIC)?;
        mcap.write(&record(1, &texts(&["ros2", concat!("evcal ", env!("CARGO_PKG_VERSION"))])?))?;
        mcap.chunk.clone_from(&mcap.descriptions);
        Ok(mcap)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        self.output.write_all(bytes)?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Writes the chunk and the index of its messages.
    fn end_chunk(&mut self) -> Result<(), WriteError> {
        let chunk = std::mem::take(&mut self.chunk);
        let index = std::mem::take(&mut self.index);
        let times = index.values().flatten().map(|(time, _)| *time);
        let (start, end) = (times.clone().min().unwrap_or(0), times.max().unwrap_or(0));
        let packed = zstd::bulk::compress(&chunk, LEVEL)?;
        let (span, size) = ([start.to_le_bytes(), end.to_le_bytes()].concat(), chunk.len() as u64);
        // The checksum 0 means that nothing is to be checked.
        let head = [&span[..], &size.to_le_bytes(), &[0; 4], &sized(COMPRESSION.as_bytes())?].concat();
        let position = self.position;
        self.write(&record(6, &[&head[..], &(packed.len() as u64).to_le_bytes(), &packed].concat()))?;
        let end_of_chunk = self.position;
        let mut offsets = Vec::new();
        for (channel, messages) in &index {
            offsets.extend([&channel.to_le_bytes()[..], &self.position.to_le_bytes()].concat());
            let entries: Vec<u8> = messages
                .iter()
                .flat_map(|(time, offset)| [time.to_le_bytes(), offset.to_le_bytes()].concat())
                .collect();
            self.write(&record(7, &[&channel.to_le_bytes()[..], &sized(&entries)?].concat()))?;
        }
        let numbers = |numbers: &[u64]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>();
        let chunk_index = [
            span,
            numbers(&[position, end_of_chunk - position]),
            sized(&offsets)?,
            numbers(&[self.position - end_of_chunk]),
            sized(COMPRESSION.as_bytes())?,
            numbers(&[packed.len() as u64, size]),
        ];
        self.chunk_records.extend(record(8, &chunk_index.concat()));
        self.chunks += 1;
        Ok(())
    }

    fn statistics(&self) -> Result<Vec<u8>, WriteError> {
        let (start, end) = self.times.unwrap_or((0, 0));
        let counts =
            self.counts.iter().flat_map(|(channel, count)| [&channel.to_le_bytes()[..], &count.to_le_bytes()].concat());
        let counts = sized(&counts.collect::<Vec<u8>>())?;
        let all = self.counts.values().sum::<u64>().to_le_bytes();
        // No attachments and no metadata.
        let numbers = [0, 0, self.chunks].map(u32::to_le_bytes).concat();
        let (schemas, channels) = (self.topics.to_le_bytes(), u32::from(self.topics).to_le_bytes());
        let head = [&all[..], &schemas, &channels, &numbers].concat();
        Ok(record(11, &[&head[..], &start.to_le_bytes(), &end.to_le_bytes(), &counts].concat()))
    }
}

impl Sink for Mcap {
    fn message(&mut self, topic: usize, t: i64, message: &[u8]) -> Result<(), WriteError> {
        let time = u64::try_from(t).ok().and_then(|t| t.checked_mul(1000)).ok_or(WriteError::Time(t))?;
        let channel = topic as u16 + 1;
        let count = self.counts.entry(channel).or_default();
        let sequence = *count as u32;
        *count += 1;
        let (first, last) = self.times.unwrap_or((time, time));
        self.times = Some((first.min(time), last.max(time)));
        self.index.entry(channel).or_default().push((time, self.chunk.len() as u64));
        let head = [&channel.to_le_bytes()[..], &sequence.to_le_bytes(), &time.to_le_bytes(), &time.to_le_bytes()];
        self.chunk.extend(record(5, &[&head.concat(), message].concat()));
        if self.chunk.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        self.end_chunk()?;
        self.write(&record(15, &[0; 4]))?;
        let summary = self.position;
        let records = [
            std::mem::take(&mut self.descriptions),
            self.statistics()?,
            std::mem::take(&mut self.chunk_records),
            record(2, &[&summary.to_le_bytes()[..], &[0; 12]].concat()),
            MAGIC.to_vec(),
        ];
        self.write(&records.concat())?;
        Ok(self.output.flush()?)
    }
}
