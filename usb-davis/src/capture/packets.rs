//! Reads packets of a pcap or pcapng file, one at a time.
//!
//! ```text
//! pcap    magic (gives byte order and ns or µs) · version · 8 bytes · snap length · link type
//!         packet: u32 seconds · u32 fraction · u32 captured · u32 original · captured bytes
//! pcapng  blocks: u32 type · u32 total length · body · u32 total length
//!         0x0A0D0D0A section (body begins with the byte-order magic 0x1A2B3C4D)
//!         1 interface: u16 link type · u16 0 · u32 snap length · options (9: time resolution)
//!         6 packet: u32 interface · u32 u32 time · u32 captured · u32 original · bytes · options
//!         3 simple packet: u32 original · bytes
//! ```

use std::io::{self, Read};

use super::CaptureError;

/// Largest length of a packet or block; a larger one indicates damage.
const LENGTH_MOST: u32 = 1 << 24;
/// Largest number of interfaces in a section; more indicate damage, and each takes memory.
const INTERFACES_MOST: usize = 1 << 16;

/// One captured packet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Packet<'a> {
    pub(super) link_type: u16,
    /// ns since 1970.
    pub(super) time_ns: u64,
    pub(super) big_endian: bool,
    /// `true` if the file contains fewer bytes than the packet had.
    pub(super) cut: bool,
    pub(super) data: &'a [u8],
}

#[derive(Clone, Copy, Debug)]
struct Interface {
    link_type: u16,
    /// Clock ticks per second.
    ticks_per_second: u64,
}

/// Format of a packet file, with the interfaces that it defines.
enum PacketFile {
    Pcap(Interface),
    PcapNg(Vec<Interface>),
}

/// Reads packets from `R`.
pub(super) struct PacketReader<R> {
    input: R,
    file: PacketFile,
    big_endian: bool,
    data: Vec<u8>,
    /// Offset of the current packet or block.
    begin: u64,
    /// Offset of the next byte to be read.
    position: u64,
    /// `true` if the file ends within a packet.
    ends_within: bool,
}

/// Numbers at offsets within bytes, in the byte order of the file; 0 beyond the end.
#[derive(Clone, Copy)]
pub(super) struct Fields<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) big_endian: bool,
}

impl Fields<'_> {
    fn number<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut number = [0; N];
        for (to, from) in number.iter_mut().zip(self.bytes.iter().skip(at)) {
            *to = *from;
        }
        if self.big_endian {
            number.reverse();
        }
        number
    }

    pub(super) fn u8(&self, at: usize) -> u8 {
        u8::from_le_bytes(self.number(at))
    }

    pub(super) fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.number(at))
    }

    pub(super) fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.number(at))
    }

    pub(super) fn u64(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.number(at))
    }
}

const SECTION: u32 = 0x0A0D_0D0A;

/// Returns `true` if the first four bytes are those of a pcap or pcapng file.
pub(super) fn is_packet_file(magic: [u8; 4]) -> bool {
    let magic = u32::from_be_bytes(magic);
    [magic, magic.swap_bytes()].iter().any(|magic| matches!(magic, 0xA1B2_C3D4 | 0xA1B2_3C4D)) || magic == SECTION
}

impl<R: Read> PacketReader<R> {
    pub(super) fn new(mut input: R) -> Result<Self, CaptureError> {
        let mut magic = [0; 4];
        input.read_exact(&mut magic)?;
        let mut reader = Self {
            input,
            file: PacketFile::PcapNg(Vec::new()),
            big_endian: false,
            data: Vec::new(),
            begin: 0,
            position: magic.len() as u64,
            ends_within: false,
        };
        let magic = u32::from_be_bytes(magic);
        let (big_endian, ticks_per_second) = match magic {
            SECTION => {
                let whole = reader.section()?;
                return if whole { Ok(reader) } else { Err(reader.damaged("the section header is incomplete")) };
            }
            0xA1B2_C3D4 => (true, 1_000_000),
            0xA1B2_3C4D => (true, 1_000_000_000),
            0xD4C3_B2A1 => (false, 1_000_000),
            0x4D3C_B2A1 => (false, 1_000_000_000),
            _ => return Err(CaptureError::Unknown),
        };
        let Some(head) = reader.head::<20>()? else {
            return Err(reader.damaged("the header of the file is incomplete"));
        };
        let link_type = Fields { bytes: &head, big_endian }.u32(16) as u16;
        reader.big_endian = big_endian;
        reader.file = PacketFile::Pcap(Interface { link_type, ticks_per_second });
        Ok(reader)
    }

    /// Returns the number of bytes of an incomplete packet at the end of the file.
    pub(super) fn unfinished(&self) -> u64 {
        if self.ends_within { self.position - self.begin } else { 0 }
    }

    /// Returns an error at the current packet or block.
    fn damaged(&self, what: impl Into<String>) -> CaptureError {
        CaptureError::Damaged { byte: self.begin, what: what.into() }
    }

    /// Returns the next packet; `None` at the end of the file or after its last whole packet.
    pub(super) fn next(&mut self) -> Result<Option<Packet<'_>>, CaptureError> {
        match self.file {
            PacketFile::Pcap(interface) => self.next_pcap(interface),
            PacketFile::PcapNg(_) => self.next_pcapng(),
        }
    }

    /// Reads `length` bytes into `data`; returns `false` if the file ends before.
    fn take(&mut self, length: u32) -> Result<bool, CaptureError> {
        if length > LENGTH_MOST {
            return Err(self.damaged(format!("a packet of {length} bytes")));
        }
        self.data.clear();
        // The buffer grows with the data that exist, because `length` may be wrong.
        let got = self.input.by_ref().take(length.into()).read_to_end(&mut self.data)?;
        self.position += got as u64;
        self.ends_within |= got < length as usize;
        Ok(got == length as usize)
    }

    /// Reads a header of `N` bytes; `None` if the file ends before.
    fn head<const N: usize>(&mut self) -> Result<Option<[u8; N]>, CaptureError> {
        let mut head = [0; N];
        let mut got = 0;
        while let Some(rest) = head.get_mut(got..).filter(|rest| !rest.is_empty()) {
            match self.input.read(rest) {
                Ok(0) => {
                    // An end between two packets is regular.
                    self.ends_within |= self.position > self.begin;
                    return Ok(None);
                }
                Ok(count) => {
                    got += count;
                    self.position += count as u64;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(Some(head))
    }

    fn next_pcap(&mut self, interface: Interface) -> Result<Option<Packet<'_>>, CaptureError> {
        self.begin = self.position;
        let Some(head) = self.head::<16>()? else { return Ok(None) };
        let big_endian = self.big_endian;
        let fields = Fields { bytes: &head, big_endian };
        let (captured, original) = (fields.u32(8), fields.u32(12));
        if !self.take(captured)? {
            return Ok(None);
        }
        let fraction = u64::from(fields.u32(4)) * (1_000_000_000 / interface.ticks_per_second);
        let time_ns = u64::from(fields.u32(0)) * 1_000_000_000 + fraction;
        let cut = captured < original;
        Ok(Some(Packet { link_type: interface.link_type, time_ns, big_endian, cut, data: &self.data }))
    }

    /// Reads the rest of a section block after its type; returns `false` if the file ends before.
    fn section(&mut self) -> Result<bool, CaptureError> {
        let Some(head) = self.head::<8>()? else { return Ok(false) };
        let [_, _, _, _, magic @ ..] = head;
        self.big_endian = match magic {
            [0x1A, 0x2B, 0x3C, 0x4D] => true,
            [0x4D, 0x3C, 0x2B, 0x1A] => false,
            _ => return Err(self.damaged("the section header has no byte order")),
        };
        let length = Fields { bytes: &head, big_endian: self.big_endian }.u32(0);
        self.file = PacketFile::PcapNg(Vec::new());
        self.take(length.saturating_sub(12))
    }

    fn next_pcapng(&mut self) -> Result<Option<Packet<'_>>, CaptureError> {
        loop {
            self.begin = self.position;
            let Some(kind) = self.head::<4>()? else { return Ok(None) };
            let big_endian = self.big_endian;
            if u32::from_be_bytes(kind) == SECTION {
                if !self.section()? {
                    return Ok(None);
                }
                continue;
            }
            let kind = Fields { bytes: &kind, big_endian }.u32(0);
            let Some(length) = self.head::<4>()? else { return Ok(None) };
            let length = Fields { bytes: &length, big_endian }.u32(0);
            // Bytes around the data of a packet.
            let least = match kind {
                3 => 16,
                6 => 32,
                _ => 12,
            };
            if length < least || !length.is_multiple_of(4) {
                return Err(self.damaged(format!("a block of {length} bytes")));
            }
            if !self.take(length - 8)? {
                return Ok(None);
            }
            let fields = Fields { bytes: &self.data, big_endian };
            match kind {
                1 => {
                    let interface =
                        Interface { link_type: fields.u16(0), ticks_per_second: resolution(fields, length) };
                    if let PacketFile::PcapNg(interfaces) = &mut self.file {
                        if interfaces.len() >= INTERFACES_MOST {
                            return Err(self.damaged(format!("more than {INTERFACES_MOST} interfaces")));
                        }
                        interfaces.push(interface);
                    }
                }
                3 | 6 => {
                    let (index, captured, original, at) = match kind {
                        6 => (fields.u32(0), fields.u32(12), fields.u32(16), 20),
                        _ => (0, fields.u32(0).min(length - 16), fields.u32(0), 4),
                    };
                    let interface = match &self.file {
                        PacketFile::PcapNg(interfaces) => interfaces.get(index as usize).copied(),
                        PacketFile::Pcap(interface) => Some(*interface),
                    };
                    let Some(interface) = interface else {
                        return Err(self.damaged(format!("a packet of unknown interface {index}")));
                    };
                    let ticks = match kind {
                        6 => u64::from(fields.u32(4)) << 32 | u64::from(fields.u32(8)),
                        _ => 0,
                    };
                    let time_ns = u128::from(ticks) * 1_000_000_000 / u128::from(interface.ticks_per_second);
                    let end = (at + captured as usize).min(self.data.len().saturating_sub(4));
                    return Ok(Some(Packet {
                        link_type: interface.link_type,
                        time_ns: time_ns as u64,
                        big_endian,
                        cut: captured < original,
                        data: self.data.get(at..end).unwrap_or(&[]),
                    }));
                }
                _ => {}
            }
        }
    }
}

/// Returns the ticks per second of an interface block: its option 9, or 10^6 without it.
fn resolution(fields: Fields<'_>, length: u32) -> u64 {
    let mut at = 8;
    while at + 4 <= length as usize {
        let (code, size) = (fields.u16(at), usize::from(fields.u16(at + 2)));
        match code {
            0 => break,
            9 => {
                let exponent = fields.u8(at + 4);
                let base: u64 = if exponent & 0x80 != 0 { 2 } else { 10 };
                return base.checked_pow(u32::from(exponent & 0x7F)).unwrap_or(1_000_000);
            }
            _ => at += 4 + size.next_multiple_of(4),
        }
    }
    1_000_000
}
