//! A file as bytes: where the reading is, and how much is left.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use crate::error::Usable;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::read_report::{ReadReport, Truncation};

/// Which part of `whole` `part` is, 0 to 1; nothing of nothing is all.
pub fn share(part: u64, whole: u64) -> f64 {
    if part >= whole { 1.0 } else { part as f64 / whole as f64 }
}

/// Reads a file from its beginning. Nothing is allocated that the file does not hold.
pub struct ByteReader {
    path: PathBuf,
    file: BufReader<File>,
    position: u64,
    length: u64,
}

impl ByteReader {
    /// Opens the file at `path`.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::io(path, error);
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        Ok(Self { path: path.to_owned(), file: BufReader::with_capacity(1 << 18, file), position: 0, length })
    }

    /// Offset of the next byte.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Number of all bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Number of bytes from there to the end.
    pub fn left(&self) -> u64 {
        self.length.saturating_sub(self.position)
    }

    /// Which part of the file was read, 0 to 1.
    pub fn done(&self) -> f64 {
        share(self.position, self.length)
    }

    /// Replaces the content of `buffer` by the next `count` bytes; by fewer at the end of the file only.
    pub fn read(&mut self, buffer: &mut Vec<u8>, count: u64) -> Result<(), RecordingError> {
        buffer.clear();
        let read = self.file.by_ref().take(count).read_to_end(buffer);
        self.position += read.map_err(|error| RecordingError::io(&self.path, error))? as u64;
        Ok(())
    }

    /// Replaces the content of `block` by the next `count` bytes, as far as they are whole records of `SIZE` bytes, and
    /// tells whether there may be more. What is left of a record at the end of the file is noted in `report`.
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

    /// The next `N` bytes; `None`, and the position stays, if there are not as many.
    pub fn array<const N: usize>(&mut self) -> Result<Option<[u8; N]>, RecordingError> {
        if self.left() < N as u64 {
            return Ok(None);
        }
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(|error| RecordingError::io(&self.path, error))?;
        self.position += N as u64;
        Ok(Some(bytes))
    }

    /// Goes on at `position`.
    pub fn seek(&mut self, position: u64) -> Result<(), RecordingError> {
        let distance = i64::try_from(i128::from(position) - i128::from(self.position)).unwrap_or(i64::MAX);
        self.file.seek_relative(distance).map_err(|error| RecordingError::io(&self.path, error))?;
        self.position = position;
        Ok(())
    }

    /// An error about what stands at `byte`.
    pub fn damaged(&self, byte: u64, what: impl Into<String>) -> RecordingError {
        let kind = RecordingErrorKind::Damaged { byte, what: what.into(), usable: Usable::Before };
        RecordingError::new(&self.path, kind)
    }
}
