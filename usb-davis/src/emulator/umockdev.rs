//! The emulated camera for processes that run under umockdev's preload library (Debian package
//! `umockdev`): they see it in `/sys` and `/dev/bus/usb`, through the real libusb.
//!
//! The library turns opens below `/dev` and `/sys` to a directory of ours, and sends each ioctl of
//! a device node over a socket: three native 64-bit numbers a message.
//!
//! ```text
//! client: 1 request argument        an ioctl
//! server: 5 address length          asks for memory; the client sends the bytes
//!         6 address length          then bytes to be put there
//!         3 result errno            the ioctl is answered
//! ```
//! The device node is a FIFO of one page: libusb waits for it to become writable, as it is while
//! there is something to reap. A byte in it makes it full.

use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::fs::symlink;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use rustix::fd::OwnedFd;
use rustix::fs::{CWD, FileType, Mode, OFlags, mknodat, open};

use super::model::Model;
use super::usbfs::{Memory, OpenNode};

/// Bus and address at which the camera appears.
pub const BUS: u8 = 2;
/// See [`BUS`].
pub const ADDRESS: u8 = 3;

const PRELOAD: &str = "libumockdev-preload.so.0";
const HUB: &str = "sys/devices/pci0000:00/0000:00:14.0/usb2";
const DEVICE: &str = "sys/devices/pci0000:00/0000:00:14.0/usb2/2-1";
const DEVICE_LINK: &str = "sys/bus/usb/devices/2-1";
const NODE: &str = "dev/bus/usb/002/003";
const SOCKET: &str = "ioctl/dev/bus/usb/002/003";
/// How often the camera looks whether it has something to send.
const TICK: Duration = Duration::from_millis(1);

const REQUEST_IOCTL: u64 = 1;
const ANSWER_DONE: u64 = 3;
const ANSWER_READ_MEMORY: u64 = 5;
const ANSWER_WRITE_MEMORY: u64 = 6;
const EINVAL: i32 = 22;

struct Bus {
    model: Model,
    nodes: Vec<(u64, OpenNode)>,
    unplugged: bool,
    fifo: OwnedFd,
    fifo_full: bool,
}

impl Bus {
    /// Sends what can be sent, unplugs when it is time, and shows whether there is something to reap.
    fn turn(&mut self) {
        if !self.unplugged {
            for (_, node) in &mut self.nodes {
                if node.claimed || !node.is_ready() {
                    node.pump(&mut self.model);
                }
            }
            if self.model.is_to_be_unplugged() {
                self.unplug();
            }
        }
        let ready = self.nodes.iter().any(|(_, node)| node.is_ready());
        if ready == self.fifo_full {
            // One byte in or out; the FIFO is ours and never blocks.
            let moved = match ready {
                true => rustix::io::read(&self.fifo, &mut [0; 16]).is_ok(),
                false => rustix::io::write(&self.fifo, &[0]).is_ok(),
            };
            self.fifo_full = if moved { !ready } else { self.fifo_full };
        }
    }

    fn unplug(&mut self) {
        self.unplugged = true;
        self.nodes.iter_mut().for_each(|(_, node)| node.shut_down());
    }
}

/// An emulated camera on a bus of its own.
pub struct EmulatedBus {
    directory: PathBuf,
    bus: Arc<Mutex<Bus>>,
    ended: Arc<AtomicBool>,
}

fn lock(bus: &Mutex<Bus>) -> MutexGuard<'_, Bus> {
    bus.lock().unwrap_or_else(PoisonError::into_inner)
}

impl EmulatedBus {
    /// Plugs the camera in.
    pub fn start(model: Model) -> io::Result<Self> {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        // The path of a socket may have 108 bytes.
        let name = format!("davis-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let directory = std::env::temp_dir().join(name);
        make_tree(&directory, &model)?;
        let node = directory.join(NODE);
        mknodat(CWD, &node, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)?;
        let fifo = open(&node, OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?;
        rustix::pipe::fcntl_setpipe_size(&fifo, 4096)?;
        rustix::io::write(&fifo, &[0])?;
        let bus = Bus { model, nodes: Vec::new(), unplugged: false, fifo, fifo_full: true };
        let bus = Arc::new(Mutex::new(bus));
        let ended = Arc::new(AtomicBool::new(false));
        let listener = UnixListener::bind(directory.join(SOCKET))?;
        listener.set_nonblocking(true)?;
        let (of_thread, until) = (Arc::clone(&bus), Arc::clone(&ended));
        thread::spawn(move || serve(&listener, &of_thread, &until));
        let (of_thread, until, link) = (Arc::clone(&bus), Arc::clone(&ended), directory.join(DEVICE_LINK));
        thread::spawn(move || {
            while !until.load(Ordering::Relaxed) {
                thread::sleep(TICK);
                let mut bus = lock(&of_thread);
                bus.turn();
                if bus.unplugged {
                    // It may be gone already.
                    let _ = fs::remove_file(&link);
                }
            }
        });
        Ok(Self { directory, bus, ended })
    }

    /// Environment variables under which a process sees the camera.
    pub fn environment(&self) -> [(&'static str, PathBuf); 2] {
        [("LD_PRELOAD", PathBuf::from(PRELOAD)), ("UMOCKDEV_DIR", self.directory.clone())]
    }

    /// Pulls the plug.
    pub fn unplug(&self) {
        let mut bus = lock(&self.bus);
        bus.unplug();
        bus.turn();
    }

    /// Looks at the camera.
    pub fn model<T>(&self, look: impl FnOnce(&mut Model) -> T) -> T {
        look(&mut lock(&self.bus).model)
    }
}

impl Drop for EmulatedBus {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        // What cannot be removed stays in the temporary directory.
        let _ = fs::remove_dir_all(&self.directory);
    }
}

fn make_tree(directory: &Path, model: &Model) -> io::Result<()> {
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
    symlink("../../../devices/pci0000:00/0000:00:14.0/usb2", directory.join("sys/bus/usb/devices/usb2"))?;
    symlink("../../../devices/pci0000:00/0000:00:14.0/usb2/2-1", directory.join(DEVICE_LINK))
}

/// Takes connections, one for each open device node.
fn serve(listener: &UnixListener, bus: &Arc<Mutex<Bus>>, ended: &AtomicBool) {
    let mut number = 0;
    while !ended.load(Ordering::Relaxed) {
        let Ok((stream, _)) = listener.accept() else {
            thread::sleep(TICK);
            continue;
        };
        number += 1;
        let (bus, id) = (Arc::clone(bus), number);
        thread::spawn(move || {
            lock(&bus).nodes.push((id, OpenNode::default()));
            // An error is the client's end.
            let _ = answer(stream, &bus, id);
            let mut bus = lock(&bus);
            bus.nodes.retain(|(other, _)| *other != id);
            bus.turn();
        });
    }
}

struct ClientMemory(UnixStream);

fn message(stream: &mut UnixStream, numbers: [u64; 3]) -> io::Result<()> {
    let bytes: Vec<u8> = numbers.into_iter().flat_map(u64::to_ne_bytes).collect();
    stream.write_all(&bytes)
}

impl Memory for ClientMemory {
    fn read(&mut self, address: u64, bytes: &mut [u8]) -> io::Result<()> {
        message(&mut self.0, [ANSWER_READ_MEMORY, address, bytes.len() as u64])?;
        self.0.read_exact(bytes)
    }

    fn write(&mut self, address: u64, bytes: &[u8]) -> io::Result<()> {
        message(&mut self.0, [ANSWER_WRITE_MEMORY, address, bytes.len() as u64])?;
        self.0.write_all(bytes)
    }
}

/// Answers the ioctls of one open node until it is closed.
fn answer(stream: UnixStream, bus: &Mutex<Bus>, id: u64) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    let mut memory = ClientMemory(stream);
    loop {
        let mut bytes = [0; 24];
        memory.0.read_exact(&mut bytes)?;
        let (numbers, _) = bytes.as_chunks::<8>();
        let number = |index: usize| numbers.get(index).copied().map_or(0, u64::from_ne_bytes);
        let (command, request, argument) = (number(0), number(1), number(2));
        let mut guard = lock(bus);
        let Bus { model, nodes, unplugged, .. } = &mut *guard;
        let elsewhere = nodes.iter().any(|(other, node)| *other != id && node.claimed);
        let node = nodes.iter_mut().find(|(other, _)| *other == id);
        let result = match node {
            Some((_, node)) if command == REQUEST_IOCTL => {
                node.ioctl(request as u32, argument, model, elsewhere, *unplugged, &mut memory)?
            }
            _ => Err(EINVAL),
        };
        guard.turn();
        drop(guard);
        let (result, error) = match result {
            Ok(result) => (result, 0),
            Err(error) => (u64::MAX, error as u64),
        };
        message(&mut memory.0, [ANSWER_DONE, result, error])?;
    }
}
