//! The files below `/sys` and `/dev` that make a camera visible.

use std::fs;
use std::io;
use std::os::unix::fs::symlink;
use std::path::Path;

use crate::emulator::model::Model;

const HUB: &str = "sys/devices/pci0000:00/0000:00:14.0/usb2";

/// A port of the hub, counted from 1, and the camera in it.
#[derive(Clone, Copy)]
pub(super) struct Port(pub(super) u8);

impl Port {
    /// Returns the address on the bus: the hub has the first, and the second is left free.
    pub(super) fn address(self) -> u8 {
        self.0 + 2
    }

    /// Returns the path of the device in sysfs.
    pub(super) fn path(self) -> String {
        format!("/devices/pci0000:00/0000:00:14.0/usb2/2-{}", self.0)
    }

    /// Returns the path of the device node.
    pub(super) fn node(self) -> String {
        format!("dev/bus/usb/002/{:03}", self.address())
    }

    /// Returns the path of the socket for ioctls.
    pub(super) fn socket(self) -> String {
        format!("ioctl/{}", self.node())
    }

    fn device(self) -> String {
        format!("sys{}", self.path())
    }

    fn link(self) -> String {
        format!("sys/bus/usb/devices/2-{}", self.0)
    }
}

/// Shows the device on the bus.
pub(super) fn show(directory: &Path, port: Port) -> io::Result<()> {
    symlink(format!("../../..{}", port.path()), directory.join(port.link()))
}

/// Hides the device.
pub(super) fn hide(directory: &Path, port: Port) -> io::Result<()> {
    fs::remove_file(directory.join(port.link()))
}

/// Creates the bus.
pub(super) fn make_bus(directory: &Path) -> io::Result<()> {
    for path in [HUB, "sys/bus/usb/devices", "dev/bus/usb/002", "ioctl/dev/bus/usb/002"] {
        fs::create_dir_all(directory.join(path))?;
    }
    describe(directory, HUB, 1, "1d6b/3/601", "../../../../")?;
    let hub: [u8; 18] = [18, 1, 0, 3, 9, 0, 3, 9, 0x6B, 0x1D, 3, 0, 1, 6, 0, 0, 0, 1];
    fs::write(directory.join(HUB).join("descriptors"), hub)?;
    symlink("../../../devices/pci0000:00/0000:00:14.0/usb2", directory.join("sys/bus/usb/devices/usb2"))
}

/// Writes the sysfs attributes that every device has.
fn describe(directory: &Path, path: &str, number: u8, product: &str, depth: &str) -> io::Result<()> {
    let write = |name: &str, contents: &[u8]| fs::write(directory.join(path).join(name), contents);
    let minor = u32::from(number) + 127;
    let uevent = format!(
        "MAJOR=189\nMINOR={minor}\nDEVNAME=bus/usb/002/{number:03}\nDEVTYPE=usb_device\nDRIVER=usb\nPRODUCT={product}\nTYPE=0/0/0\nBUSNUM=002\nDEVNUM={number:03}\n"
    );
    write("uevent", uevent.as_bytes())?;
    write("busnum", b"2\n")?;
    write("devnum", format!("{number}\n").as_bytes())?;
    write("dev", format!("189:{minor}\n").as_bytes())?;
    write("speed", b"5000\n")?;
    write("bConfigurationValue", b"1\n")?;
    write("bNumConfigurations", b"1\n")?;
    write("bDeviceClass", b"00\n")?;
    symlink(format!("{depth}bus/usb"), directory.join(path).join("subsystem"))
}

/// Creates the device, still hidden.
pub(super) fn make(directory: &Path, port: Port, model: &Model) -> io::Result<()> {
    let device = port.device();
    let write = |name: &str, contents: &[u8]| fs::write(directory.join(&device).join(name), contents);
    fs::create_dir_all(directory.join(&device))?;
    let identity = model.identity();
    let product = format!("{:x}/{:x}/{:x}", identity.vendor_id, identity.product_id, identity.device_version);
    describe(directory, &device, port.address(), &product, "../../../../../")?;
    for (name, value) in
        [("idVendor", identity.vendor_id), ("idProduct", identity.product_id), ("bcdDevice", identity.device_version)]
    {
        write(name, format!("{value:04x}\n").as_bytes())?;
    }
    write("serial", format!("{}\n", identity.serial).as_bytes())?;
    write("descriptors", &model.descriptors())
}
