//! Writes a dump, with one `write` call per record.

use std::io::Write;

use super::record::{Head, Kind, Transfer, TransferStatus};
use super::{DumpError, DumpHeader, Growth, INDEX_MAGIC, LENGTH_MOST, MAGIC};
use crate::registers::Register;

/// Distance between entries of the index, in bytes of the file.
const INDEX_EVERY: u64 = 1 << 22;

/// Compression of transfers, each by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Compression {
    /// No compression.
    #[default]
    None,
    /// Zstandard of this level, 1 fast to 19 small.
    Zstd(i32),
}

/// Writes transfers to `W`.
///
/// Nothing is buffered: each record is one `write_all`, so all records written before a crash are whole. Pass a file,
/// not a buffered writer. Recording never waits for the disk itself; call [`DumpWriter::get_ref`]`.sync_data()` at
/// intervals to protect the recording against a power failure.
pub struct DumpWriter<W: Write> {
    output: W,
    compressor: Option<zstd::bulk::Compressor<'static>>,
    record: Vec<u8>,
    offset: u64,
    index: Vec<u8>,
    next_entry: u64,
    host_ns: u64,
    growth: Growth,
}

impl<W: Write> DumpWriter<W> {
    /// Writes the header to `output`.
    pub fn new(mut output: W, header: &DumpHeader, compression: Compression) -> Result<Self, DumpError> {
        let json = serde_json::to_vec(header).map_err(|error| DumpError::Header(error.to_string()))?;
        let mut bytes = MAGIC.to_vec();
        bytes.extend(u32::try_from(json.len()).map_err(|_| DumpError::TooLong(json.len()))?.to_le_bytes());
        bytes.extend(json);
        bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
        output.write_all(&bytes)?;
        let compressor = match compression {
            Compression::None => None,
            Compression::Zstd(level) => Some(zstd::bulk::Compressor::new(level)?),
        };
        let offset = bytes.len() as u64;
        Ok(Self {
            output,
            compressor,
            record: bytes,
            offset,
            index: Vec::new(),
            next_entry: offset,
            host_ns: 0,
            growth: Growth::default(),
        })
    }

    /// Reports the length of the dump to `growth`, from now on.
    pub fn with_growth(self, growth: Growth) -> Self {
        growth.set(self.offset);
        Self { growth, ..self }
    }

    /// Appends a transfer. Without a host time it gets the host time of the previous one.
    pub fn transfer(&mut self, transfer: &Transfer<'_>) -> Result<(), DumpError> {
        let host_ns = transfer.host_ns.unwrap_or(self.host_ns);
        if self.offset >= self.next_entry {
            self.index.extend(self.offset.to_le_bytes());
            self.index.extend(host_ns.to_le_bytes());
            self.next_entry = self.offset + INDEX_EVERY;
        }
        self.host_ns = host_ns;
        let smaller = match &mut self.compressor {
            Some(compressor) => Some(compressor.compress(transfer.payload)?),
            None => None,
        };
        let smaller = smaller.filter(|smaller| smaller.len() < transfer.payload.len());
        let stored = smaller.as_deref().unwrap_or(transfer.payload);
        let head = Head {
            kind: Kind::Transfer,
            gap_before: transfer.gap_before,
            compressed: smaller.is_some(),
            status: transfer.status,
            host_ns,
            stored: 0,
            length: 0,
        };
        self.append(head, stored, transfer.payload.len())
    }

    /// Appends registers that were read or written during the recording.
    pub fn registers(&mut self, registers: impl IntoIterator<Item = (Register, u32)>) -> Result<(), DumpError> {
        let mut contents = Vec::new();
        for (register, value) in registers {
            contents.extend([register.module, register.parameter]);
            contents.extend(value.to_le_bytes());
        }
        self.plain(Kind::Registers, &contents)
    }

    fn plain(&mut self, kind: Kind, contents: &[u8]) -> Result<(), DumpError> {
        let head = Head {
            kind,
            gap_before: false,
            compressed: false,
            status: TransferStatus::Completed,
            host_ns: self.host_ns,
            stored: 0,
            length: 0,
        };
        self.append(head, contents, contents.len())
    }

    fn append(&mut self, head: Head, stored: &[u8], length: usize) -> Result<(), DumpError> {
        let fit = |length: usize| {
            u32::try_from(length).ok().filter(|&length| length <= LENGTH_MOST).ok_or(DumpError::TooLong(length))
        };
        let head = Head { stored: fit(stored.len())?, length: fit(length)?, ..head };
        self.record.clear();
        head.emit(stored, &mut self.record);
        self.output.write_all(&self.record)?;
        self.offset += self.record.len() as u64;
        self.growth.set(self.offset);
        Ok(())
    }

    /// Returns the number of bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.offset
    }

    /// Returns the output.
    pub fn get_ref(&self) -> &W {
        &self.output
    }

    /// Writes the index and returns the output. A dump that is not finished can still be read; only seeking takes
    /// longer.
    pub fn finish(mut self) -> Result<W, DumpError> {
        let offset = self.offset;
        let index = std::mem::take(&mut self.index);
        self.plain(Kind::Index, &index)?;
        let mut trailer = offset.to_le_bytes().to_vec();
        trailer.extend(INDEX_MAGIC);
        self.output.write_all(&trailer)?;
        self.output.flush()?;
        Ok(self.output)
    }
}
