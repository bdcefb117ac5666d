//! Messages of udev to its listeners when a device is added or removed.
//!
//! Under the preload library a listener's netlink socket is a datagram socket `event…` in the directory of the emulated
//! bus. A message is a header of 40 bytes and properties `NAME=value`, each terminated by a zero byte.

use std::fs;
use std::io;
use std::os::unix::net::UnixDatagram;
use std::path::Path;

const PREFIX: &[u8; 8] = b"libudev\0";
const MAGIC: u32 = 0xFEED_CAFE;
const HEADER_BYTES: u32 = 40;
/// MurmurHash2, seed 0, of the subsystem `usb`: listeners let the kernel filter by it and by [`TYPE_HASH`].
const SUBSYSTEM_HASH: u32 = 0x0577_C5E5;
/// MurmurHash2, seed 0, of the device type `usb_device`.
const TYPE_HASH: u32 = 0x27F8_F50C;

/// Change of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    Add,
    Remove,
}

/// Returns a message about the USB device at `device_path` of sysfs, with node `/dev/bus/usb/BBB/AAA`.
fn message(action: Action, number: u64, device_path: &str, bus: u8, address: u8) -> Vec<u8> {
    let action = match action {
        Action::Add => "add",
        Action::Remove => "remove",
    };
    let minor = u32::from(bus.saturating_sub(1)) * 128 + u32::from(address.saturating_sub(1));
    let properties = format!(
        "ACTION={action}\0DEVPATH={device_path}\0SUBSYSTEM=usb\0DEVTYPE=usb_device\0DEVNAME=/dev/bus/usb/{bus:03}/{address:03}\0\
         BUSNUM={bus:03}\0DEVNUM={address:03}\0MAJOR=189\0MINOR={minor}\0SEQNUM={number}\0"
    );
    let mut message = PREFIX.to_vec();
    message.extend(MAGIC.to_be_bytes());
    for number in [HEADER_BYTES, HEADER_BYTES, properties.len() as u32] {
        message.extend(number.to_ne_bytes());
    }
    for hash in [SUBSYSTEM_HASH, TYPE_HASH] {
        message.extend(hash.to_be_bytes());
    }
    // Hash of the tags; there are no tags.
    message.extend([0; 8]);
    message.extend(properties.into_bytes());
    message
}

/// Notifies all listeners on the emulated bus in `directory`.
pub(super) fn send(
    directory: &Path,
    action: Action,
    number: u64,
    device_path: &str,
    bus: u8,
    address: u8,
) -> io::Result<()> {
    let message = message(action, number, device_path, bus, address);
    let socket = UnixDatagram::unbound()?;
    socket.set_nonblocking(true)?;
    for entry in fs::read_dir(directory)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with("event") {
            // A listener that has ended may leave its socket behind.
            let _ = socket.send_to(&message, entry.path());
        }
    }
    Ok(())
}
