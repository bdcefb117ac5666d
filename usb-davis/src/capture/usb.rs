//! Interpretation of captured packets as USB transfers.
//!
//! ```text
//! usbmon (Linux; link type 220 has 64 bytes of header, 189 the first 48; byte order of the host)
//!   0 u64 id   8 type 'S' 'C' 'E'   9 transfer type   10 endpoint   11 device   12 u16 bus
//!  14 set-up absent   15 data absent   28 i32 status   32 u32 URB length   36 u32 captured
//!  40 8 bytes set-up
//!
//! USBPcap (Windows; 249; little-endian)
//!   0 u16 header length   2 u64 id   10 u32 status   14 u16 function   16 info (bit 0: completion)
//!  17 u16 bus   19 u16 device   21 endpoint   22 transfer type   23 u32 data length
//!  27 stage of a control transfer
//! ```
//! Transfer types of both: 0 isochronous, 1 interrupt, 2 control, 3 bulk.

use std::fmt;
use std::str::FromStr;

use super::packets::{Fields, Packet};
use crate::dump::TransferStatus;

pub(super) const CONTROL: u8 = 2;
pub(super) const BULK: u8 = 3;

/// A device on a bus, numbered as in the capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DeviceAddress {
    /// Number of the bus.
    pub bus: u16,
    /// Number of the device on the bus.
    pub device: u16,
}

impl fmt::Display for DeviceAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}.{}", self.bus, self.device)
    }
}

/// Error: a text is not a [`DeviceAddress`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a device: write the numbers of bus and device, such as 2.5")]
pub struct DeviceAddressError(String);

impl FromStr for DeviceAddress {
    type Err = DeviceAddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let numbers = text.split_once('.').and_then(|(bus, device)| Some((bus.parse().ok()?, device.parse().ok()?)));
        let (bus, device) = numbers.ok_or_else(|| DeviceAddressError(text.to_owned()))?;
        Ok(Self { bus, device })
    }
}

/// The beginning or the end of a transfer.
#[derive(Clone, Copy, Debug)]
pub(super) struct UsbPacket<'a> {
    pub(super) address: DeviceAddress,
    pub(super) id: u64,
    pub(super) completion: bool,
    pub(super) transfer: u8,
    /// Endpoint with direction bit.
    pub(super) endpoint: u8,
    pub(super) status: TransferStatus,
    pub(super) setup: Option<[u8; 8]>,
    pub(super) data: &'a [u8],
    /// `true` if there was more data than the capture contains.
    pub(super) cut: bool,
}

impl<'a> UsbPacket<'a> {
    /// Returns `None` if the packet is not a USB packet or is too short.
    pub(super) fn parse(packet: &Packet<'a>) -> Option<Self> {
        match packet.link_type {
            189 => Self::usbmon(packet, 48),
            220 => Self::usbmon(packet, 64),
            249 => Self::usbpcap(packet),
            _ => None,
        }
    }

    fn usbmon(packet: &Packet<'a>, header: usize) -> Option<Self> {
        let (head, data) = packet.data.split_at_checked(header)?;
        let fields = Fields { bytes: head, big_endian: packet.big_endian };
        let kind = fields.u8(8);
        let length = fields.u32(32);
        let present = fields.u8(15) == 0;
        let completion = kind != b'S';
        let transfer = fields.u8(9);
        let endpoint = fields.u8(10);
        // The length is given only where the data are: at the end of a read and at the beginning of a write.
        let carries = completion == (endpoint & 0x80 != 0);
        let mut setup = [0; 8];
        setup.iter_mut().zip(head.iter().skip(40)).for_each(|(to, from)| *to = *from);
        Some(Self {
            address: DeviceAddress { bus: fields.u16(12), device: u16::from(fields.u8(11)) },
            id: fields.u64(0),
            completion,
            transfer,
            endpoint,
            status: match fields.u32(28) as i32 {
                0 => TransferStatus::Completed,
                -32 => TransferStatus::Stalled,
                -2 | -104 => TransferStatus::Cancelled,
                -108 | -19 => TransferStatus::NoDevice,
                -75 => TransferStatus::Overflow,
                -110 => TransferStatus::TimedOut,
                _ => TransferStatus::Error,
            },
            setup: (fields.u8(14) == 0 && transfer == CONTROL && !completion).then_some(setup),
            data: if present { data } else { &[] },
            cut: carries && (packet.cut || (data.len() as u64) < u64::from(length)),
        })
    }

    fn usbpcap(packet: &Packet<'a>) -> Option<Self> {
        let fields = Fields { bytes: packet.data, big_endian: false };
        let header = usize::from(fields.u16(0));
        let data = packet.data.get(header..).filter(|_| header >= 27)?;
        let length = fields.u32(23);
        let completion = fields.u8(16) & 1 != 0;
        let transfer = fields.u8(22);
        let stage = fields.u8(27);
        let begins = transfer == CONTROL && !completion && stage == 0;
        let (setup, data) = match data.split_first_chunk::<8>() {
            Some((setup, rest)) if begins => (Some(*setup), rest),
            _ => (None, data),
        };
        let setup_length = if setup.is_some() { 8 } else { 0 };
        Some(Self {
            address: DeviceAddress { bus: fields.u16(17), device: fields.u16(19) },
            id: fields.u64(2),
            completion,
            transfer,
            endpoint: fields.u8(21),
            status: match fields.u32(10) {
                0 => TransferStatus::Completed,
                0xC000_0004 | 0xC000_0030 => TransferStatus::Stalled,
                0xC001_0000 => TransferStatus::Cancelled,
                0xC000_7000 => TransferStatus::NoDevice,
                _ => TransferStatus::Error,
            },
            setup,
            data,
            cut: packet.cut || ((data.len() + setup_length) as u64) < u64::from(length),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_written() {
        let address = DeviceAddress { bus: 2, device: 45 };
        assert_eq!(address.to_string().parse(), Ok(address));
        for text in ["", "2", "2.", ".5", "2.5.1", "-1.2", "65536.1", "a.b"] {
            assert_eq!(text.parse::<DeviceAddress>(), Err(DeviceAddressError(text.to_owned())));
        }
    }
}
