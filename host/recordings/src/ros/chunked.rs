//! Files of records, some of which are chunks of further records: what bags of ROS 1 and MCAP have in common.

use std::ops::Range;
use std::path::Path;

use super::container::{Budget, ChunkError, Container, MOST_UNPACKED, MessageHead, Topic};
use super::order::{ChunkOrder, IndexedChunk, Ordered, scan};
use crate::bytes::ByteReader;
use crate::error::RecordingError;
use crate::read_report::Truncation;

/// A format of records.
pub trait Records: Default + Send + 'static {
    /// First bytes of a file.
    const MAGIC: &'static [u8];

    /// Reads the index at the end of the file; `None` if there is none.
    fn index(file: &mut ChunkedFile) -> Result<Option<Index>, RecordingError>;

    /// Reads the next chunk, or the next record outside of chunks, into `file.records`. Returns `false` at the end.
    fn next_chunk(&mut self, file: &mut ChunkedFile) -> Result<bool, RecordingError>;

    /// Reads the record at `file.position` of `file.records`. Returns its topic and time if it is a message.
    fn next_record(&mut self, file: &mut ChunkedFile) -> Result<Option<(usize, i64)>, RecordingError>;

    /// Content of the latest message, which is `stored` in the file.
    fn message<'a>(&'a self, stored: &'a [u8]) -> &'a [u8] {
        stored
    }

    /// Topics found so far.
    fn topics(&self) -> &[Topic];
}

/// The index at the end of a file.
#[derive(Default)]
pub struct Index {
    /// The topics of the whole file.
    pub topics: Vec<Topic>,
    /// Times and places of the chunks.
    pub chunks: Vec<IndexedChunk>,
}

/// A file, and the records that are being read.
pub struct ChunkedFile {
    /// The file, behind the current chunk.
    pub file: ByteReader,
    /// Order in which chunks are read.
    pub order: ChunkOrder,
    /// The records of a decompressed chunk, or a single record outside of chunks.
    pub records: Vec<u8>,
    /// Offset in `records` of the next record.
    pub position: usize,
    /// Offset in the file of the chunk.
    pub byte: u64,
    /// `true` if no message of another chunk precedes those of the current one.
    pub is_settled: bool,
    /// The chunk as stored.
    pub packed: Vec<u8>,
    /// What the chunks may unpack to.
    pub budget: Budget,
    /// Range of the latest message in `records`.
    pub message: Range<usize>,
    /// End of the file, if it comes too early.
    pub truncated: Option<Truncation>,
    /// `true` if nothing follows the current chunk.
    pub ended: bool,
}

impl ChunkedFile {
    /// Moves to the next record of the file outside of chunks. Returns its offset; `None` at the end.
    pub fn seek_next(&mut self) -> Result<Option<u64>, RecordingError> {
        match self.order.next() {
            None => {}
            Some(Some(byte)) => self.file.seek(byte)?,
            Some(None) => return Ok(None),
        }
        Ok(Some(self.file.position()))
    }

    /// Begins the records of the chunk at `byte`, which are not settled.
    pub fn begin(&mut self, byte: u64) {
        (self.position, self.byte, self.is_settled) = (0, byte, false);
    }

    /// Reads the rest of the file as the beginning of the chunk at `byte`.
    pub fn read_beginning(&mut self, byte: u64) -> Result<(), RecordingError> {
        self.begin(byte);
        self.records.clear();
        // With a wrong length, this could be the whole rest of the file.
        self.file.read(&mut self.packed, self.file.left().min(MOST_UNPACKED))
    }

    /// Notes that the readable part of the file ends at `byte`.
    pub fn end(&mut self, byte: u64, lost: String) {
        self.truncated = Some(Truncation { byte, lost });
        self.ended = true;
    }

    /// Drops the records of the current chunk if it could not be `unpacked`.
    pub fn check(&mut self, unpacked: Result<(), ChunkError>) -> Result<(), RecordingError> {
        unpacked.map_err(|what| {
            self.records.clear();
            what.of_chunk(&self.file, self.byte)
        })
    }

    /// Creates an error about the current chunk.
    pub fn damaged(&self, what: impl Into<String>) -> RecordingError {
        self.file.damaged(self.byte, what)
    }

    /// Drops the rest of the chunk, because its next record is longer.
    ///
    /// # Errors
    /// [`Self::damaged`], unless the file is cut off.
    pub fn drop_rest(&mut self) -> Result<Option<(usize, i64)>, RecordingError> {
        self.records.clear();
        match self.truncated {
            Some(_) => Ok(None),
            None => Err(self.damaged("a record of a chunk is longer than the chunk")),
        }
    }
}

/// The messages of a file, in the order of its chunks.
struct Chunked<R> {
    file: ChunkedFile,
    records: R,
}

/// Opens the file at `path`.
pub fn open<R: Records>(path: &Path) -> Result<Box<dyn Container>, RecordingError> {
    let mut chunked = Chunked::<R>::new(path)?;
    if let Some(Index { chunks, .. }) = R::index(&mut chunked.file)? {
        chunked.file.order = ChunkOrder::new(chunks);
        if chunked.file.order.is_moved() {
            let mut read = Chunked::<R>::new(path)?;
            chunked.file.order = scan(&mut read).unwrap_or_default();
            // A chunk may use topics of a chunk that precedes it in the file.
            chunked.records = read.records;
        }
    }
    chunked.file.file.seek(R::MAGIC.len() as u64)?;
    Ok(Box::new(Ordered::new(chunked)))
}

impl<R: Records> Chunked<R> {
    fn new(path: &Path) -> Result<Self, RecordingError> {
        let mut file = ByteReader::open(path)?;
        file.seek(R::MAGIC.len() as u64)?;
        let budget = Budget::of_file(file.length());
        let file = ChunkedFile {
            file,
            order: ChunkOrder::default(),
            records: Vec::new(),
            position: 0,
            byte: 0,
            is_settled: false,
            packed: Vec::new(),
            budget,
            message: 0..0,
            truncated: None,
            ended: false,
        };
        Ok(Self { file, records: R::default() })
    }
}

impl<R: Records> Container for Chunked<R> {
    fn next(&mut self) -> Result<Option<MessageHead>, RecordingError> {
        loop {
            if self.file.position < self.file.records.len() {
                if let Some((topic, time)) = self.records.next_record(&mut self.file)? {
                    let (byte, is_settled) = (self.file.byte, self.file.is_settled);
                    return Ok(Some(MessageHead { topic, byte, time, is_settled }));
                }
            } else if self.file.ended || !self.records.next_chunk(&mut self.file)? {
                return Ok(None);
            }
        }
    }

    fn message(&self) -> &[u8] {
        self.records.message(self.file.records.get(self.file.message.clone()).unwrap_or_default())
    }

    fn topics(&self) -> &[Topic] {
        self.records.topics()
    }

    fn listed(&mut self) -> Option<Vec<Topic>> {
        let position = self.file.file.position();
        let index = R::index(&mut self.file).ok().flatten();
        self.file.file.seek(position).ok()?;
        Some(index?.topics).filter(|topics| !topics.is_empty())
    }

    fn done(&self) -> f64 {
        self.file.file.done()
    }

    fn truncated(&self) -> Option<&Truncation> {
        self.file.truncated.as_ref()
    }

    fn damaged(&self, byte: u64, what: String) -> RecordingError {
        self.file.file.damaged(byte, what)
    }
}
