//! The emulated camera on the kernel's virtual USB host controller (module `vhci-hcd`): every program on the computer
//! sees it in `/dev/bus/usb`, like a real camera.
//!
//! The controller accepts a connected socket, and communicates over it by USB/IP; here the emulated camera is at the
//! other end. Neither a network nor the `usbip` tools are needed.

mod port;

use std::io::{self, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

pub use port::VhciError;

use super::model::Model;
use super::stall::Stall;
use super::transfers::QueuedTransfers;
use super::usbip::{Command, Submission, read_command, read_done, unlink_done, write_done};

/// Interval at which the port of an unplugged camera is checked until the kernel has freed it.
const DETACH_POLL: Duration = Duration::from_millis(5);
/// Longest wait until the kernel has freed the port of an unplugged camera.
const DETACH_TIMEOUT: Duration = Duration::from_secs(5);
const EPIPE: i32 = 32;
const ECONNRESET: i32 = 104;
const READS: u8 = 0x80;

/// The connection to the kernel, which lasts from plugging in to unplugging.
struct Link {
    number: u64,
    socket: UnixStream,
    queued: QueuedTransfers<u32>,
    port: u32,
}

impl Link {
    /// Answers a control request; queues or cancels a transfer of another endpoint.
    fn execute(&mut self, command: Command, model: &mut Model) -> io::Result<()> {
        match command {
            Command::Unlink { number, victim } => {
                let status = self.queued.remove(|queued| *queued == victim).map_or(0, |_| -ECONNRESET);
                self.socket.write_all(&unlink_done(number, status))
            }
            Command::Submit(Submission { number, endpoint: 0x00 | READS, setup, data, .. }) => {
                let [kind, ..] = setup;
                self.socket.write_all(&match model.control(setup, &data) {
                    Ok(answer) if kind & READS != 0 => read_done(number, 0, &answer),
                    Ok(_) => write_done(number, 0, data.len()),
                    Err(Stall) => write_done(number, -EPIPE, 0),
                })
            }
            Command::Submit(Submission { number, endpoint, length, .. }) => {
                self.queued.push(number, endpoint, length);
                Ok(())
            }
        }
    }

    /// Sends one transfer; returns `false` if nothing was waiting.
    fn send(&mut self, model: &mut Model) -> io::Result<bool> {
        let Some((number, data)) = self.queued.next(model) else { return Ok(false) };
        self.socket.write_all(&match data {
            Ok(data) => read_done(number, 0, &data),
            Err(fault) => read_done(number, -fault.errno(), &[]),
        })?;
        Ok(true)
    }
}

struct Shared {
    model: Model,
    link: Option<Link>,
}

impl Shared {
    /// Closes the connection. Data that were sent before still arrive; queued transfers end with the connection.
    fn unplug(&mut self) {
        if let Some(link) = self.link.take() {
            // The kernel may have closed it already.
            let _ = link.socket.shutdown(Shutdown::Both);
        }
    }

    /// Executes a command that came over the connection of this number; an error ends the connection.
    fn receive(&mut self, number: u64, command: io::Result<Command>) {
        // Another connection may have replaced it.
        let Some(link) = self.link.as_mut().filter(|link| link.number == number) else { return };
        if command.and_then(|command| link.execute(command, &mut self.model)).is_err() {
            self.unplug();
        }
    }

    /// Sends one transfer, and unplugs the camera when it is time. Returns the time until the next turn.
    fn turn(&mut self) -> Duration {
        self.model.turn();
        let Some(link) = &mut self.link else { return self.model.turn_interval() };
        let sent = link.send(&mut self.model);
        if sent.is_err() || self.model.take_unplug() {
            self.unplug();
        }
        if sent.is_ok_and(|sent| sent) { Duration::ZERO } else { self.model.turn_interval() }
    }
}

/// Commands from the kernel, each with the number of the connection.
type Commands = Sender<(u64, io::Result<Command>)>;

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Bus and address that the kernel assigned to the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Location {
    /// Number of the bus.
    pub bus: u8,
    /// Address on the bus.
    pub address: u8,
}

/// An emulated camera that is plugged into this computer. It is unplugged when dropped, and at the end of the process.
pub struct VirtualCamera {
    shared: Arc<Mutex<Shared>>,
    commands: Commands,
    ended: Arc<AtomicBool>,
    worker: Option<JoinHandle<()>>,
    /// Number of times that it was plugged in.
    links: u64,
    /// Its latest port.
    port: u32,
}

impl VirtualCamera {
    /// Plugs the camera into a free SuperSpeed port.
    pub fn plug_in(model: Model) -> Result<Self, VhciError> {
        let (link, reader) = connect(0)?;
        let port = link.port;
        let shared = Arc::new(Mutex::new(Shared { model, link: Some(link) }));
        let (commands, received) = channel();
        listen(commands.clone(), reader, 0);
        let ended = Arc::new(AtomicBool::new(false));
        let (of_thread, until) = (Arc::clone(&shared), Arc::clone(&ended));
        let worker = Some(thread::spawn(move || work(&of_thread, &received, &until)));
        Ok(Self { shared, commands, ended, worker, links: 1, port })
    }

    /// Unplugs the camera, and waits until the kernel has noticed.
    pub fn unplug(&self) -> Result<(), VhciError> {
        lock(&self.shared).unplug();
        let end = Instant::now() + DETACH_TIMEOUT;
        while port::is_used(Path::new(port::CONTROLLER), self.port)? {
            if Instant::now() >= end {
                return Err(VhciError::StillAttached { port: self.port });
            }
            thread::sleep(DETACH_POLL);
        }
        Ok(())
    }

    /// Plugs the camera in again, after [`VirtualCamera::unplug`] or a fault unplugged it. Its registers have their
    /// initial values.
    pub fn plug_in_again(&mut self) -> Result<(), VhciError> {
        if self.is_plugged_in() {
            return Ok(());
        }
        let number = self.links;
        let (link, reader) = connect(number)?;
        (self.links, self.port) = (number + 1, link.port);
        {
            let mut shared = lock(&self.shared);
            shared.model.power_cycle();
            shared.link = Some(link);
        }
        listen(self.commands.clone(), reader, number);
        Ok(())
    }

    /// Returns `true` if the camera is plugged in, that is, neither unplugged nor detached by the kernel.
    pub fn is_plugged_in(&self) -> bool {
        lock(&self.shared).link.is_some()
    }

    /// Returns the number of the controller's port into which it was plugged last.
    pub fn port(&self) -> u32 {
        self.port
    }

    /// Returns bus and address of the camera; `None` until the kernel has assigned them and programs can open the
    /// camera, about 100 ms after plugging in.
    pub fn location(&self) -> Result<Option<Location>, VhciError> {
        port::location(Path::new(port::CONTROLLER), self.port)
    }

    /// Calls `visit` with the model of the camera.
    pub fn model<T>(&self, visit: impl FnOnce(&mut Model) -> T) -> T {
        visit(&mut lock(&self.shared).model)
    }
}

impl Drop for VirtualCamera {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(worker) = self.worker.take() {
            // The thread does not panic.
            let _ = worker.join();
        }
        // Wait until the port is free, because the next camera may need it; an error cannot be reported here.
        let _ = self.unplug();
    }
}

/// Passes one end of a new connection to the kernel; returns the other, and a second handle to read from it.
fn connect(number: u64) -> Result<(Link, UnixStream), VhciError> {
    let failed = |source| VhciError::Kernel { doing: "making a connection", source };
    let (socket, kernels) = UnixStream::pair().map_err(failed)?;
    let reader = socket.try_clone().map_err(failed)?;
    let port = port::attach(Path::new(port::CONTROLLER), &kernels)?;
    Ok((Link { number, socket, queued: QueuedTransfers::default(), port }, reader))
}

/// Reads the kernel's commands until the connection of this number ends; the end is reported as the last command.
fn listen(commands: Commands, mut reader: UnixStream, number: u64) {
    thread::spawn(move || {
        loop {
            let command = read_command(&mut reader);
            let ends = command.is_err();
            if commands.send((number, command)).is_err() || ends {
                break;
            }
        }
    });
}

/// Runs the camera. Commands are processed before data, as on the bus, so that a long queue of transfers does not delay
/// them.
fn work(shared: &Mutex<Shared>, commands: &Receiver<(u64, io::Result<Command>)>, ended: &AtomicBool) {
    let mut interval = Duration::ZERO;
    while !ended.load(Ordering::Relaxed) {
        interval = match commands.recv_timeout(interval) {
            Ok((number, command)) => {
                lock(shared).receive(number, command);
                Duration::ZERO
            }
            Err(_) => lock(shared).turn(),
        };
    }
}
