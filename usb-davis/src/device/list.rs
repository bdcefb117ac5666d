//! Cameras on the bus.

use std::time::Duration;

use rusb::{Context, Device, DeviceHandle, UsbContext};

use super::error::{DeviceError, Unsupported};
use crate::dump::Identity;
use crate::registers::{REQUEST_REGISTER, Register, sysinfo};
use crate::{PRODUCT_ID, VENDOR_ID};

pub(super) const CONTROL_TIMEOUT: Duration = Duration::from_secs(1);
pub(super) const INTERFACE: u8 = 0;
const FIRMWARE_LEAST: u8 = 6;
const LOGIC: u32 = 18;
const PATCH_LEAST: u32 = 1;
const CHIPS: [u32; 3] = [4, 5, 9];

/// State of a camera.
#[derive(Debug)]
pub enum Availability {
    /// The camera can be used.
    Ready {
        /// Logic version.
        logic: u32,
        /// Patch level of the logic.
        patch: u32,
    },
    /// The camera cannot be used, for this reason.
    Unavailable(DeviceError),
}

/// A camera on the bus.
#[derive(Debug)]
pub struct Listing {
    /// Number of the bus.
    pub bus: u8,
    /// Address on the bus.
    pub address: u8,
    /// Identity from the descriptors; the serial number is empty if the camera cannot be opened.
    pub identity: Identity,
    /// State of the camera.
    pub availability: Availability,
}

/// Criteria for choosing a camera; the default chooses the first usable one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selector {
    /// Required serial number.
    pub serial: Option<String>,
    /// Required bus.
    pub bus: Option<u8>,
    /// Required address.
    pub address: Option<u8>,
}

impl Selector {
    pub(super) fn admits(&self, bus: u8, address: u8) -> bool {
        self.bus.is_none_or(|wanted| wanted == bus) && self.address.is_none_or(|wanted| wanted == address)
    }

    /// Returns the criteria as a text to be appended to "152a:841a".
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        if let Some(serial) = &self.serial {
            text += &format!(", serial number {serial}");
        }
        if let Some(bus) = self.bus {
            text += &format!(", bus {bus}");
        }
        if let Some(address) = self.address {
            text += &format!(", address {address}");
        }
        text
    }
}

/// Lists all cameras on the bus, including those that are in use, forbidden or of an unsupported version.
pub fn list() -> Result<Vec<Listing>, DeviceError> {
    let context = Context::new().map_err(DeviceError::usb("starting libusb"))?;
    let mut listings = Vec::new();
    for (device, identity) in cameras(&context)? {
        let (bus, address) = (device.bus_number(), device.address());
        let (identity, availability) = match probe(&device, identity.clone()) {
            Ok((identity, logic)) => (identity, Availability::Ready { logic: logic.version, patch: logic.patch }),
            Err(error) => (identity, Availability::Unavailable(error)),
        };
        listings.push(Listing { bus, address, identity, availability });
    }
    Ok(listings)
}

/// Returns the devices with the camera's vendor and product numbers, and their identity without serial number.
pub(super) fn cameras(context: &Context) -> Result<Vec<(Device<Context>, Identity)>, DeviceError> {
    let devices = context.devices().map_err(DeviceError::usb("listing USB devices"))?;
    let mut cameras = Vec::new();
    for device in devices.iter() {
        let Ok(descriptor) = device.device_descriptor() else { continue };
        if (descriptor.vendor_id(), descriptor.product_id()) != (VENDOR_ID, PRODUCT_ID) {
            continue;
        }
        let version = descriptor.device_version();
        let device_version = u16::from_be_bytes([version.major(), version.minor() << 4 | (version.sub_minor() & 0x0F)]);
        let identity = Identity { vendor_id: VENDOR_ID, product_id: PRODUCT_ID, device_version, serial: String::new() };
        cameras.push((device, identity));
    }
    Ok(cameras)
}

fn probe(device: &Device<Context>, identity: Identity) -> Result<(Identity, Logic), DeviceError> {
    let (handle, identity) = open(device, identity)?;
    let logic = check_versions(&handle, &identity)?;
    Ok((identity, logic))
}

/// Version of the camera's logic.
pub(super) struct Logic {
    version: u32,
    patch: u32,
}

/// Opens and claims a device, and reads its serial number.
pub(super) fn open(
    device: &Device<Context>,
    identity: Identity,
) -> Result<(DeviceHandle<Context>, Identity), DeviceError> {
    let (bus, address) = (device.bus_number(), device.address());
    let refused = |doing| {
        move |error| match error {
            rusb::Error::Access => DeviceError::Forbidden { bus, address },
            rusb::Error::Busy => DeviceError::Busy { bus, address },
            error => DeviceError::usb(doing)(error),
        }
    };
    let handle = device.open().map_err(refused("opening the camera"))?;
    if handle.active_configuration().map_err(refused("reading the configuration"))? != 1 {
        handle.set_active_configuration(1).map_err(refused("choosing the configuration"))?;
    }
    handle.claim_interface(INTERFACE).map_err(refused("claiming the camera"))?;
    let descriptor = device.device_descriptor().map_err(refused("reading the descriptor"))?;
    let serial = handle.read_serial_number_string_ascii(&descriptor).unwrap_or_default();
    Ok((handle, Identity { serial, ..identity }))
}

/// Checks the versions of firmware and logic; returns the version of the logic.
pub(super) fn check_versions(handle: &DeviceHandle<Context>, identity: &Identity) -> Result<Logic, DeviceError> {
    if identity.firmware() < FIRMWARE_LEAST {
        return Err(Unsupported::Firmware { found: identity.firmware() }.into());
    }
    let version = read(handle, sysinfo::LOGIC_VERSION)?;
    if version != LOGIC {
        return Err(Unsupported::Logic { found: version }.into());
    }
    let patch = read(handle, sysinfo::LOGIC_PATCH)?;
    if patch < PATCH_LEAST {
        return Err(Unsupported::Patch { found: patch }.into());
    }
    let chip = read(handle, sysinfo::CHIP_ID)?;
    if !CHIPS.contains(&chip) {
        return Err(Unsupported::Chip { found: chip }.into());
    }
    Ok(Logic { version, patch })
}

/// Reads a register.
pub(super) fn read(handle: &DeviceHandle<Context>, register: Register) -> Result<u32, DeviceError> {
    let mut value = [0; 4];
    let (module, parameter) = (u16::from(register.module), u16::from(register.parameter));
    let got = handle
        .read_control(0xC0, REQUEST_REGISTER, module, parameter, &mut value, CONTROL_TIMEOUT)
        .map_err(DeviceError::usb("reading a register"))?;
    if got != value.len() {
        return Err(DeviceError::Usb { doing: "reading a register", source: rusb::Error::Io });
    }
    Ok(u32::from_be_bytes(value))
}

/// Writes a register.
pub(super) fn write(handle: &DeviceHandle<Context>, register: Register, value: u32) -> Result<(), DeviceError> {
    let (module, parameter) = (u16::from(register.module), u16::from(register.parameter));
    handle
        .write_control(0x40, REQUEST_REGISTER, module, parameter, &value.to_be_bytes(), CONTROL_TIMEOUT)
        .map_err(DeviceError::usb("writing a register"))?;
    Ok(())
}
