//! Ports of the virtual host controller, as in sysfs.
//!
//! `status` (and `status.1`, … with more controllers) has a heading and one line per port:
//!
//! ```text
//! hub port sta spd dev      sockfd local_busid
//! hs  0000 004 000 00000000 000000 0-0
//! ss  0008 006 005 00020003 000003 4-1
//! ```
//! State 4 is a free port, state 6 a port with an enumerated device.

use std::fs;
use std::io::{self, ErrorKind};
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::path::Path;

use super::Location;

/// Path of the controller in sysfs.
pub(super) const CONTROLLER: &str = "/sys/devices/platform/vhci_hcd.0";
const DEVICES: &str = "/sys/bus/usb/devices";
const SUPER_SPEED_HUB: &str = "ss";
const SPEED_SUPER: u32 = 5;
const STATE_FREE: u32 = 4;
/// Number of the device at the other end of the connection: bus 2, address 3. It has no effect here.
const DEVICE: u32 = 0x0002_0003;

/// Reason why the camera cannot be plugged in or unplugged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VhciError {
    /// The virtual host controller does not exist.
    #[error(
        "the kernel's virtual USB controller is not there ({CONTROLLER}): run `modprobe vhci-hcd` as root; if there is no such module, this kernel was built without USB/IP (on Debian, the package linux-image-cloud-amd64 was, linux-image-amd64 was not)"
    )]
    ModuleNotLoaded,
    /// The user is not root.
    #[error("only root may plug a camera into the virtual USB controller: run it as root, for example with sudo")]
    NotRoot,
    /// All ports are used.
    #[error(
        "all {ports} SuperSpeed ports of the virtual USB controller are used: end another emulated camera, or detach a device with `usbip detach`"
    )]
    NoFreePort {
        /// Number of ports.
        ports: usize,
    },
    /// The kernel did not free a port.
    #[error("the kernel has not freed port {port} of the virtual USB controller, although its camera was unplugged")]
    StillAttached {
        /// Number of the port.
        port: u32,
    },
    /// The operating system reported an error.
    #[error("while {doing}: {source}")]
    Kernel {
        /// Operation that failed.
        doing: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
}

impl VhciError {
    fn kernel(doing: &'static str) -> impl Fn(io::Error) -> Self {
        move |source| match source.kind() {
            ErrorKind::NotFound => Self::ModuleNotLoaded,
            ErrorKind::PermissionDenied => Self::NotRoot,
            _ => Self::Kernel { doing, source },
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Port {
    super_speed: bool,
    number: u32,
    state: u32,
    /// Name of the device in sysfs, such as 4-1.
    device: String,
}

/// Parses the lines of a status file, without the heading.
fn parse(status: &str) -> impl Iterator<Item = Port> + '_ {
    status.lines().filter_map(|line| {
        let mut columns = line.split_whitespace();
        let super_speed = columns.next()? == SUPER_SPEED_HUB;
        let number = columns.next()?.parse().ok()?;
        let state = columns.next()?.parse().ok()?;
        let device = columns.last()?.to_owned();
        Some(Port { super_speed, number, state, device })
    })
}

fn ports(controller: &Path) -> Result<Vec<Port>, VhciError> {
    let failed = VhciError::kernel("reading the ports of the virtual USB controller");
    let first = fs::read_to_string(controller.join("status")).map_err(&failed)?;
    let mut ports: Vec<Port> = parse(&first).collect();
    for further in 1.. {
        match fs::read_to_string(controller.join(format!("status.{further}"))) {
            Ok(status) => ports.extend(parse(&status)),
            Err(error) if error.kind() == ErrorKind::NotFound => break,
            Err(error) => return Err(failed(error)),
        }
    }
    Ok(ports)
}

/// Attaches a device that is at the other end of `connection`; returns the port.
pub(super) fn attach(controller: &Path, connection: &UnixStream) -> Result<u32, VhciError> {
    let ports = ports(controller)?;
    let of_super_speed = || ports.iter().filter(|port| port.super_speed);
    for port in of_super_speed().filter(|port| port.state == STATE_FREE) {
        let line = format!("{} {} {DEVICE} {SPEED_SUPER}", port.number, connection.as_raw_fd());
        match fs::write(controller.join("attach"), line) {
            Ok(()) => return Ok(port.number),
            // Another process was faster.
            Err(error) if error.kind() == ErrorKind::ResourceBusy => {}
            Err(error) => return Err(VhciError::kernel("attaching the camera")(error)),
        }
    }
    Err(VhciError::NoFreePort { ports: of_super_speed().count() })
}

/// Returns `true` if a device is attached to `port`.
pub(super) fn is_used(controller: &Path, port: u32) -> Result<bool, VhciError> {
    Ok(ports(controller)?.iter().any(|other| other.number == port && other.state != STATE_FREE))
}

/// Returns bus and address of the device at `port`, once the kernel has configured it.
pub(super) fn location(controller: &Path, port: u32) -> Result<Option<Location>, VhciError> {
    let Some(port) = ports(controller)?.into_iter().find(|other| other.number == port) else { return Ok(None) };
    let number = |name| fs::read_to_string(Path::new(DEVICES).join(&port.device).join(name)).ok()?.trim().parse().ok();
    let configured = number("bConfigurationValue").is_some_and(|number| number > 0);
    let location = number("busnum").zip(number("devnum")).map(|(bus, address)| Location { bus, address });
    Ok(location.filter(|_| configured))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATUS: &str = "hub port sta spd dev      sockfd local_busid\n\
        hs  0000 004 000 00000000 000000 0-0\n\
        ss  0008 006 005 00020003 000003 4-1\n\
        ss  0009 004 000 00000000 000000 0-0\n";

    fn controller(status: &str) -> tempfile::TempDir {
        let directory = tempfile::tempdir().expect("a directory can be made");
        fs::write(directory.path().join("status"), status).expect("it can be written");
        fs::write(directory.path().join("attach"), "").expect("it can be written");
        directory
    }

    #[test]
    fn a_free_super_speed_port_is_used() {
        let directory = controller(STATUS);
        let (_, connection) = UnixStream::pair().expect("a pair");
        assert_eq!(attach(directory.path(), &connection).expect("a free port"), 9);
        let written = fs::read_to_string(directory.path().join("attach")).expect("it was written");
        assert_eq!(written, format!("9 {} 131075 5", connection.as_raw_fd()));
        let used = [0, 8, 9, 10].map(|port| is_used(directory.path(), port).expect("a status"));
        assert_eq!(used, [false, true, false, false]);
    }

    #[test]
    fn further_controllers_have_ports_too() {
        let directory = controller(&STATUS.replace("0009 004", "0009 006"));
        fs::write(directory.path().join("status.1"), "ss  0024 004 000 00000000 000000 0-0\n").expect("written");
        let (_, connection) = UnixStream::pair().expect("a pair");
        assert_eq!(attach(directory.path(), &connection).expect("a free port"), 24);
    }

    #[test]
    fn errors_name_what_is_missing() {
        let (_, connection) = UnixStream::pair().expect("a pair");
        let error = |directory: &Path| attach(directory, &connection).expect_err("it must fail").to_string();
        let directory = tempfile::tempdir().expect("a directory can be made");
        assert!(error(directory.path()).contains("modprobe vhci-hcd"));
        let directory = controller(&STATUS.replace("0009 004", "0009 006"));
        assert!(error(directory.path()).contains("all 2 SuperSpeed ports"));
        let denied = VhciError::kernel("attaching")(io::Error::from(ErrorKind::PermissionDenied));
        assert!(denied.to_string().contains("sudo"));
    }
}
