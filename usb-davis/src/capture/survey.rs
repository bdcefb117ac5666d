//! Identifies the camera among the devices of a capture, and collects its description from the control traffic.

use std::collections::{BTreeMap, HashMap};
use std::io::Read;

use super::packets::PacketReader;
use super::requests::{GET_DESCRIPTOR, Request, Requests};
use super::usb::{BULK, CONTROL, DeviceAddress, UsbPacket};
use super::{CaptureError, DATA_ENDPOINT};
use crate::dump::{DumpHeader, Identity};
use crate::registers::{REGISTERS_RECORD, REQUEST_REGISTER, REQUEST_REGISTERS, Register, RegisterSnapshot};
use crate::{PRODUCT_ID, VENDOR_ID};

/// Largest number of devices examined: eight full buses.
const DEVICES_MOST: usize = 1024;
/// Largest number of registers kept per device; the camera has a few hundred.
const REGISTERS_MOST: usize = 1024;
/// Largest number of texts kept per device; the camera has three.
const STRINGS_MOST: usize = 16;
/// Most UTF-16 units of a text: the length of its descriptor is one byte.
const STRING_MOST: usize = 126;

/// Data collected about one device.
#[derive(Debug, Default)]
struct Device {
    identity: Option<Identity>,
    serial_index: u8,
    strings: HashMap<u8, String>,
    registers: RegisterSnapshot,
    /// Vendor requests that exist only in this camera family.
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

    /// Processes a successful control transfer.
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

    /// Records a register. The snapshot is taken at the first payload, so that switching off at the end does not count.
    fn register(&mut self, register: Register, value: u32) {
        let counts = match self.registers.get(register) {
            Some(_) => self.payload == 0,
            None => self.registers.len() < REGISTERS_MOST,
        };
        if counts {
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
            (3, [_, 3, text @ ..]) if self.strings.len() < STRINGS_MOST || self.strings.contains_key(&index) => {
                let (units, _) = text.as_chunks::<2>();
                let units: Vec<u16> = units.iter().take(STRING_MOST).map(|&unit| u16::from_le_bytes(unit)).collect();
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

/// The devices found, up to the limit.
#[derive(Debug, Default)]
struct Devices(BTreeMap<DeviceAddress, Device>);

impl Devices {
    fn at(&mut self, address: DeviceAddress) -> Result<&mut Device, CaptureError> {
        if self.0.len() >= DEVICES_MOST && !self.0.contains_key(&address) {
            return Err(CaptureError::TooManyDevices(DEVICES_MOST));
        }
        Ok(self.0.entry(address).or_default())
    }

    /// Processes all packets of `wanted`, or of all devices, up to the end or to damage, which is returned.
    fn read<R: Read>(
        &mut self,
        mut packets: PacketReader<R>,
        wanted: Option<DeviceAddress>,
    ) -> Result<Option<CaptureError>, CaptureError> {
        let mut requests = Requests::default();
        loop {
            let packet = match packets.next() {
                Ok(Some(packet)) => packet,
                Ok(None) => return Ok(None),
                Err(damage @ CaptureError::Damaged { .. }) => return Ok(Some(damage)),
                Err(error) => return Err(error),
            };
            let Some(usb) = UsbPacket::parse(&packet) else { continue };
            match wanted {
                Some(wanted) if wanted != usb.address => continue,
                // The device exists, even if no packet describes it.
                Some(wanted) => {
                    self.at(wanted)?;
                }
                None => {}
            }
            if usb.transfer == BULK && usb.endpoint == DATA_ENDPOINT && usb.completion && !usb.data.is_empty() {
                let device = self.at(usb.address)?;
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
                requests.begin(key, setup, usb.data);
            } else if usb.completion
                && let Some(Request { setup, sent }) = requests.end(key)
                && usb.status.is_good()
            {
                self.at(usb.address)?.control(setup, if setup[0] & 0x80 != 0 { usb.data } else { &sent });
            }
        }
    }
}

/// Reads the whole capture, or the part before damage, and chooses the camera: `wanted` if given, otherwise the device
/// with matching descriptors, otherwise the only one with register requests, otherwise the only one with payload.
pub(super) fn survey<R: Read>(packets: PacketReader<R>, wanted: Option<DeviceAddress>) -> Result<Survey, CaptureError> {
    let mut devices = Devices::default();
    let damage = devices.read(packets, wanted)?;
    let Devices(mut devices) = devices;
    let address = choose(&devices, wanted).map_err(|error| match (error, damage) {
        // The camera may come after the damage.
        (CaptureError::NoCamera | CaptureError::NoSuchDevice(_), Some(damage)) => damage,
        (error, _) => error,
    })?;
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
        // A camera that was opened but sent nothing does not compete with one that sent data.
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

#[cfg(test)]
mod tests {
    use super::*;

    const SUBMISSION: u8 = b'S';
    const COMPLETION: u8 = b'C';
    const READ_REGISTER: [u8; 8] = [0xC0, REQUEST_REGISTER, 0, 0, 0, 0, 4, 0];

    /// A usbmon packet in a pcap file.
    struct Sent<'a> {
        bus: u16,
        device: u8,
        kind: u8,
        transfer: u8,
        endpoint: u8,
        setup: Option<[u8; 8]>,
        data: &'a [u8],
    }

    fn capture<'a>(packets: impl IntoIterator<Item = Sent<'a>>) -> Vec<u8> {
        let mut file = [0xA1B2_C3D4u32, 0x0004_0002, 0, 0, 1 << 18, 189].map(u32::to_le_bytes).concat();
        for sent in packets {
            let (length, urb) = (48 + sent.data.len() as u32, sent.data.len() as u32);
            file.extend([1000, 0, length, length].map(u32::to_le_bytes).concat());
            file.extend(1u64.to_le_bytes());
            file.extend([sent.kind, sent.transfer, sent.endpoint, sent.device]);
            file.extend(sent.bus.to_le_bytes());
            file.extend([if sent.setup.is_some() { 0 } else { b'-' }, 0]);
            file.extend([0; 16]);
            file.extend([urb, urb].map(u32::to_le_bytes).concat());
            file.extend(sent.setup.unwrap_or_default());
            file.extend(sent.data);
        }
        file
    }

    fn payload(bus: u16, device: u8) -> Sent<'static> {
        let endpoint = DATA_ENDPOINT;
        Sent { bus, device, kind: COMPLETION, transfer: BULK, endpoint, setup: None, data: &[0, 0x80] }
    }

    fn found(file: &[u8], wanted: Option<DeviceAddress>) -> Result<DeviceAddress, CaptureError> {
        survey(PacketReader::new(file).unwrap(), wanted).map(|survey| survey.address)
    }

    #[test]
    fn devices_without_camera_traffic_are_not_kept() {
        let others = (0..10u16).flat_map(|bus| (0..255).map(move |device| (bus, device))).flat_map(|(bus, device)| {
            // A mouse that moves, and a request that never ends.
            let moved = Sent { transfer: 1, endpoint: 0x81, ..payload(bus, device) };
            let setup = Some(READ_REGISTER);
            [moved, Sent { kind: SUBMISSION, transfer: CONTROL, endpoint: 0x80, setup, ..payload(bus, device) }]
        });
        let file = capture(others.chain([payload(3, 7)]));
        let camera = DeviceAddress { bus: 3, device: 7 };
        let mut devices = Devices::default();
        assert!(devices.read(PacketReader::new(&file[..]).unwrap(), None).unwrap().is_none());
        assert_eq!(devices.0.keys().collect::<Vec<_>>(), [&camera]);
        assert_eq!(found(&file, None).unwrap(), camera);
        // Such a device can still be requested.
        let mouse = DeviceAddress { bus: 9, device: 1 };
        assert_eq!(found(&file, Some(mouse)).unwrap(), mouse);
    }

    #[test]
    fn with_too_many_devices_one_has_to_be_chosen() {
        let all = || (0..5u16).flat_map(|bus| (0..255).map(move |device| payload(bus, device)));
        let few = found(&capture(all().take(100)), None).unwrap_err().to_string();
        assert!(few.contains("(0.0, 0.1, ") && few.contains("0.15, 84 others)"), "{few}");
        let file = capture(all());
        let error = found(&file, None).unwrap_err();
        assert!(matches!(error, CaptureError::TooManyDevices(DEVICES_MOST)));
        assert!(error.to_string().contains("may be the camera"), "{error}");
        let last = DeviceAddress { bus: 4, device: 254 };
        assert_eq!(found(&file, Some(last)).unwrap(), last);
    }

    #[test]
    fn the_data_kept_per_device_are_limited() {
        let mut device = Device::default();
        for module in 0..=255 {
            for parameter in 0..=255 {
                device.control([0xC0, REQUEST_REGISTER, module, 0, parameter, 0, 4, 0], &[0, 0, 0, 1]);
                device.control([0x80, GET_DESCRIPTOR, parameter, 3, 9, 4, 255, 0], &[3; 10_000]);
            }
        }
        assert_eq!((device.registers.len(), device.strings.len()), (REGISTERS_MOST, STRINGS_MOST));
        assert!(device.strings.values().all(|text| text.chars().count() == STRING_MOST));
        // Known registers may still change until payload arrives.
        device.control([0xC0, REQUEST_REGISTER, 0, 0, 5, 0, 4, 0], &[0, 0, 0, 2]);
        assert_eq!(device.registers.get(Register::new(0, 5)), Some(2));
    }
}
