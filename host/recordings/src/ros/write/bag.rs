//! Writer of bags of ROS 1, version 2.0, uncompressed and with an index.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};

use super::sink::{CHUNK_BYTES, Sink, TopicDefinition};
use crate::encode::WriteError;

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Size of the first record, which is written again at the end.
const FIRST_RECORD: usize = 4096;

/// A bag under construction.
pub struct Bag {
    output: BufWriter<File>,
    topics: &'static [TopicDefinition],
    /// Number of bytes written before the current chunk.
    position: u64,
    chunk: Vec<u8>,
    /// Topic, time and offset of the messages in the chunk.
    messages: Vec<(u32, [u8; 8], u32)>,
    /// Topics whose connection has been written.
    connected: Vec<u32>,
    /// Records about the chunks, for the end of the file.
    chunk_records: Vec<u8>,
    chunks: u32,
}

fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Result<Vec<u8>, WriteError> {
    let length = |bytes: usize| u32::try_from(bytes).map(u32::to_le_bytes).map_err(|_| WriteError::TooLarge);
    let mut header = Vec::new();
    for (name, value) in fields {
        header.extend(length(name.len() + 1 + value.len())?);
        header.extend([name.as_bytes(), b"=", value].concat());
    }
    Ok([&length(header.len())?[..], &header, &length(data.len())?, data].concat())
}

/// Returns a time in µs as seconds and nanoseconds.
fn time(t: i64) -> Result<[u8; 8], WriteError> {
    let seconds = u32::try_from(t.div_euclid(1_000_000)).map_err(|_| WriteError::Time(t))?;
    let nanoseconds = (t.rem_euclid(1_000_000) * 1000) as u64;
    Ok((nanoseconds << 32 | u64::from(seconds)).to_le_bytes())
}

impl Bag {
    pub fn new(file: File, topics: &'static [TopicDefinition]) -> Result<Self, WriteError> {
        let output = BufWriter::with_capacity(1 << 18, file);
        let mut bag = Self {
            output,
            topics,
            position: (MAGIC.len() + FIRST_RECORD) as u64,
            chunk: Vec::new(),
            messages: Vec::new(),
            connected: Vec::new(),
            chunk_records: Vec::new(),
            chunks: 0,
        };
        bag.first_record(0)?;
        Ok(bag)
    }

    /// Writes the beginning of the file. `index` is the offset of the index, 0 before it is written.
    fn first_record(&mut self, index: u64) -> Result<(), WriteError> {
        let (connections, chunks) = (self.connected.len() as u32, self.chunks);
        let (index, connections, chunks) = (index.to_le_bytes(), connections.to_le_bytes(), chunks.to_le_bytes());
        let fields = [("op", &[3][..]), ("index_pos", &index), ("conn_count", &connections), ("chunk_count", &chunks)];
        let padding = FIRST_RECORD.saturating_sub(record(&fields, &[])?.len());
        self.output.write_all(MAGIC)?;
        Ok(self.output.write_all(&record(&fields, &vec![b' '; padding])?)?)
    }

    fn connection(&self, topic: u32) -> Result<Vec<u8>, WriteError> {
        let Some(TopicDefinition { name, type_name, definition, md5 }) = self.topics.get(topic as usize) else {
            return Ok(Vec::new());
        };
        let fields = [("topic", name), ("type", type_name), ("md5sum", md5), ("message_definition", definition)];
        // The data of a connection are fields in the format of a header.
        let fields = record(&fields.map(|(key, value)| (key, value.as_bytes())), &[])?;
        let data = fields.get(4..fields.len().saturating_sub(4)).unwrap_or_default();
        record(&[("op", &[7]), ("conn", &topic.to_le_bytes()), ("topic", name.as_bytes())], data)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        self.output.write_all(bytes)?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Writes the chunk and the index of its messages.
    fn end_chunk(&mut self) -> Result<(), WriteError> {
        let key =
            |time: &[u8; 8]| (u32::from_le_bytes([time[0], time[1], time[2], time[3]]), u64::from_le_bytes(*time));
        let times = || self.messages.iter().map(|(_, time, _)| time);
        let (Some(start), Some(end)) = (times().min_by_key(|time| key(time)), times().max_by_key(|time| key(time)))
        else {
            return Ok(());
        };
        let (start, end, position) = (*start, *end, self.position.to_le_bytes());
        let chunk = std::mem::take(&mut self.chunk);
        let size = u32::try_from(chunk.len()).map_err(|_| WriteError::TooLarge)?.to_le_bytes();
        self.write(&record(&[("op", &[5]), ("compression", b"none"), ("size", &size)], &chunk)?)?;
        let messages = std::mem::take(&mut self.messages);
        let version = 1_u32.to_le_bytes();
        let mut counts = Vec::new();
        for connection in 0..self.topics.len() as u32 {
            let messages = messages.iter().filter(|(topic, ..)| *topic == connection);
            let index: Vec<u8> =
                messages.flat_map(|(_, time, offset)| [&time[..], &offset.to_le_bytes()].concat()).collect();
            let count = (index.len() / 12) as u32;
            if count > 0 {
                let (number, count) = (connection.to_le_bytes(), count.to_le_bytes());
                let fields = [("op", &[4][..]), ("ver", &version), ("conn", &number), ("count", &count)];
                self.write(&record(&fields, &index)?)?;
                counts.extend([number, count].concat());
            }
        }
        let count = ((counts.len() / 8) as u32).to_le_bytes();
        let fields = [
            ("op", &[6][..]),
            ("ver", &version),
            ("chunk_pos", &position),
            ("start_time", &start),
            ("end_time", &end),
            ("count", &count),
        ];
        self.chunk_records.extend(record(&fields, &counts)?);
        self.chunks += 1;
        Ok(())
    }
}

impl Sink for Bag {
    fn message(&mut self, topic: usize, t: i64, message: &[u8]) -> Result<(), WriteError> {
        let topic = topic as u32;
        if !self.connected.contains(&topic) {
            self.connected.push(topic);
            let connection = self.connection(topic)?;
            self.chunk.extend(connection);
        }
        let time = time(t)?;
        let offset = u32::try_from(self.chunk.len()).map_err(|_| WriteError::TooLarge)?;
        self.messages.push((topic, time, offset));
        self.chunk.extend(record(&[("op", &[2]), ("conn", &topic.to_le_bytes()), ("time", &time)], message)?);
        if self.chunk.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        self.end_chunk()?;
        let index = self.position;
        for topic in self.connected.clone() {
            let connection = self.connection(topic)?;
            self.write(&connection)?;
        }
        let chunk_records = std::mem::take(&mut self.chunk_records);
        self.write(&chunk_records)?;
        self.output.seek(SeekFrom::Start(0))?;
        self.first_record(index)?;
        Ok(self.output.flush()?)
    }
}
