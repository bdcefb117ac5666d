//! The files below `/sys` and `/dev` that make a camera visible.

use std::fs;
use std::io;
use std::os::unix::fs::symlink;
use std::path::Path;

use crate::emulator::model::Model;

const HUB: &str = "sys/devices/pci0000:00/0000:00:14.0/usb2";
const DEVICE: &str = "sys/devices/pci0000:00/0000:00:14.0/usb2/2-1";
const DEVICE_LINK: &str = "sys/bus/usb/devices/2-1";
/// Where sysfs has the device.
pub(super) const DEVICE_PATH: &str = "/devices/pci0000:00/0000:00:14.0/usb2/2-1";

/// Makes the device appear on the bus.
pub(super) fn show(directory: &Path) -> io::Result<()> {
    symlink("../../../devices/pci0000:00/0000:00:14.0/usb2/2-1", directory.join(DEVICE_LINK))
}

/// Makes it disappear.
pub(super) fn hide(directory: &Path) -> io::Result<()> {
    fs::remove_file(directory.join(DEVICE_LINK))
}

/// Makes bus and device, which is hidden still.
pub(super) fn make(directory: &Path, model: &Model) -> io::Result<()> {
    let write = |path: &str, name: &str, contents: &[u8]| fs::write(directory.join(path).join(name), contents);
    for path in [DEVICE, "sys/bus/usb/devices", "dev/bus/usb/002", "ioctl/dev/bus/usb/002"] {
        fs::create_dir_all(directory.join(path))?;
    }
    let identity = model.identity();
    let product = format!("{:x}/{:x}/{:x}", identity.vendor_id, identity.product_id, identity.device_version);
    for (path, node, minor, product, depth) in
        [(HUB, "001", 128, "1d6b/3/601".to_owned(), "../../../../"), (DEVICE, "003", 130, product, "../../../../../")]
    {
        let number = minor - 127;
        let uevent = format!(
            "MAJOR=189\nMINOR={minor}\nDEVNAME=bus/usb/002/{node}\nDEVTYPE=usb_device\nDRIVER=usb\nPRODUCT={product}\nTYPE=0/0/0\nBUSNUM=002\nDEVNUM={node}\n"
        );
        write(path, "uevent", uevent.as_bytes())?;
        write(path, "busnum", b"2\n")?;
        write(path, "devnum", format!("{number}\n").as_bytes())?;
        write(path, "dev", format!("189:{minor}\n").as_bytes())?;
        write(path, "speed", b"5000\n")?;
        write(path, "bConfigurationValue", b"1\n")?;
        write(path, "bNumConfigurations", b"1\n")?;
        write(path, "bDeviceClass", b"00\n")?;
        symlink(format!("{depth}bus/usb"), directory.join(path).join("subsystem"))?;
    }
    for (name, value) in
        [("idVendor", identity.vendor_id), ("idProduct", identity.product_id), ("bcdDevice", identity.device_version)]
    {
        write(DEVICE, name, format!("{value:04x}\n").as_bytes())?;
    }
    write(DEVICE, "serial", format!("{}\n", identity.serial).as_bytes())?;
    write(DEVICE, "descriptors", &model.descriptors())?;
    let hub: [u8; 18] = [18, 1, 0, 3, 9, 0, 3, 9, 0x6B, 0x1D, 3, 0, 1, 6, 0, 0, 0, 1];
    write(HUB, "descriptors", &hub)?;
    symlink("../../../devices/pci0000:00/0000:00:14.0/usb2", directory.join("sys/bus/usb/devices/usb2"))
}
