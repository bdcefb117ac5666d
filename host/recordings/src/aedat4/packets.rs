//! Reader of the packets of an AEDAT4 file, in file order.
//!
//! Packets follow the header. Each has an i32 stream number, an i32 size, and `size` bytes: a whole LZ4 or Zstandard
//! frame (or plain bytes) of a FlatBuffer with a u32 size prefix. Of the table at the end of the file, only the
//! position is needed for reading, because the packets end there.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use usb_davis::dump::Growth;
use zstd::stream::raw::{Decoder, InBuffer, Operation, OutBuffer};

use super::header::{self, Compression, Header, MAGIC};
use crate::bytes::share;
use crate::error::{RecordingError, Usable};
use crate::read_report::Truncation;

/// Size limit of a decompressed packet (64 MiB, 4 million events). A larger one is damaged, because a camera would need
/// seconds to fill it, and programs write many per second.
pub(super) const MAX_UNPACKED: usize = 1 << 26;
/// Size limit of a compressed packet. Data that cannot be compressed grow by less than the difference.
const MAX_PACKED: u64 = MAX_UNPACKED as u64 + (1 << 20);

/// Reader of a file, packet by packet.
pub struct PacketReader {
    path: PathBuf,
    file: BufReader<File>,
    header: Header,
    /// Offset of the next packet.
    position: u64,
    /// Offset at which the packets end.
    end: u64,
    /// Progress of the writing, if the file is still being written; `end` is then unknown.
    growth: Option<Growth>,
    truncated: Option<Truncation>,
    packed: Vec<u8>,
    unpacked: Vec<u8>,
    zstd: Decoder<'static>,
}

/// Head of a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PacketHead {
    /// Number of the stream.
    pub stream: i32,
    /// Offset of the content in the file.
    pub byte: u64,
    /// Length of the content in the file.
    pub length: u64,
    /// `true` if the file ends within the packet; `length` is then the length of the rest.
    pub cut_off: bool,
}

impl PacketReader {
    /// Opens the file and reads its header.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::following(path, None)
    }

    /// Opens the file, which is still being written if there is a `growth`, and reads its header.
    pub fn following(path: &Path, growth: Option<Growth>) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::io(path, error);
        let damaged = |byte, what: String| RecordingError::damaged(path, byte, what, Usable::Nothing);
        let file = File::open(path).map_err(io)?;
        let file_length = file.metadata().map_err(io)?.len();
        let mut file = BufReader::with_capacity(1 << 16, file);
        let mut start = [0; MAGIC.len() + 4];
        file.read_exact(&mut start).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => damaged(0, format!("the header is cut off after {file_length} bytes")),
            _ => io(error),
        })?;
        let [.., a, b, c, d] = start;
        let size = u64::from(u32::from_le_bytes([a, b, c, d]));
        let position = start.len() as u64 + size;
        if position > file_length {
            let what = format!("the header has {size} bytes, but the file ends after {file_length}");
            return Err(damaged(MAGIC.len() as u64, what));
        }
        let mut bytes = Vec::new();
        file.by_ref().take(size).read_to_end(&mut bytes).map_err(io)?;
        let header = header::parse(&bytes).map_err(|error| damaged(start.len() as u64, error.to_string()))?;
        let mut truncated = None;
        let end = match header.table_position {
            Some(table) if (position..=file_length).contains(&table) => table,
            Some(table) if table > file_length => {
                let lost = format!("at least {} bytes and the closing table are missing", table - file_length);
                truncated = Some(Truncation { byte: file_length, lost });
                file_length
            }
            Some(table) => {
                let what = format!("the header states that the closing table is at byte {table}, inside the header");
                return Err(damaged(start.len() as u64, what));
            }
            None => file_length,
        };
        let zstd = Decoder::new().map_err(io)?;
        let path = path.to_owned();
        let (packed, unpacked) = (Vec::new(), Vec::new());
        Ok(Self { path, file, header, position, end, growth, truncated, packed, unpacked, zstd })
    }

    /// Header of the file.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Fraction of the packets that has been read, 0 to 1.
    pub fn done(&self) -> f64 {
        share(self.position, self.end)
    }

    /// `true` while the file is still being written.
    pub fn is_growing(&self) -> bool {
        self.growth.is_some()
    }

    /// End of the file, if it comes too early; complete once [`Self::next_packet`] has returned `None`.
    pub fn truncated(&self) -> Option<&Truncation> {
        self.truncated.as_ref()
    }

    /// Creates an error about the packet `head`.
    pub fn damaged(&self, head: &PacketHead, what: &str) -> RecordingError {
        let what = format!("a packet of stream {} is damaged: {what}", head.stream);
        RecordingError::damaged(&self.path, head.byte, what, Usable::Around)
    }

    /// Number of bytes allocated for packets.
    #[cfg(test)]
    pub(super) fn memory(&self) -> usize {
        self.packed.capacity() + self.unpacked.capacity()
    }

    fn too_large(&self, head: &PacketHead) -> RecordingError {
        self.damaged(head, &format!("it unpacks to more than {} MiB", MAX_UNPACKED >> 20))
    }

    /// Reads the head of the next packet; `None` at the end. [`Self::content`] may then be called once for its content.
    pub fn next_packet(&mut self) -> Result<Option<PacketHead>, RecordingError> {
        self.wait_for(self.position.saturating_add(8))?;
        let io = |error| RecordingError::io(&self.path, error);
        // The content of the previous packet may not have been read; seeks within the buffer if possible.
        let here = self.file.stream_position().map_err(io)?;
        let distance = i64::try_from(self.position).unwrap_or(i64::MAX) - i64::try_from(here).unwrap_or(i64::MAX);
        self.file.seek_relative(distance).map_err(io)?;
        let left = self.end.saturating_sub(self.position);
        if left == 0 {
            return Ok(None);
        }
        let start = self.position;
        if left < 8 {
            self.cut_off(start, format!("{left} bytes of a packet's head"))?;
            return Ok(None);
        }
        let mut head = [0; 8];
        self.file.read_exact(&mut head).map_err(io)?;
        let [a, b, c, d, e, f, g, h] = head;
        let stream = i32::from_le_bytes([a, b, c, d]);
        let size = i32::from_le_bytes([e, f, g, h]);
        // The closing table, which looks like a packet of an unknown stream, or a damaged head. Which of the two is known at the end.
        if !self.header.streams.iter().any(|known| known.id == stream) {
            self.wait_for(u64::MAX)?;
        }
        if self.end <= start {
            return Ok(None);
        }
        let Ok(length) = u64::try_from(size) else {
            let what = format!("a packet of stream {stream} states a size of {size} bytes");
            return Err(RecordingError::damaged(&self.path, start, what, Usable::Before));
        };
        let byte = start + 8;
        self.wait_for(byte.saturating_add(length))?;
        let available = self.end.saturating_sub(byte);
        if length > available {
            self.cut_off(start, format!("{available} of {length} bytes of a packet of stream {stream}"))?;
            self.position = self.end;
            return Ok(Some(PacketHead { stream, byte, length: available, cut_off: true }));
        }
        self.position = byte + length;
        Ok(Some(PacketHead { stream, byte, length, cut_off: false }))
    }

    /// Waits until the first `bytes` of a file that is still being written are there. If the writing ends before, the packets end where
    /// its header says now.
    fn wait_for(&mut self, bytes: u64) -> Result<(), RecordingError> {
        let Some(growth) = &self.growth else { return Ok(()) };
        if let Some(written) = growth.wait_beyond(bytes.saturating_sub(1)) {
            self.end = written;
            return Ok(());
        }
        let closed = Self::open(&self.path)?;
        (self.end, self.truncated, self.header) = (closed.end, closed.truncated, closed.header);
        self.growth = None;
        Ok(())
    }

    /// Records that the file ends within a packet. If the closing table follows, the file is not cut off but damaged,
    /// and an error is returned.
    fn cut_off(&mut self, byte: u64, rest: String) -> Result<(), RecordingError> {
        if self.header.table_position == Some(self.end) {
            let what = format!("{rest} are left before the closing table: the sizes of packets do not add up");
            return Err(RecordingError::damaged(&self.path, byte, what, Usable::Before));
        }
        let lost = match &self.truncated {
            Some(truncation) => format!("{rest} are left; {}", truncation.lost),
            None => format!("{rest} are left, and it is unknown how much is missing"),
        };
        self.truncated = Some(Truncation { byte, lost });
        self.position = self.end;
        Ok(())
    }

    /// Returns the content of the packet `head` that [`Self::next_packet`] has just returned, decompressed and without
    /// its size prefix. If the packet is cut off, returns the available part, which is empty for a compressed packet.
    pub fn content(&mut self, head: &PacketHead) -> Result<&[u8], RecordingError> {
        self.packed.clear();
        if head.length > MAX_PACKED {
            return Err(self.too_large(head));
        }
        let read = self.file.by_ref().take(head.length).read_to_end(&mut self.packed);
        read.map_err(|error| RecordingError::io(&self.path, error))?;
        let unpacked: &[u8] = match self.header.compression {
            Compression::None => &self.packed,
            _ if head.cut_off => &[],
            Compression::Lz4 => {
                self.unpacked.clear();
                lz4_flex::frame::FrameDecoder::new(self.packed.as_slice())
                    .take(MAX_UNPACKED as u64 + 1)
                    .read_to_end(&mut self.unpacked)
                    .map_err(|error| self.damaged(head, &format!("LZ4: {error}")))?;
                &self.unpacked
            }
            Compression::Zstd => {
                let length = unpack_zstd(&mut self.zstd, &self.packed, &mut self.unpacked)
                    .map_err(|error| self.damaged(head, &format!("Zstandard: {error}")))?;
                self.unpacked.get(..length).unwrap_or_default()
            }
        };
        if unpacked.len() > MAX_UNPACKED {
            return Err(self.too_large(head));
        }
        match unpacked.split_first_chunk() {
            Some((size, content)) => {
                let size = u32::from_le_bytes(*size) as usize;
                match content.get(..size) {
                    Some(content) => Ok(content),
                    None if head.cut_off => Ok(content),
                    None => Err(self.damaged(head, &format!("only {} of {size} bytes are present", content.len()))),
                }
            }
            None if head.cut_off => Ok(&[]),
            None => Err(self.damaged(head, "it is empty")),
        }
    }
}

/// Decompresses one Zstandard frame into `unpacked`, which grows as needed and keeps its length. Returns the number of
/// bytes of the content.
fn unpack_zstd(decoder: &mut Decoder<'static>, packed: &[u8], unpacked: &mut Vec<u8>) -> io::Result<usize> {
    decoder.reinit()?;
    let mut source = InBuffer::around(packed);
    let mut length = 0;
    loop {
        if unpacked.len() == length {
            let target = (2 * length).max(4 * packed.len()).clamp(1 << 16, MAX_UNPACKED + 1);
            if target <= length {
                return Ok(length);
            }
            unpacked.resize(target, 0);
        }
        let mut target = OutBuffer::around_pos(unpacked.as_mut_slice(), length);
        let before = (source.pos(), length);
        let wanted = decoder.run(&mut source, &mut target)?;
        length = target.pos();
        if wanted == 0 {
            return Ok(length);
        }
        if before == (source.pos(), length) && length < unpacked.len() {
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the frame is incomplete"));
        }
    }
}
