//! The emulated camera for processes that run under umockdev's preload library (Debian package `umockdev`): they see it
//! in `/sys` and `/dev/bus/usb`, through the real libusb.
//!
//! The library redirects opens below `/dev` and `/sys` to our directory, and sends each ioctl of a device node over a
//! socket, with three native 64-bit numbers per message.
//!
//! ```text
//! client: 1 request argument        an ioctl
//! server: 5 address length          asks for memory; the client sends the bytes
//!         6 address length          then bytes to be put there
//!         3 result errno            the ioctl is answered
//! ```
//! The device node is a FIFO of one page: libusb waits for it to become writable, which signals that there is something
//! to reap. A byte in it makes it full.

mod tree;
mod uevent;

use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use rustix::fd::OwnedFd;
use rustix::fs::{CWD, FileType, Mode, OFlags, mknodat, open};

use tree::Port;
use uevent::Action;

use super::model::Model;
use super::usbfs::{Memory, OpenNode};

/// Bus and address at which the camera appears.
pub const BUS: u8 = 2;
/// See [`BUS`].
pub const ADDRESS: u8 = 3;
/// Port with that address.
const FIRST: Port = Port(1);

const PRELOAD: &str = "libumockdev-preload.so.0";
/// Interval at which connections of programs that open the device are accepted.
const ACCEPT_POLL: Duration = Duration::from_millis(1);

const REQUEST_IOCTL: u64 = 1;
const ANSWER_DONE: u64 = 3;
const ANSWER_READ_MEMORY: u64 = 5;
const ANSWER_WRITE_MEMORY: u64 = 6;
const EINVAL: i32 = 22;

/// Access to the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Access {
    /// Everybody may use the camera.
    #[default]
    Free,
    /// Another program uses the camera.
    Busy,
    /// Only the superuser may use the camera, as without a udev rule.
    Forbidden,
}

struct Bus {
    directory: PathBuf,
    port: Port,
    model: Model,
    nodes: Vec<(u64, OpenNode)>,
    access: Access,
    unplugged: bool,
    /// Number of udev messages sent.
    messages: u64,
    fifo: OwnedFd,
    fifo_full: bool,
}

impl Bus {
    /// Sends available data, unplugs the camera when it is time, and signals whether there is something to reap.
    fn turn(&mut self) -> io::Result<()> {
        if !self.unplugged {
            for (_, node) in &mut self.nodes {
                if !node.gone && (node.claimed || !node.is_ready()) {
                    node.pump(&mut self.model);
                }
            }
            if self.model.take_unplug() {
                self.unplug()?;
            }
        }
        let ready = self.nodes.iter().any(|(_, node)| node.is_ready());
        if ready == self.fifo_full {
            // A byte is read or written. The FIFO belongs to the emulator and never blocks.
            let moved = match ready {
                true => rustix::io::read(&self.fifo, &mut [0; 16]).is_ok(),
                false => rustix::io::write(&self.fifo, &[0]).is_ok(),
            };
            self.fifo_full = if moved { !ready } else { self.fifo_full };
        }
        Ok(())
    }

    fn unplug(&mut self) -> io::Result<()> {
        if !std::mem::replace(&mut self.unplugged, true) {
            self.nodes.iter_mut().for_each(|(_, node)| node.shut_down());
            tree::hide(&self.directory, self.port)?;
            self.notify(Action::Remove)?;
        }
        Ok(())
    }

    fn plug_in(&mut self) -> io::Result<()> {
        if std::mem::replace(&mut self.unplugged, false) {
            self.model.power_cycle();
            tree::show(&self.directory, self.port)?;
            self.notify(Action::Add)?;
        }
        Ok(())
    }

    fn notify(&mut self, action: Action) -> io::Result<()> {
        self.messages += 1;
        let (path, address) = (self.port.path(), self.port.address());
        uevent::send(&self.directory, action, self.messages, &path, BUS, address)
    }
}

/// An emulated camera on its own bus, or on the bus of another.
pub struct EmulatedBus {
    directory: PathBuf,
    port: Port,
    bus: Arc<Mutex<Bus>>,
    ended: Arc<AtomicBool>,
}

fn lock(bus: &Mutex<Bus>) -> MutexGuard<'_, Bus> {
    bus.lock().unwrap_or_else(PoisonError::into_inner)
}

fn set_mode(path: &Path, mode: u32) -> io::Result<()> {
    fs::set_permissions(path, fs::Permissions::from_mode(mode))
}

impl EmulatedBus {
    /// Plugs the camera in.
    pub fn start(model: Model) -> io::Result<Self> {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        // The path of a socket may have 108 bytes.
        let name = format!("davis-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let directory = std::env::temp_dir().join(name);
        tree::make_bus(&directory)?;
        // Programs of other users create sockets there too, to listen to udev.
        set_mode(&directory, 0o1777)?;
        Self::plug_into(directory, FIRST, model)
    }

    /// Plugs another camera into the bus of this one, at the next address. It disappears together with this one.
    pub fn plug_in_another(&self, model: Model) -> io::Result<Self> {
        Self::plug_into(self.directory.clone(), Port(self.port.0 + 1), model)
    }

    fn plug_into(directory: PathBuf, port: Port, model: Model) -> io::Result<Self> {
        tree::make(&directory, port, &model)?;
        tree::show(&directory, port)?;
        let node = directory.join(port.node());
        mknodat(CWD, &node, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)?;
        let fifo = open(&node, OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?;
        rustix::pipe::fcntl_setpipe_size(&fifo, 4096)?;
        rustix::io::write(&fifo, &[0])?;
        let bus = Bus {
            directory: directory.clone(),
            port,
            model,
            nodes: Vec::new(),
            access: Access::Free,
            unplugged: false,
            messages: 0,
            fifo,
            fifo_full: true,
        };
        let bus = Arc::new(Mutex::new(bus));
        let ended = Arc::new(AtomicBool::new(false));
        let listener = UnixListener::bind(directory.join(port.socket()))?;
        listener.set_nonblocking(true)?;
        set_mode(&directory.join(port.socket()), 0o666)?;
        set_mode(&node, 0o666)?;
        let (of_thread, until) = (Arc::clone(&bus), Arc::clone(&ended));
        thread::spawn(move || serve(&listener, &of_thread, &until));
        let (of_thread, until) = (Arc::clone(&bus), Arc::clone(&ended));
        thread::spawn(move || {
            while !until.load(Ordering::Relaxed) {
                let interval = {
                    let mut bus = lock(&of_thread);
                    // This fails if the directory is gone, and then there is no bus.
                    let _ = bus.turn();
                    bus.model.turn_interval()
                };
                thread::sleep(interval);
            }
        });
        Ok(Self { directory, port, bus, ended })
    }

    /// Returns the environment variables with which a process sees the camera.
    pub fn environment(&self) -> [(&'static str, PathBuf); 2] {
        [("LD_PRELOAD", PathBuf::from(PRELOAD)), ("UMOCKDEV_DIR", self.directory.clone())]
    }

    /// Unplugs the camera. Programs see it disappear, and udev listeners are notified.
    pub fn unplug(&self) -> io::Result<()> {
        let mut bus = lock(&self.bus);
        bus.unplug()?;
        bus.turn()
    }

    /// Plugs the camera in again, after [`EmulatedBus::unplug`] or a fault unplugged it. Its registers have their
    /// initial values; programs that had it open must open it again.
    pub fn plug_in(&self) -> io::Result<()> {
        lock(&self.bus).plug_in()
    }

    /// Sets the access to the camera from now on.
    pub fn set_access(&self, access: Access) -> io::Result<()> {
        let mut bus = lock(&self.bus);
        bus.access = access;
        let mode = if access == Access::Forbidden { 0o000 } else { 0o666 };
        set_mode(&self.directory.join(self.port.node()), mode)
    }

    /// Calls `visit` with the model of the camera.
    pub fn model<T>(&self, visit: impl FnOnce(&mut Model) -> T) -> T {
        visit(&mut lock(&self.bus).model)
    }
}

impl Drop for EmulatedBus {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if self.port.0 == FIRST.0 {
            // Files that cannot be removed stay in the temporary directory.
            let _ = fs::remove_dir_all(&self.directory);
        }
    }
}

/// Accepts connections, one per open device node.
fn serve(listener: &UnixListener, bus: &Arc<Mutex<Bus>>, ended: &AtomicBool) {
    let mut number = 0;
    while !ended.load(Ordering::Relaxed) {
        let Ok((stream, _)) = listener.accept() else {
            thread::sleep(ACCEPT_POLL);
            continue;
        };
        number += 1;
        let (bus, id) = (Arc::clone(bus), number);
        thread::spawn(move || {
            {
                let mut bus = lock(&bus);
                let mut node = OpenNode::default();
                node.gone = bus.unplugged;
                bus.nodes.push((id, node));
            }
            // An error is the end of the client or of the bus.
            let _ = answer(stream, &bus, id);
            let mut bus = lock(&bus);
            bus.nodes.retain(|(other, _)| *other != id);
            let _ = bus.turn();
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
        let Bus { model, nodes, access, .. } = &mut *guard;
        let claimed = |(other, node): &(u64, OpenNode)| *other != id && node.claimed && !node.gone;
        let elsewhere = *access == Access::Busy || nodes.iter().any(claimed);
        let node = nodes.iter_mut().find(|(other, _)| *other == id);
        let result = match node {
            Some((_, node)) if command == REQUEST_IOCTL => {
                node.ioctl(request as u32, argument, model, elsewhere, &mut memory)?
            }
            _ => Err(EINVAL),
        };
        guard.turn()?;
        drop(guard);
        let (result, error) = match result {
            Ok(result) => (result, 0),
            Err(error) => (u64::MAX, error as u64),
        };
        message(&mut memory.0, [ANSWER_DONE, result, error])?;
    }
}
