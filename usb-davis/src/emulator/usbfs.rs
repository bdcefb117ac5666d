//! Implementation of an open device node of the Linux USB file system: ioctls in, completions out.
//!
//! It is independent of the transport of the ioctls; [`Memory`] is the client's memory.

use std::collections::VecDeque;
use std::io;

use super::model::Model;
use super::transfers::QueuedTransfers;
use crate::capture::DATA_ENDPOINT;

pub(super) const EAGAIN: i32 = 11;
pub(super) const EBUSY: i32 = 16;
pub(super) const ENODEV: i32 = 19;
const EINVAL: i32 = 22;
const ENOTTY: i32 = 25;
const ENOENT: i32 = 2;
const EPIPE: i32 = 32;
const ENODATA: i32 = 61;
const ESHUTDOWN: i32 = 108;

/// Numbers of <linux/usbdevice_fs.h> on 64-bit machines.
const SUBMIT: u32 = 0x8038_550A;
const DISCARD: u32 = 0x550B;
const REAP: u32 = 0x4008_550C;
const REAP_NOW: u32 = 0x4008_550D;
const CLAIM: u32 = 0x8004_550F;
const RELEASE: u32 = 0x8004_5510;
const SET_INTERFACE: u32 = 0x8008_5504;
const SET_CONFIGURATION: u32 = 0x8004_5505;
const GET_DRIVER: u32 = 0x4104_5508;
const DRIVER_IOCTL: u32 = 0xC010_5512;
const RESET: u32 = 0x5514;
const CLEAR_HALT: u32 = 0x8004_5515;
const GET_CAPABILITIES: u32 = 0x8004_551A;
const DISCONNECT_CLAIM: u32 = 0x8108_551B;
const GET_SPEED: u32 = 0x551F;
/// Zero packets, continuation, no packet size limit, scatter-gather, reap after disconnect.
const CAPABILITIES: u32 = 0x1F;
const SPEED_SUPER: u64 = 5;

/// Request block: type u8, endpoint u8, status i32 @4, flags u32 @8, buffer @16, length i32 @24,
/// actual length i32 @28.
const URB: usize = 56;
const TYPE_CONTROL: u8 = 2;
const TYPE_BULK: u8 = 3;

/// The memory of the client that sent the ioctl.
pub(super) trait Memory {
    /// Reads bytes at `address`.
    fn read(&mut self, address: u64, bytes: &mut [u8]) -> io::Result<()>;
    /// Writes bytes at `address`.
    fn write(&mut self, address: u64, bytes: &[u8]) -> io::Result<()>;
}

/// A request block and its buffer, both as addresses in the client.
struct Urb {
    address: u64,
    buffer: u64,
}

struct Done {
    urb: u64,
    status: i32,
    /// Destination of the data.
    buffer: u64,
    data: Vec<u8>,
    actual: usize,
}

/// One open device node.
#[derive(Default)]
pub(super) struct OpenNode {
    pending: QueuedTransfers<Urb>,
    done: VecDeque<Done>,
    pub(super) claimed: bool,
    /// `true` once the camera of the node was unplugged.
    pub(super) gone: bool,
}

fn number<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut number = [0; N];
    number.iter_mut().zip(bytes.iter().skip(at)).for_each(|(to, from)| *to = *from);
    number
}

impl Urb {
    fn done(self, status: i32, data: Vec<u8>) -> Done {
        let actual = data.len();
        Done { urb: self.address, status, buffer: self.buffer, data, actual }
    }
}

impl OpenNode {
    /// Returns `true` if something can be reaped.
    pub(super) fn is_ready(&self) -> bool {
        !self.done.is_empty()
    }

    /// Completes the transfers for which the camera has data.
    pub(super) fn pump(&mut self, model: &mut Model) {
        model.turn();
        while let Some((urb, data)) = self.pending.next(model) {
            self.done.push_back(match data {
                Ok(data) => urb.done(0, data),
                Err(fault) => urb.done(-fault.errno(), Vec::new()),
            });
        }
    }

    /// Ends everything that is pending, as unplugging does.
    pub(super) fn shut_down(&mut self) {
        self.gone = true;
        self.done.extend(self.pending.drain().map(|urb| urb.done(-ESHUTDOWN, Vec::new())));
    }

    /// Answers an ioctl: returns its result, or an error number. `claimed_elsewhere` is `true` if another program uses
    /// the interface.
    pub(super) fn ioctl(
        &mut self,
        request: u32,
        argument: u64,
        model: &mut Model,
        claimed_elsewhere: bool,
        memory: &mut impl Memory,
    ) -> io::Result<Result<u64, i32>> {
        if request == REAP || request == REAP_NOW {
            let nothing = if self.gone { ENODEV } else { EAGAIN };
            let Some(done) = self.done.pop_front() else { return Ok(Err(nothing)) };
            if !done.data.is_empty() {
                memory.write(done.buffer, &done.data)?;
            }
            memory.write(done.urb + 4, &done.status.to_ne_bytes())?;
            memory.write(done.urb + 28, &(done.actual as u32).to_ne_bytes())?;
            memory.write(argument, &done.urb.to_ne_bytes())?;
            return Ok(Ok(0));
        }
        if request == DISCARD {
            let Some(urb) = self.pending.remove(|urb| urb.address == argument) else {
                return Ok(Err(EINVAL));
            };
            self.done.push_back(urb.done(-ENOENT, Vec::new()));
            return Ok(Ok(0));
        }
        if self.gone {
            return Ok(Err(ENODEV));
        }
        Ok(match request {
            SUBMIT => self.submit(argument, model, memory)?,
            CLAIM | DISCONNECT_CLAIM if claimed_elsewhere => Err(EBUSY),
            CLAIM | DISCONNECT_CLAIM => {
                self.claimed = true;
                Ok(0)
            }
            RELEASE => {
                self.claimed = false;
                Ok(0)
            }
            SET_INTERFACE | SET_CONFIGURATION | RESET => Ok(0),
            CLEAR_HALT => {
                model.clear_halt();
                Ok(0)
            }
            GET_CAPABILITIES => {
                memory.write(argument, &CAPABILITIES.to_ne_bytes())?;
                Ok(0)
            }
            GET_SPEED => Ok(SPEED_SUPER),
            GET_DRIVER | DRIVER_IOCTL => Err(ENODATA),
            _ => Err(ENOTTY),
        })
    }

    fn submit(&mut self, address: u64, model: &mut Model, memory: &mut impl Memory) -> io::Result<Result<u64, i32>> {
        let mut block = [0; URB];
        memory.read(address, &mut block)?;
        let [kind, endpoint, ..] = block;
        let buffer = u64::from_ne_bytes(number(&block, 16));
        let length = usize::try_from(i32::from_ne_bytes(number(&block, 24))).unwrap_or(0);
        if kind != TYPE_CONTROL {
            if kind == TYPE_BULK && endpoint != DATA_ENDPOINT {
                return Ok(Err(ENOENT));
            }
            self.pending.push(Urb { address, buffer }, endpoint, length);
            self.pump(model);
            return Ok(Ok(0));
        }
        let mut request = vec![0; length];
        memory.read(buffer, &mut request)?;
        let Some((setup, data)) = request.split_first_chunk::<8>() else { return Ok(Err(EINVAL)) };
        let wanted = usize::from(u16::from_le_bytes(number(setup, 6)));
        let (status, data, actual) = match model.control(*setup, data.get(..wanted).unwrap_or(data)) {
            Ok(answer) if setup.first().is_some_and(|kind| kind & 0x80 != 0) => (0, answer.clone(), answer.len()),
            Ok(_) => (0, Vec::new(), wanted),
            Err(_) => (-EPIPE, Vec::new(), 0),
        };
        self.done.push_back(Done { urb: address, status, buffer: buffer + 8, data, actual });
        Ok(Ok(0))
    }
}
