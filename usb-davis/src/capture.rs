//! Recordings of a camera's transfers in any format: `.dvraw`, pcap, pcapng, bare payload.
//!
//! The format is determined by the first bytes of a file, never by its name. Bare payload has no signature, so its
//! words must look like a stream. Captures come from usbmon (link types 189 and 220) or USBPcap (249). The control
//! traffic, if it was captured, identifies the camera among the captured devices and contains its registers, which
//! determine the orientation of its pictures.

mod packets;
mod repair;
mod requests;
mod survey;
mod usb;

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use packets::{PacketReader, is_packet_file};
use survey::survey;
use usb::{BULK, UsbPacket};

pub use repair::{GapRepair, Repair, RepairCounts};
pub use usb::{DeviceAddress, DeviceAddressError};

use crate::dump::{Advanced, Damage, DumpError, DumpHeader, DumpReader, Growth, MAGIC, Transfer, TransferStatus};
use crate::protocol::{Decoder, Layout, Message};
use crate::registers::RegisterSnapshot;

/// The bulk endpoint that carries the stream.
pub const DATA_ENDPOINT: u8 = 0x82;
/// Bytes of bare payload that are returned as one transfer.
const RAW_TRANSFER: usize = 1 << 16;
/// Bytes at the beginning of a file that are examined for bare payload.
const SNIFF: usize = 1 << 16;
/// Largest number of devices listed in a message.
const LISTED: usize = 16;

/// File format of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CaptureFormat {
    /// A `.dvraw` dump.
    Dvraw,
    /// pcap or pcapng.
    Packets,
    /// The bytes of the stream without a container.
    BarePayload,
}

/// Reason why a capture cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// Input or output failed.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The dump is invalid.
    #[error("{0}")]
    Dump(#[from] DumpError),
    /// The file has none of the supported formats.
    #[error("the file is not .dvraw, pcap or pcapng, and its words do not look like a DAVIS stream")]
    Unknown,
    /// A pcap or pcapng file is damaged.
    #[error("the capture is damaged at byte {byte}: {what}")]
    Damaged {
        /// Offset of the damaged packet or block.
        byte: u64,
        /// Description of the damage.
        what: String,
    },
    /// The capture contains no data of a camera.
    #[error(
        "no DAVIS in this capture: no descriptor 152a:841a, no request 0xBF, no payload from endpoint 0x82; capture the bus of the camera"
    )]
    NoCamera,
    /// Several devices may be the camera.
    #[error("several devices in this capture may be the camera ({})", list(.0))]
    SeveralDevices(Vec<DeviceAddress>),
    /// More devices than the given limit.
    #[error("more than {0} devices in this capture may be the camera")]
    TooManyDevices(usize),
    /// The chosen device is not in the capture.
    #[error("no device {0} in this capture")]
    NoSuchDevice(DeviceAddress),
}

fn list(addresses: &[DeviceAddress]) -> String {
    let mut numbers: Vec<String> = addresses.iter().take(LISTED).map(DeviceAddress::to_string).collect();
    if addresses.len() > LISTED {
        numbers.push(format!("{} others", addresses.len() - LISTED));
    }
    numbers.join(", ")
}

enum Source<R: Read> {
    Dump(Box<DumpReader<R>>),
    Packets { packets: PacketReader<R>, address: DeviceAddress, start_ns: u64, gap: bool, payload: Vec<u8> },
    Bare { input: R, payload: Vec<u8> },
}

/// A recording of transfers, read in order.
pub struct Capture<R: Read = BufReader<File>> {
    source: Source<R>,
    header: DumpHeader,
    registers: RegisterSnapshot,
    repair: GapRepair,
}

impl Capture {
    /// Opens a file.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, CaptureError> {
        Self::open_device(path, None)
    }

    /// Opens a file; `device` chooses among the devices of a pcap or pcapng capture.
    pub fn open_device(path: impl AsRef<Path>, device: Option<DeviceAddress>) -> Result<Self, CaptureError> {
        Self::new(BufReader::with_capacity(1 << 18, File::open(path)?), device)
    }
}

/// Determines the format of a file from its first bytes (about 64 KiB of them, or all), if it is supported.
pub fn sniff(beginning: &[u8]) -> Option<CaptureFormat> {
    if beginning.starts_with(MAGIC) {
        return Some(CaptureFormat::Dvraw);
    }
    if beginning.first_chunk().is_some_and(|magic| is_packet_file(*magic)) {
        return Some(CaptureFormat::Packets);
    }
    // In noise and in streams alike, half of all words are timestamps. In noise, however, most other words are faults,
    // and every second timestamp goes back in time.
    let mut decoder = Decoder::new(Layout::DAVIS346);
    decoder.decode(beginning, |_| {});
    let counts = decoder.counts();
    let words = counts.bytes / 2;
    let plausible = words >= 8 && counts.anomalies.total() * 50 <= words && (counts.events > 0 || counts.skipped > 0);
    plausible.then_some(CaptureFormat::BarePayload)
}

impl<R: Read + Seek> Capture<R> {
    /// Reads a dump while it is being written, and waits for more data until `growth` reports the end.
    ///
    /// # Errors
    /// [`CaptureError::Dump`] if the input is not a dump, or has no header yet.
    pub fn follow(input: R, growth: Growth) -> Result<Self, CaptureError> {
        let reader = DumpReader::new(input)?.following(growth);
        let header = reader.header().clone();
        let registers = header.registers.clone();
        Ok(Self { source: Source::Dump(Box::new(reader)), header, registers, repair: GapRepair::default() })
    }

    /// Reads from `input`; `device` chooses among the devices of a pcap or pcapng capture.
    pub fn new(mut input: R, device: Option<DeviceAddress>) -> Result<Self, CaptureError> {
        let mut beginning = Vec::new();
        input.by_ref().take(SNIFF as u64).read_to_end(&mut beginning)?;
        input.seek(SeekFrom::Start(0))?;
        let (source, header) = match sniff(&beginning).ok_or(CaptureError::Unknown)? {
            CaptureFormat::Dvraw => {
                let reader = DumpReader::new(input)?;
                let header = reader.header().clone();
                (Source::Dump(Box::new(reader)), header)
            }
            CaptureFormat::Packets => {
                let found = survey(PacketReader::new(input.by_ref())?, device)?;
                input.seek(SeekFrom::Start(0))?;
                let start_ns = found.header.start_unix_ns;
                let packets = PacketReader::new(input)?;
                let address = found.address;
                (Source::Packets { packets, address, start_ns, gap: false, payload: Vec::new() }, found.header)
            }
            CaptureFormat::BarePayload => (Source::Bare { input, payload: Vec::new() }, DumpHeader::default()),
        };
        let registers = header.registers.clone();
        Ok(Self { source, header, registers, repair: GapRepair::default() })
    }

    /// Returns the recording's description of its camera. If there is none (bare payload, no control traffic),
    /// registers are absent, and a decoder assumes a DAVIS346.
    pub fn header(&self) -> &DumpHeader {
        &self.header
    }

    /// Returns the header's registers, updated by all changes up to the current position.
    pub fn registers(&self) -> &RegisterSnapshot {
        &self.registers
    }

    /// Returns the format of the file.
    pub fn format(&self) -> CaptureFormat {
        match &self.source {
            Source::Dump(_) => CaptureFormat::Dvraw,
            Source::Packets { .. } => CaptureFormat::Packets,
            Source::Bare { .. } => CaptureFormat::BarePayload,
        }
    }

    /// Returns the parts of the file that could not be read so far. For pcap and pcapng this is only an incomplete
    /// packet at the end of the file; other damage is an error.
    pub fn damage(&self) -> Damage {
        match &self.source {
            Source::Dump(reader) => reader.damage(),
            Source::Packets { packets, .. } => Damage { unfinished: packets.unfinished(), ..Damage::default() },
            Source::Bare { .. } => Damage::default(),
        }
    }

    /// Returns the next transfer; `None` at the end.
    ///
    /// # Errors
    /// [`CaptureError::Damaged`] if the file is damaged. All transfers before the damage are returned first.
    pub fn next_transfer(&mut self) -> Result<Option<Transfer<'_>>, CaptureError> {
        match &mut self.source {
            Source::Dump(reader) => {
                while let Some(record) = reader.advance()? {
                    match record {
                        Advanced::Registers(registers) => {
                            registers.into_iter().for_each(|(register, value)| self.registers.set(register, value));
                        }
                        Advanced::Transfer(head) => {
                            return Ok(Some(Transfer { payload: reader.contents(), ..head }));
                        }
                    }
                }
                Ok(None)
            }
            Source::Packets { packets, address, start_ns, gap, payload } => {
                while let Some(packet) = packets.next()? {
                    let Some(usb) = UsbPacket::parse(&packet) else { continue };
                    if usb.address != *address
                        || usb.transfer != BULK
                        || usb.endpoint != DATA_ENDPOINT
                        || !usb.completion
                    {
                        continue;
                    }
                    if usb.data.is_empty() && usb.status.is_good() {
                        continue;
                    }
                    let gap_before = std::mem::replace(gap, usb.cut);
                    payload.clear();
                    payload.extend(usb.data);
                    let host_ns = Some(packet.time_ns.saturating_sub(*start_ns));
                    let status = usb.status;
                    return Ok(Some(Transfer { host_ns, gap_before, status, payload }));
                }
                Ok(None)
            }
            Source::Bare { input, payload } => {
                payload.clear();
                let got = input.by_ref().take(RAW_TRANSFER as u64).read_to_end(payload)?;
                let status = TransferStatus::Completed;
                Ok((got > 0).then_some(Transfer { host_ns: None, gap_before: false, status, payload }))
            }
        }
    }

    /// Decodes the next transfer. Lost bytes and failed transfers become gaps, after which the time is corrected from
    /// the host times ([`GapRepair`]). Returns `false` at the end.
    pub fn decode_next<S: AsRef<[u16]> + AsMut<[u16]>>(
        &mut self,
        decoder: &mut Decoder<S>,
        sink: impl FnMut(Message<'_>),
    ) -> Result<bool, CaptureError> {
        let mut repair = std::mem::take(&mut self.repair);
        let decoded = self.next_transfer().map(|transfer| match transfer {
            Some(transfer) => {
                repair.decode(&transfer, decoder, sink);
                true
            }
            None => false,
        });
        self.repair = repair;
        decoded
    }

    /// Returns the number of gaps and of corrections made by [`Capture::decode_next`] so far.
    pub fn repair_counts(&self) -> RepairCounts {
        self.repair.counts()
    }

    /// Returns the gaps after which [`Capture::decode_next`] corrected the time so far, in order.
    pub fn repairs(&self) -> &[Repair] {
        self.repair.repairs()
    }
}
