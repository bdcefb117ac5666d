//! Reader of a file as bytes, which keeps track of the position and of the bytes left.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use crate::error::Usable;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::read_report::{ReadReport, Truncation};

/// Returns the fraction `part` / `whole`, at most 1; also 1 if `whole` is 0.
pub fn share(part: u64, whole: u64) -> f64 {
    if part >= whole { 1.0 } else { part as f64 / whole as f64 }
}

/// Reader of a file from its beginning. It never allocates more than the file contains.
pub struct ByteReader {
    path: PathBuf,
    file: BufReader<File>,
    position: u64,
    length: u64,
}

impl ByteReader {
    /// Opens the file at `path`.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::with_buffer(path, 1 << 18)
    }

    /// Opens the file at `path` with a buffer of this size.
    pub fn with_buffer(path: &Path, buffer: usize) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::io(path, error);
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        Ok(Self { path: path.to_owned(), file: BufReader::with_capacity(buffer, file), position: 0, length })
    }

    /// Offset of the next byte.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Number of bytes in the file.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Number of bytes from the position to the end of the file.
    pub fn left(&self) -> u64 {
        self.length.saturating_sub(self.position)
    }

    /// Fraction of the file that has been read, 0 to 1.
    pub fn done(&self) -> f64 {
        share(self.position, self.length)
    }

    /// Replaces the content of `buffer` with the next `count` bytes. At the end of the file there are fewer.
    pub fn read(&mut self, buffer: &mut Vec<u8>, count: u64) -> Result<(), RecordingError> {
        buffer.clear();
        let read = self.file.by_ref().take(count).read_to_end(buffer);
        self.position += read.map_err(|error| RecordingError::io(&self.path, error))? as u64;
        Ok(())
    }

    /// Replaces the content of `block` with the whole records of `SIZE` bytes among the next `count` bytes. Returns
    /// `true` if there may be more. An incomplete record at the end of the file is stored in `report`.
    pub fn read_records<const SIZE: usize>(
        &mut self,
        block: &mut Vec<u8>,
        count: u64,
        report: &mut ReadReport,
    ) -> Result<bool, RecordingError> {
        self.read(block, count)?;
        let more = block.len() as u64 == count;
        let left = block.len() % SIZE;
        if left > 0 {
            let byte = self.position - left as u64;
            report.truncated = Some(Truncation { byte, lost: format!("{left} bytes of an event are left") });
            block.truncate(block.len() - left);
        }
        Ok(more)
    }

    /// Reads the next `N` bytes. Returns `None` and keeps the position if there are fewer.
    pub fn array<const N: usize>(&mut self) -> Result<Option<[u8; N]>, RecordingError> {
        if self.left() < N as u64 {
            return Ok(None);
        }
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(|error| RecordingError::io(&self.path, error))?;
        self.position += N as u64;
        Ok(Some(bytes))
    }

    /// Continues at `position`.
    pub fn seek(&mut self, position: u64) -> Result<(), RecordingError> {
        let distance = i64::try_from(i128::from(position) - i128::from(self.position)).unwrap_or(i64::MAX);
        self.file.seek_relative(distance).map_err(|error| RecordingError::io(&self.path, error))?;
        self.position = position;
        Ok(())
    }

    /// Creates an error about the data at `byte`.
    pub fn damaged(&self, byte: u64, what: impl Into<String>) -> RecordingError {
        let kind = RecordingErrorKind::Damaged { byte, what: what.into(), usable: Usable::Before };
        RecordingError::new(&self.path, kind)
    }
}
