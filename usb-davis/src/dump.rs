//! `.dvraw`: what came over the wire, transfer by transfer, with what is needed to understand it.
//!
//! Guarantees: a file is readable to its last whole record at any moment, also after the writer was
//! killed or the disk was full; a damaged record costs that record only; every byte is covered by
//! a checksum. All numbers are little-endian.
//!
//! ```text
//! file    magic "DVSRAW1\n" · u32 length of header · header (JSON) · u32 CRC-32 of all before
//!         records …
//!         index record · u64 its offset · magic "DVSRIDX\n"       only if the file was finished
//!
//! record   0  4  marker "DVSR"
//!          4  1  kind: 0 transfer, 1 registers, 2 index
//!          5  1  flags: bit 0 bytes were lost before it, bit 1 contents are Zstd-compressed
//!          6  1  status of the transfer, see `TransferStatus`
//!          7  1  0
//!          8  8  host time in ns since the header's start time, monotonic
//!         16  4  n = stored bytes
//!         20  4  bytes of the contents (= n unless compressed)
//!         24  4  CRC-32 of bytes 0–23 and the stored bytes
//!         28  n  contents
//! ```
//! Contents of a transfer are its payload; of registers, records of module u8, parameter u8, value
//! u32 that were read or written since (drop counters at the end, for one); of the index, pairs of
//! u64 offset and u64 host time of transfers some megabytes apart.

mod growth;
mod header;
mod reader;
mod record;
mod writer;

pub use growth::Growth;
pub use header::{DumpHeader, Identity};
pub(crate) use reader::Advanced;
pub use reader::{Damage, DumpReader, Record};
pub use record::{Transfer, TransferStatus};
pub use writer::{Compression, DumpWriter};

/// Magic at the beginning of a file.
pub const MAGIC: &[u8; 8] = b"DVSRAW1\n";
const INDEX_MAGIC: &[u8; 8] = b"DVSRIDX\n";
/// Longest header and longest record: more is damage.
const LENGTH_MOST: u32 = 1 << 26;

/// Why a dump cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DumpError {
    /// The operating system says no.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// It begins otherwise.
    #[error("not a .dvraw file: it does not begin with DVSRAW1")]
    Magic,
    /// The header cannot be trusted.
    #[error(
        "the header of this .dvraw file is damaged ({0}); if its beginning is lost, the rest can be read as bare payload"
    )]
    Header(String),
    /// Records are limited so that damage cannot ask for any amount of memory.
    #[error("a transfer of {0} bytes is longer than a record may be ({LENGTH_MOST})")]
    TooLong(usize),
}
