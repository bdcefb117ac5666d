//! The interface of a file of messages, and the compression of its chunks.

use std::io::{self, Read};
use std::path::Path;

use super::fields::{MessageError, Wire};
use super::message::Kind;
use crate::bytes::ByteReader;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::options::Damage;
use crate::read_report::Truncation;

/// Size limit of a decompressed chunk in bytes. Larger ones are damaged, because writers begin a new chunk after some
/// megabytes.
pub const MOST_UNPACKED: u64 = 1 << 26;
/// Length limit of a record in bytes. Data that cannot be compressed grow by less than the difference, and the header
/// is shorter.
pub const LONGEST_RECORD: u64 = MOST_UNPACKED + (1 << 20);

/// The number of bytes to which all compressed chunks of a file may unpack together: the chunks of a few hundred kilobytes could
/// otherwise take minutes.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    most: u64,
    left: u64,
}

impl Budget {
    /// Creates the budget of a file with this number of bytes.
    pub fn of_file(bytes: u64) -> Self {
        let most = bytes.saturating_mul(256).saturating_add(1 << 28);
        Self { most, left: most }
    }

    /// Takes the bytes of a chunk. After an error, nothing is left.
    fn take(&mut self, size: u64) -> Result<(), ChunkError> {
        let left = self.left.checked_sub(size);
        self.left = left.unwrap_or(0);
        if left.is_some() { Ok(()) } else { Err(ChunkError::Budget { most: self.most }) }
    }
}

/// A topic: messages with a common name.
#[derive(Clone, Debug)]
pub struct Topic {
    /// Name of the topic, such as `/dvs/events`.
    pub name: String,
    /// Type of the messages.
    pub type_name: String,
    /// Content of the messages.
    pub kind: Kind,
    /// Serialization of the messages.
    pub wire: Wire,
}

impl Topic {
    /// Returns name and type as text.
    pub fn description(&self) -> String {
        format!("{} ({})", self.name, self.type_name)
    }
}

/// Location of a message.
#[derive(Clone, Debug)]
pub struct MessageHead {
    /// Index of the topic in [`Container::topics`].
    pub topic: usize,
    /// Offset in the file of the message, or of its chunk.
    pub byte: u64,
    /// Time of recording, in the unit of the file.
    pub time: i64,
    /// `true` if the index of the file shows that no earlier message follows.
    pub is_settled: bool,
}

/// A file of messages, read from its beginning or, if its index shows another order of time, in that order.
pub trait Container: Send {
    /// Reads the next message; `None` at the end, also if the file is cut off.
    ///
    /// # Errors
    /// After an error about a part of the file, the messages after that part can still be read. If they cannot be
    /// found, reading ends, and [`Self::truncated`] contains the position.
    fn next(&mut self) -> Result<Option<MessageHead>, RecordingError>;

    /// Reads the next message like [`Self::next`], after damage that is to be skipped.
    fn next_readable(&mut self, damage: Damage) -> Result<Option<MessageHead>, RecordingError> {
        loop {
            match self.next() {
                Err(error) if error.is_skipped(damage) => {}
                read => return read,
            }
        }
    }

    /// Content of the message that was read last.
    fn message(&self) -> &[u8];

    /// Topics found so far.
    fn topics(&self) -> &[Topic];

    /// Fraction of the file that has been read, 0 to 1.
    fn done(&self) -> f64;

    /// End of the readable part, if it comes too early.
    fn truncated(&self) -> Option<&Truncation>;

    /// Returns the topics of the whole file, if it contains a list of them.
    fn listed(&mut self) -> Option<Vec<Topic>>;

    /// Describes what may be missing, in a sentence.
    fn doubt(&self) -> Option<String> {
        None
    }

    /// Creates an error about the message at `byte`.
    fn damaged(&self, byte: u64, what: String) -> RecordingError;
}

/// Reads the next `length` bytes of `file`, which belong to the record at `byte`, into `buffer`. If they exceed
/// [`LONGEST_RECORD`], skips them and returns an error.
pub fn read_record(file: &mut ByteReader, byte: u64, length: u64, buffer: &mut Vec<u8>) -> Result<(), RecordingError> {
    if length > LONGEST_RECORD {
        file.seek(file.position().saturating_add(length))?;
        let what = format!("a record states a length of {length} bytes, more than the limit of {LONGEST_RECORD}");
        return Err(file.damaged(byte, what));
    }
    file.read(buffer, length)
}

/// Opens a file of messages.
pub type OpenContainer = fn(&Path) -> Result<Box<dyn Container>, RecordingError>;

/// Reason why a chunk cannot be decompressed.
#[derive(Debug, thiserror::Error)]
pub enum ChunkError {
    /// The head is invalid.
    #[error("{0}")]
    Head(#[from] MessageError),
    /// The chunk is shorter than its head states.
    #[error("it is shorter than stated")]
    Short,
    /// The format does not define this compression.
    #[error("its compression is not one of {known}")]
    Compression {
        /// Names of the known compressions.
        known: &'static str,
    },
    /// The compressed data are damaged.
    #[error("{0}")]
    Packed(#[from] io::Error),
    /// The stated size is larger than any writer's chunks.
    #[error("its stated size of {size} bytes exceeds the limit of {MOST_UNPACKED}")]
    Large {
        /// Stated size in bytes.
        size: u64,
    },
    /// All chunks together are larger than the [`Budget`].
    #[error("the chunks of the file, compressed by more than a factor of 256, have more than {most} bytes")]
    Budget {
        /// Limit in bytes.
        most: u64,
    },
    /// The decompressed content does not have the stated checksum.
    #[error("its checksum is {found:08x} instead of {stated:08x}")]
    Checksum {
        /// CRC-32 in the head of the chunk.
        stated: u32,
        /// CRC-32 of the content.
        found: u32,
    },
    /// The decompressed size differs from the stated size.
    #[error("its decompressed size is not {size} bytes")]
    Size {
        /// Stated size in bytes.
        size: u64,
    },
}

impl ChunkError {
    /// Returns the error of reading `file`, whose chunk at `byte` this is.
    pub fn of_chunk(&self, file: &ByteReader, byte: u64) -> RecordingError {
        match self {
            Self::Budget { most } => {
                file.error(RecordingErrorKind::TooLargeUnpacked { most: *most, bytes: file.length() })
            }
            _ => file.damaged(byte, format!("a chunk is damaged: {self}")),
        }
    }
}

/// Compression of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// No compression.
    Plain,
    /// An LZ4 frame.
    Lz4,
    /// bzip2.
    Bzip2,
    /// Zstandard.
    Zstandard,
}

impl Packing {
    fn open(self, packed: &[u8]) -> io::Result<Box<dyn Read + '_>> {
        Ok(match self {
            Self::Plain => Box::new(packed),
            Self::Lz4 => Box::new(lz4_flex::frame::FrameDecoder::new(packed)),
            Self::Bzip2 => Box::new(bzip2::read::BzDecoder::new(packed)),
            Self::Zstandard => Box::new(zstd::stream::read::Decoder::with_buffer(packed)?),
        })
    }

    /// Decompresses a chunk of `size` bytes into `unpacked`.
    pub fn unpack(
        self,
        packed: &[u8],
        size: u64,
        unpacked: &mut Vec<u8>,
        budget: &mut Budget,
    ) -> Result<(), ChunkError> {
        unpacked.clear();
        // The size of an uncompressed chunk is limited by its record.
        if self != Self::Plain {
            if size > MOST_UNPACKED {
                return Err(ChunkError::Large { size });
            }
            budget.take(size)?;
        }
        let read = self.open(packed)?.take(size.saturating_add(1)).read_to_end(unpacked)?;
        if read as u64 == size { Ok(()) } else { Err(ChunkError::Size { size }) }
    }

    /// Decompresses the available part of a chunk that is cut off into `unpacked`.
    pub fn unpack_beginning(self, packed: &[u8], unpacked: &mut Vec<u8>) {
        unpacked.clear();
        if let Ok(input) = self.open(packed) {
            // The error at the end is expected.
            let _ = input.take(MOST_UNPACKED).read_to_end(unpacked);
        }
    }
}

/// First bytes of a Zstandard frame. A message of ROS 2 cannot begin with them.
const ZSTANDARD: &[u8] = b"\x28\xb5\x2f\xfd";

/// Decompresses a message that was compressed individually (by `ros2 bag record --compression-mode message`) into
/// `unpacked`. For other messages `unpacked` stays empty.
pub fn unpack_message(message: &[u8], unpacked: &mut Vec<u8>) -> io::Result<()> {
    unpacked.clear();
    if message.starts_with(ZSTANDARD) {
        let read = Packing::Zstandard.open(message)?.take(MOST_UNPACKED).read_to_end(unpacked);
        if let Err(error) = read {
            unpacked.clear();
            return Err(error);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_chunks_of_a_file_have_a_common_limit() {
        let mut budget = Budget::of_file(1 << 20);
        let chunk = 1 << 26;
        let taken = (0..100).take_while(|_| budget.take(chunk).is_ok()).count();
        assert_eq!(taken, 8);
        assert!(matches!(budget.take(1), Err(ChunkError::Budget { most: 0x2000_0000 })));
        assert!(Budget::of_file(u64::MAX).take(u64::MAX).is_ok());
    }
}
