//! Files of messages.

use std::io::{self, Read};
use std::path::Path;

use super::fields::{MessageError, Wire};
use super::message::Kind;
use crate::bytes::ByteReader;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::options::Damage;
use crate::read_report::Truncation;

/// A chunk that says it unpacks to more is damaged: writers begin a new one after some megabytes.
pub const MOST_UNPACKED: u64 = 1 << 26;
/// A record that is said to be longer is damaged: what cannot be packed grows by less, and its head is shorter.
pub const LONGEST_RECORD: u64 = MOST_UNPACKED + (1 << 20);

/// Messages of one name.
#[derive(Clone, Debug)]
pub struct Topic {
    /// Its name, such as `/dvs/events`.
    pub name: String,
    /// The type of its messages.
    pub type_name: String,
    /// What they hold.
    pub kind: Kind,
    /// How they are put into bytes.
    pub wire: Wire,
}

impl Topic {
    /// Name and type.
    pub fn description(&self) -> String {
        format!("{} ({})", self.name, self.type_name)
    }
}

/// Where a message is.
#[derive(Clone, Debug)]
pub struct MessageHead {
    /// Its topic, a place in [`Container::topics`].
    pub topic: usize,
    /// Offset in the file of the message, or of the chunk it is in.
    pub byte: u64,
}

/// A file of messages, read from its beginning.
pub trait Container: Send {
    /// The next message; `None` at the end, also of a file that was cut off.
    ///
    /// # Errors
    /// After an error about a part of the file, the messages behind it can still be read. Where they cannot be found, no more
    /// come, and [`Self::truncated`] tells from where on.
    fn next(&mut self) -> Result<Option<MessageHead>, RecordingError>;

    /// The message that was read last.
    fn message(&self) -> &[u8];

    /// The topics met so far.
    fn topics(&self) -> &[Topic];

    /// Which part of the file was read, 0 to 1.
    fn done(&self) -> f64;

    /// Set when the file ends too early, or cannot be read on.
    fn truncated(&self) -> Option<&Truncation>;

    /// The topics of the whole file, where a list of them stands in it, apart from its messages.
    fn listed(&mut self) -> Option<Vec<Topic>>;

    /// An error about the message at `byte`.
    fn damaged(&self, byte: u64, what: String) -> RecordingError;
}

/// Whether reading goes on behind this error.
pub fn is_skipped(error: &RecordingError, damage: Damage) -> bool {
    damage == Damage::Skip && matches!(error.kind, RecordingErrorKind::Damaged { .. })
}

/// Reads the next `length` bytes of `file` into `buffer`, of the record at `byte`. They are passed over where they are more than any
/// record has, which is an error.
pub fn read_record(file: &mut ByteReader, byte: u64, length: u64, buffer: &mut Vec<u8>) -> Result<(), RecordingError> {
    if length > LONGEST_RECORD {
        file.seek(file.position().saturating_add(length))?;
        let what =
            format!("a record is said to have {length} bytes, where {LONGEST_RECORD} are the most that are read");
        return Err(file.damaged(byte, what));
    }
    file.read(buffer, length)
}

/// Opens a file of messages.
pub type OpenContainer = fn(&Path) -> Result<Box<dyn Container>, RecordingError>;

/// Why a chunk cannot be unpacked.
#[derive(Debug, thiserror::Error)]
pub enum ChunkError {
    /// Its head.
    #[error("{0}")]
    Head(#[from] MessageError),
    /// It has fewer bytes than its head says.
    #[error("it ends within its records")]
    Short,
    /// It is packed in a way that the format does not have.
    #[error("its compression is none of {known}")]
    Compression {
        /// Those that there are.
        known: &'static str,
    },
    /// What is packed is damaged.
    #[error("{0}")]
    Packed(#[from] io::Error),
    /// It says that it holds more than any writer puts into one.
    #[error("it is said to unpack to {size} bytes, where {MOST_UNPACKED} are the most that are read")]
    Large {
        /// What it says.
        size: u64,
    },
    /// It holds more or less than it should.
    #[error("it unpacks to other than {size} bytes")]
    Size {
        /// What it should hold.
        size: u64,
    },
}

/// How chunks are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// Not at all.
    Plain,
    /// A frame of LZ4.
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

    /// Unpacks a chunk of `size` bytes into `unpacked`.
    pub fn unpack(self, packed: &[u8], size: u64, unpacked: &mut Vec<u8>) -> Result<(), ChunkError> {
        unpacked.clear();
        // One that is not packed is no larger than its record.
        if size > MOST_UNPACKED && self != Self::Plain {
            return Err(ChunkError::Large { size });
        }
        let read = self.open(packed)?.take(size.saturating_add(1)).read_to_end(unpacked)?;
        if read as u64 == size { Ok(()) } else { Err(ChunkError::Size { size }) }
    }

    /// Unpacks what there is of a chunk whose end is missing into `unpacked`.
    pub fn unpack_beginning(self, packed: &[u8], unpacked: &mut Vec<u8>) {
        unpacked.clear();
        if let Ok(input) = self.open(packed) {
            // That it ends with an error is known.
            let _ = input.take(MOST_UNPACKED).read_to_end(unpacked);
        }
    }
}

/// How a frame of Zstandard begins; a message of ROS 2 begins otherwise.
const ZSTANDARD: &[u8] = b"\x28\xb5\x2f\xfd";

/// Puts a message that was packed by itself, as `ros2 bag record --compression-mode message` does, into `unpacked`, which stays
/// empty for others.
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
