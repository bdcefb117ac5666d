//! Reader of the arrays in an npz file, which is a ZIP archive.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::bufread::DeflateDecoder;
use flate2::{Crc, CrcReader};
use rawzip::{CompressionMethod, RECOMMENDED_BUFFER_SIZE, ZipArchive};

use crate::error::{RecordingError, RecordingErrorKind, Usable};
use crate::unsupported_format::UnsupportedFormat;

/// First bytes of an archive.
pub const MAGIC: &[u8] = b"PK\x03\x04";
/// Extension of the names of arrays in it.
pub const EXTENSION: &str = ".npy";
/// Largest number of arrays that are examined.
const MOST_MEMBERS: usize = 1000;
const BUFFER: usize = 1 << 17;

/// An array of an archive.
pub struct Member {
    /// Name of the array, without `.npy`.
    pub name: String,
    /// Location of the array.
    pub location: Location,
}

/// Location of an array in a file.
#[derive(Clone, Debug)]
pub struct Location {
    /// Path of the file, if it is not the recording's own.
    file: Option<PathBuf>,
    /// Offset of the first byte.
    pub start: u64,
    /// Number of bytes in the file.
    length: u64,
    /// Size and checksum of the decompressed array, if it is part of an archive.
    packed: Option<Packed>,
}

#[derive(Clone, Copy, Debug)]
struct Packed {
    deflated: bool,
    size: u64,
    checksum: u32,
}

impl Location {
    /// Returns the location of the whole file at `path`.
    pub fn whole(path: &Path) -> Result<Self, RecordingError> {
        let metadata = std::fs::metadata(path).map_err(|error| RecordingError::io(path, error))?;
        if !metadata.is_file() {
            return Err(RecordingError::new(path, RecordingErrorKind::NotAFile));
        }
        Ok(Self { file: None, start: 0, length: metadata.len(), packed: None })
    }

    /// Returns the location of the whole file at `path`, which is next to the recording's own file.
    pub fn sibling(path: PathBuf) -> Result<Self, RecordingError> {
        let whole = Self::whole(&path)?;
        Ok(Self { file: Some(path), ..whole })
    }

    /// Path of the file that contains the array, if the recording is at `path`.
    pub fn file<'a>(&'a self, path: &'a Path) -> &'a Path {
        self.file.as_deref().unwrap_or(path)
    }

    /// `true` if the array is compressed, so that positions in it are not offsets in the file.
    pub fn is_compressed(&self) -> bool {
        self.packed.is_some_and(|packed| packed.deflated)
    }

    /// Opens the array at its beginning. Damage is an error of kind `InvalidData` or `InvalidInput`.
    pub fn open(&self, path: &Path) -> Result<Box<dyn Read + Send>, RecordingError> {
        let path = self.file(path);
        let io = |error| RecordingError::io(path, error);
        let mut file = File::open(path).map_err(io)?;
        file.seek(SeekFrom::Start(self.start)).map_err(io)?;
        let input = BufReader::with_capacity(BUFFER, file.take(self.length));
        let file = Ending { input, has_ended: false };
        let checked = |input, packed: Packed| Checked { input, left: packed.size, checksum: packed.checksum };
        Ok(match self.packed {
            None => Box::new(file),
            Some(packed) if packed.deflated => {
                Box::new(checked(CrcReader::new(Input::Packed(DeflateDecoder::new(file))), packed))
            }
            Some(packed) => Box::new(checked(CrcReader::new(Input::Plain(file)), packed)),
        })
    }
}

type Bytes = Ending<BufReader<io::Take<File>>>;

/// Reader that stays at its end once it has reached it. If a file grew while it is read, `input` would return more
/// bytes after its end, which makes flate2 loop endlessly.
struct Ending<R> {
    input: R,
    has_ended: bool,
}

impl<R: BufRead> Read for Ending<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let there = self.fill_buf()?;
        let length = there.len().min(buffer.len());
        if let (Some(to), Some(from)) = (buffer.get_mut(..length), there.get(..length)) {
            to.copy_from_slice(from);
        }
        self.consume(length);
        Ok(length)
    }
}

impl<R: BufRead> BufRead for Ending<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.has_ended {
            return Ok(&[]);
        }
        let there = self.input.fill_buf()?;
        self.has_ended = there.is_empty();
        Ok(there)
    }

    fn consume(&mut self, length: usize) {
        if !self.has_ended {
            self.input.consume(length);
        }
    }
}

enum Input {
    Plain(Bytes),
    Packed(DeflateDecoder<Bytes>),
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Plain(input) => input.read(buffer),
            Self::Packed(input) => input.read(buffer),
        }
    }
}

/// Reader of an array in an archive, which verifies the checksum at the end.
struct Checked {
    input: CrcReader<Input>,
    left: u64,
    checksum: u32,
}

impl Read for Checked {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let damaged = |what| io::Error::new(io::ErrorKind::InvalidData, what);
        let most = usize::try_from(self.left).unwrap_or(usize::MAX).min(buffer.len());
        let read = self.input.read(buffer.get_mut(..most).unwrap_or_default())?;
        if read == 0 && most > 0 {
            return Err(damaged("it decompresses to fewer bytes than stated"));
        }
        self.left -= read as u64;
        let sum = |crc: &Crc| crc.sum();
        if self.left == 0 && read > 0 && sum(self.input.crc()) != self.checksum {
            return Err(damaged("its checksum does not match"));
        }
        Ok(read)
    }
}

/// Returns the arrays of the archive at `path`.
pub fn members(path: &Path) -> Result<Vec<Member>, RecordingError> {
    let file = File::open(path).map_err(|error| RecordingError::io(path, error))?;
    let length = file.metadata().map_err(|error| RecordingError::io(path, error))?.len();
    let damaged = |error: rawzip::Error| {
        let what = format!(
            "the archive's list of files, at its end, cannot be read ({error}): the file is cut off or damaged"
        );
        RecordingError::damaged(path, length, what, Usable::Nothing)
    };
    let mut buffer = vec![0; RECOMMENDED_BUFFER_SIZE];
    let archive = ZipArchive::from_file(file, &mut buffer).map_err(damaged)?;
    let mut members = Vec::new();
    let mut is_spreadsheet = false;
    let mut entries = archive.entries(&mut buffer);
    while let Some(entry) = entries.next_entry().map_err(damaged)? {
        let name = String::from_utf8_lossy(entry.file_path().as_ref()).into_owned();
        is_spreadsheet |= name.starts_with("xl/");
        let Some(name) = name.strip_suffix(EXTENSION).map(str::to_owned) else { continue };
        let deflated = match entry.compression_method() {
            CompressionMethod::STORE => false,
            CompressionMethod::DEFLATE => true,
            _ => return Err(unsupported(path, UnsupportedFormat::ZipCompression)),
        };
        let packed = Packed { deflated, size: entry.uncompressed_size_hint(), checksum: entry.crc32() };
        let (start, end) = archive.get_entry(entry.wayfinder()).map_err(damaged)?.compressed_data_range();
        let length = end.saturating_sub(start);
        members.push(Member { name, location: Location { file: None, start, length, packed: Some(packed) } });
        if members.len() == MOST_MEMBERS {
            break;
        }
    }
    if members.is_empty() {
        return Err(match is_spreadsheet {
            true => unsupported(path, UnsupportedFormat::Spreadsheet),
            false => unsupported(path, UnsupportedFormat::Zip),
        });
    }
    Ok(members)
}

fn unsupported(path: &Path, format: UnsupportedFormat) -> RecordingError {
    RecordingError::new(path, RecordingErrorKind::Unsupported(format))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reader that returns bytes again after its end, like a file that grows.
    struct Growing(Vec<&'static [u8]>);

    impl Read for Growing {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let part = if self.0.is_empty() { &[][..] } else { self.0.remove(0) };
            buffer[..part.len()].copy_from_slice(part);
            Ok(part.len())
        }
    }

    /// flate2 would take an end for a pause, and read again endlessly.
    #[test]
    fn a_reader_at_its_end_reads_nothing_more() {
        let mut input = Ending { input: BufReader::new(Growing(vec![b"ab", b"", b"cd"])), has_ended: false };
        let mut read = Vec::new();
        input.read_to_end(&mut read).unwrap();
        assert_eq!((read.as_slice(), input.fill_buf().unwrap()), (&b"ab"[..], &[][..]));
    }
}
