//! `.dvraw`: the received data, transfer by transfer, with the information needed to decode them.
//!
//! Guarantees: a file is readable up to its last whole record at any moment, also after the writer was killed or the
//! disk was full; damage loses only the damaged record; every byte is covered by a checksum. All numbers are
//! little-endian.
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
//! The contents of a transfer record are its payload. The contents of a registers record are entries of module u8,
//! parameter u8, value u32 for registers that were read or written in the meantime, for example drop counters at the
//! end. The contents of the index are pairs of u64 offset and u64 host time of transfers a few megabytes apart.

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
/// Largest length of a header or record; a larger one indicates damage.
const LENGTH_MOST: u32 = 1 << 24;

/// Reason why a dump cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DumpError {
    /// Input or output failed.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// The file does not begin with the magic.
    #[error("not a .dvraw file: it does not begin with DVSRAW1")]
    Magic,
    /// The header is damaged.
    #[error(
        "the header of this .dvraw file is damaged ({0}); if its beginning is lost, the rest can be read as bare payload"
    )]
    Header(String),
    /// A transfer exceeds the largest length of a record, which limits the memory that damaged files can request.
    #[error("a transfer of {0} bytes is longer than a record may be ({LENGTH_MOST})")]
    TooLong(usize),
}
