//! Which of the devices in a capture is the camera, and what its control traffic says of it.

use std::collections::{BTreeMap, HashMap};
use std::io::Read;

use super::packets::PacketReader;
use super::usb::{BULK, CONTROL, DeviceAddress, UsbPacket};
use super::{CaptureError, DATA_ENDPOINT};
use crate::dump::{DumpHeader, Identity};
use crate::registers::{REGISTERS_RECORD, REQUEST_REGISTER, REQUEST_REGISTERS, Register, RegisterSnapshot};
use crate::{PRODUCT_ID, VENDOR_ID};

const GET_DESCRIPTOR: u8 = 6;

/// What was seen of one device.
#[derive(Debug, Default)]
struct Device {
    identity: Option<Identity>,
    serial_index: u8,
    strings: HashMap<u8, String>,
    registers: RegisterSnapshot,
    /// Vendor requests that only this family knows.
    register_requests: u64,
    payload: u64,
    first_ns: u64,
}

impl Device {
    fn is_camera(&self) -> bool {
        self.identity
            .as_ref()
            .is_some_and(|identity| identity.vendor_id == VENDOR_ID && identity.product_id == PRODUCT_ID)
    }

    /// A control transfer that went well.
    fn control(&mut self, setup: [u8; 8], data: &[u8]) {
        let [request_type, request, v0, v1, i0, i1, ..] = setup;
        let (value, index) = (u16::from_le_bytes([v0, v1]), u16::from_le_bytes([i0, i1]));
        match (request_type, request) {
            (0x40 | 0xC0, REQUEST_REGISTER) => {
                self.register_requests += 1;
                if let &[b0, b1, b2, b3] = data {
                    self.register(Register::new(value as u8, index as u8), u32::from_be_bytes([b0, b1, b2, b3]));
                }
            }
            (0x40, REQUEST_REGISTERS) => {
                self.register_requests += 1;
                let (records, _) = data.as_chunks::<REGISTERS_RECORD>();
                for &[module, parameter, b0, b1, b2, b3] in records {
                    self.register(Register::new(module, parameter), u32::from_be_bytes([b0, b1, b2, b3]));
                }
            }
            (0x80, GET_DESCRIPTOR) => self.descriptor((value >> 8) as u8, value as u8, data),
            _ => {}
        }
    }

    /// The snapshot is that of the first payload: what is switched off at the end does not count.
    fn register(&mut self, register: Register, value: u32) {
        if self.payload == 0 || self.registers.get(register).is_none() {
            self.registers.set(register, value);
        }
    }

    fn descriptor(&mut self, kind: u8, index: u8, data: &[u8]) {
        match (kind, data) {
            (1, &[18, 1, _, _, _, _, _, _, v0, v1, p0, p1, d0, d1, _, _, serial, _]) => {
                self.serial_index = serial;
                self.identity = Some(Identity {
                    vendor_id: u16::from_le_bytes([v0, v1]),
                    product_id: u16::from_le_bytes([p0, p1]),
                    device_version: u16::from_le_bytes([d0, d1]),
                    serial: String::new(),
                });
            }
            (3, [_, 3, text @ ..]) => {
                let (units, _) = text.as_chunks::<2>();
                let units: Vec<u16> = units.iter().map(|&unit| u16::from_le_bytes(unit)).collect();
                self.strings.insert(index, String::from_utf16_lossy(&units));
            }
            _ => {}
        }
    }
}

/// The camera of a capture.
pub(super) struct Survey {
    pub(super) address: DeviceAddress,
    pub(super) header: DumpHeader,
}

/// Reads the whole capture and chooses the camera: `wanted` if given, else the one whose
/// descriptors say so, else the only one with register requests, else the only one with payload.
pub(super) fn survey<R: Read>(
    mut packets: PacketReader<R>,
    wanted: Option<DeviceAddress>,
) -> Result<Survey, CaptureError> {
    let mut devices: BTreeMap<DeviceAddress, Device> = BTreeMap::new();
    // Set-up and data of control transfers under way.
    let mut pending: HashMap<(DeviceAddress, u64), ([u8; 8], Vec<u8>)> = HashMap::new();
    while let Some(packet) = packets.next()? {
        let Some(usb) = UsbPacket::parse(&packet) else { continue };
        let device = devices.entry(usb.address).or_default();
        if usb.transfer == BULK && usb.endpoint == DATA_ENDPOINT && usb.completion && !usb.data.is_empty() {
            if device.payload == 0 {
                device.first_ns = packet.time_ns;
            }
            device.payload += usb.data.len() as u64;
        }
        if usb.transfer != CONTROL {
            continue;
        }
        let key = (usb.address, usb.id);
        if let Some(setup) = usb.setup {
            pending.insert(key, (setup, usb.data.to_vec()));
        } else if usb.completion
            && let Some((setup, sent)) = pending.remove(&key)
            && usb.status.is_good()
        {
            device.control(setup, if setup[0] & 0x80 != 0 { usb.data } else { &sent });
        }
    }
    let address = choose(&devices, wanted)?;
    let Device { identity, serial_index, strings, registers, first_ns, .. } =
        devices.remove(&address).unwrap_or_default();
    let serial = strings.get(&serial_index).cloned().unwrap_or_default();
    let header = DumpHeader {
        identity: identity.map(|identity| Identity { serial, ..identity }),
        registers,
        start_unix_ns: first_ns,
        ..DumpHeader::default()
    };
    Ok(Survey { address, header })
}

fn choose(
    devices: &BTreeMap<DeviceAddress, Device>,
    wanted: Option<DeviceAddress>,
) -> Result<DeviceAddress, CaptureError> {
    if let Some(wanted) = wanted {
        let known = devices.contains_key(&wanted);
        return if known { Ok(wanted) } else { Err(CaptureError::NoSuchDevice(wanted)) };
    }
    let tests: [fn(&Device) -> bool; 3] =
        [Device::is_camera, |device| device.register_requests > 0, |device| device.payload > 0];
    for test in tests {
        let matching: Vec<(&DeviceAddress, &Device)> = devices.iter().filter(|(_, device)| test(device)).collect();
        // A camera that was opened but sent nothing does not compete with one that did.
        let sending: Vec<DeviceAddress> =
            matching.iter().filter(|(_, device)| device.payload > 0).map(|(address, _)| **address).collect();
        match (&sending[..], &matching[..]) {
            ([only], _) => return Ok(*only),
            ([], [(only, _)]) => return Ok(**only),
            ([], []) => {}
            _ => return Err(CaptureError::SeveralDevices(matching.iter().map(|(address, _)| **address).collect())),
        }
    }
    Err(CaptureError::NoCamera)
}
