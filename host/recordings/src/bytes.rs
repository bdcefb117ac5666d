//! Reader of a file as bytes, which keeps track of the position and of the bytes left.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use usb_davis::dump::Growth;

use crate::error::{RecordingError, RecordingErrorKind, Usable};
use crate::read_report::{ReadReport, Truncation};

/// Returns the fraction `part` / `whole`, at most 1; also 1 if `whole` is 0.
pub fn share(part: u64, whole: u64) -> f64 {
    if part >= whole { 1.0 } else { part as f64 / whole as f64 }
}

/// Number of bytes that are decoded at a time while a file is still being written; a multiple of every size of records.
const GROWING_BLOCK: u64 = 1 << 12;

/// A file that may still be written. At the end of what is written, reading waits for more.
pub struct SourceFile {
    file: File,
    /// `None` for a complete file.
    growth: Option<Growth>,
    position: u64,
    /// Number of bytes that may be read.
    written: u64,
}

impl SourceFile {
    /// Opens the file at `path`; `growth` is the progress of its writing.
    pub fn open(path: &Path, growth: Option<&Growth>) -> io::Result<Self> {
        Ok(Self { file: File::open(path)?, growth: growth.cloned(), position: 0, written: 0 })
    }

    /// Number of bytes in the file now.
    pub fn length(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }
}

impl Read for SourceFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.position >= self.written
            && let Some(growth) = &self.growth
        {
            match growth.wait_beyond(self.position) {
                Some(written) => self.written = written,
                None => self.growth = None,
            }
        }
        let most = match &self.growth {
            Some(_) => usize::try_from(self.written - self.position).unwrap_or(usize::MAX).min(buffer.len()),
            None => buffer.len(),
        };
        let count = self.file.read(buffer.get_mut(..most).unwrap_or_default())?;
        self.position += count as u64;
        Ok(count)
    }
}

impl Seek for SourceFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.position = self.file.seek(to)?;
        Ok(self.position)
    }
}

/// Reader of a file from its beginning. It never allocates more than the file contains.
pub struct ByteReader {
    path: PathBuf,
    file: BufReader<SourceFile>,
    position: u64,
    /// Length of the file when it was opened.
    length: u64,
}

impl ByteReader {
    /// Opens the file at `path`.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::with_buffer(path, 1 << 18)
    }

    /// Opens the file at `path`, which is still being written if there is a `growth`.
    pub fn following(path: &Path, growth: Option<&Growth>) -> Result<Self, RecordingError> {
        Self::new(path, growth, 1 << 18)
    }

    /// Opens the file at `path` with a buffer of this size.
    pub fn with_buffer(path: &Path, buffer: usize) -> Result<Self, RecordingError> {
        Self::new(path, None, buffer)
    }

    fn new(path: &Path, growth: Option<&Growth>, buffer: usize) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::io(path, error);
        let file = SourceFile::open(path, growth).map_err(io)?;
        let length = file.length().map_err(io)?;
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

    /// Number of bytes from the position to the end of the file; unlimited while the file is still being written.
    pub fn left(&self) -> u64 {
        self.end().saturating_sub(self.position)
    }

    fn end(&self) -> u64 {
        let file = self.file.get_ref();
        match file.growth {
            Some(_) => u64::MAX,
            // A file that has been followed is longer than at its opening.
            None if file.written > 0 => file.length().unwrap_or(self.length),
            None => self.length,
        }
    }

    /// Returns `true` if the position is the end of the file.
    pub fn at_end(&mut self) -> Result<bool, RecordingError> {
        Ok(self.file.fill_buf().map_err(|error| RecordingError::io(&self.path, error))?.is_empty())
    }

    /// Returns the number of bytes to decode at a time: `whole`, or fewer while the file is still being written, so that its events appear
    /// soon.
    pub fn block(&self, whole: u64) -> u64 {
        match self.file.get_ref().growth {
            Some(_) => whole.min(GROWING_BLOCK),
            None => whole,
        }
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
        let count = self.block(count);
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
        match self.file.read_exact(&mut bytes) {
            Ok(()) => {
                self.position += N as u64;
                Ok(Some(bytes))
            }
            // A file that was still being written has ended.
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
            Err(error) => Err(RecordingError::io(&self.path, error)),
        }
    }

    /// Continues at `position`.
    pub fn seek(&mut self, position: u64) -> Result<(), RecordingError> {
        let distance = i64::try_from(i128::from(position) - i128::from(self.position)).unwrap_or(i64::MAX);
        self.file.seek_relative(distance).map_err(|error| RecordingError::io(&self.path, error))?;
        self.position = position;
        Ok(())
    }

    /// Creates an error about the whole file.
    pub fn error(&self, kind: RecordingErrorKind) -> RecordingError {
        RecordingError::new(&self.path, kind)
    }

    /// Creates an error about the data at `byte`.
    pub fn damaged(&self, byte: u64, what: impl Into<String>) -> RecordingError {
        RecordingError::damaged(&self.path, byte, what, Usable::Before)
    }
}
