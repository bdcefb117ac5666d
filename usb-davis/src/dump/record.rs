//! The head of a record.

use super::LENGTH_MOST;

pub(super) const MARKER: &[u8; 4] = b"DVSR";
pub(super) const HEAD: usize = 28;

/// Result of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[non_exhaustive]
pub enum TransferStatus {
    /// The transfer succeeded.
    Completed = 0,
    /// The transfer timed out; its data are valid.
    TimedOut = 1,
    /// The endpoint was halted.
    Stalled = 2,
    /// The bus failed; the data are undefined.
    Error = 3,
    /// The transfer was cancelled; its data are valid.
    Cancelled = 4,
    /// The camera was removed.
    NoDevice = 5,
    /// The camera sent more data than fit into the buffer.
    Overflow = 6,
}

impl TransferStatus {
    /// Returns `true` if the payload is valid; otherwise bytes were lost.
    pub const fn is_good(self) -> bool {
        matches!(self, Self::Completed | Self::TimedOut | Self::Cancelled)
    }

    pub(super) const fn parse(status: u8) -> Self {
        match status {
            0 => Self::Completed,
            1 => Self::TimedOut,
            2 => Self::Stalled,
            4 => Self::Cancelled,
            5 => Self::NoDevice,
            6 => Self::Overflow,
            _ => Self::Error,
        }
    }
}

/// One transfer from the data endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer<'a> {
    /// Time of arrival in ns since the start of the recording; `None` in bare payload.
    pub host_ns: Option<u64>,
    /// `true` if bytes were lost between the previous transfer and this one.
    pub gap_before: bool,
    /// Result of the transfer.
    pub status: TransferStatus,
    /// Received bytes.
    pub payload: &'a [u8],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Transfer,
    Registers,
    Index,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    pub(super) kind: Kind,
    pub(super) gap_before: bool,
    pub(super) compressed: bool,
    pub(super) status: TransferStatus,
    pub(super) host_ns: u64,
    pub(super) stored: u32,
    pub(super) length: u32,
}

fn u32_at<const AT: usize>(bytes: &[u8; HEAD]) -> u32 {
    let mut number = [0; 4];
    for (to, from) in number.iter_mut().zip(bytes.iter().skip(AT)) {
        *to = *from;
    }
    u32::from_le_bytes(number)
}

impl Head {
    /// Returns the head and the checksum that it claims; `None` if these bytes are not a head.
    pub(super) fn parse(bytes: &[u8; HEAD]) -> Option<(Self, u32)> {
        let [m0, m1, m2, m3, kind, flags, status, zero, ..] = *bytes;
        if [m0, m1, m2, m3] != *MARKER || flags > 3 || zero != 0 {
            return None;
        }
        let kind = match kind {
            0 => Kind::Transfer,
            1 => Kind::Registers,
            2 => Kind::Index,
            _ => return None,
        };
        let head = Self {
            kind,
            gap_before: flags & 1 != 0,
            compressed: flags & 2 != 0,
            status: TransferStatus::parse(status),
            host_ns: u64::from(u32_at::<12>(bytes)) << 32 | u64::from(u32_at::<8>(bytes)),
            stored: u32_at::<16>(bytes),
            length: u32_at::<20>(bytes),
        };
        let fits = head.stored <= LENGTH_MOST && head.length <= LENGTH_MOST;
        (fits && (head.compressed || head.stored == head.length)).then_some((head, u32_at::<24>(bytes)))
    }

    /// Appends head and stored bytes to `out` as one record.
    pub(super) fn emit(&self, stored: &[u8], out: &mut Vec<u8>) {
        let start = out.len();
        out.extend(MARKER);
        let kind = match self.kind {
            Kind::Transfer => 0,
            Kind::Registers => 1,
            Kind::Index => 2,
        };
        let flags = u8::from(self.gap_before) | u8::from(self.compressed) << 1;
        out.extend([kind, flags, self.status as u8, 0]);
        out.extend(self.host_ns.to_le_bytes());
        out.extend(self.stored.to_le_bytes());
        out.extend(self.length.to_le_bytes());
        let checksum = checksum(out.get(start..).unwrap_or(&[]), stored);
        out.extend(checksum.to_le_bytes());
        out.extend(stored);
    }
}

/// Returns the CRC-32 of the first 24 bytes of a head and the stored bytes.
pub(super) fn checksum(head: &[u8], stored: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(head);
    hasher.update(stored);
    hasher.finalize()
}
