//! The camera as its USB side sees it.

use std::collections::VecDeque;
use std::io::{Read, Seek};
use std::time::{Duration, Instant};

use crate::capture::{Capture, CaptureError};
use crate::dump::Identity;
use crate::registers::{
    REGISTERS_RECORD, REQUEST_REGISTER, REQUEST_REGISTERS, Register, RegisterSnapshot, aps, dvs, external_input, imu,
    mux, sysinfo, usb,
};
use crate::{PRODUCT_ID, VENDOR_ID};

/// A part of the stream and when the camera produces it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Time since the start in µs.
    pub time: u64,
    /// Bytes of the stream.
    pub bytes: Vec<u8>,
}

/// How fast the stream is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// As fast as the client reads; nothing is ever dropped.
    #[default]
    Full,
    /// By the pieces' times. What does not fit into the FIFO, because no transfer is queued, is
    /// dropped and counted by register 0.83, as the camera does.
    Real,
}

/// What goes wrong. Bytes count from the start of the stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// The camera is unplugged once this many bytes were sent.
    pub unplug_at: Option<u64>,
    /// The data endpoint halts once this many bytes were sent.
    pub stall_at: Option<u64>,
    /// Lengths of the transfers, over and over, odd ones included; none: as long as asked for.
    pub cuts: Vec<usize>,
    /// Another program has the camera.
    pub busy: bool,
}

/// The endpoint is halted, or the request is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall;

/// Longest time between two turns that passes for the camera too.
const TURN_MOST: Duration = Duration::from_millis(5);
/// Room of the camera's output.
const FIFO_BYTES: usize = 64 * 1024;

/// One emulated camera.
pub struct Model {
    identity: Identity,
    registers: RegisterSnapshot,
    /// Register writes in the order in which they came.
    log: Vec<(Register, u32)>,
    source: Box<dyn FnMut() -> Box<dyn Iterator<Item = Piece> + Send> + Send>,
    pieces: Box<dyn Iterator<Item = Piece> + Send>,
    /// A piece whose time has not come.
    next: Option<Piece>,
    fifo: VecDeque<u8>,
    pace: Pace,
    delay: Duration,
    faults: Faults,
    started: Option<Instant>,
    /// When it was last given the processor, and for how long it was kept from it.
    turned: Option<Instant>,
    asleep: Duration,
    sent_last: Option<Instant>,
    sent: u64,
    cut: usize,
    halted: bool,
}

/// Registers of a DAVIS346 as far as they say something before it is configured.
pub fn default_registers() -> RegisterSnapshot {
    RegisterSnapshot::from_iter([
        (sysinfo::LOGIC_VERSION, 18),
        (sysinfo::CHIP_ID, 5),
        (sysinfo::DEVICE_IS_MASTER, 1),
        (sysinfo::LOGIC_CLOCK, 100),
        (sysinfo::ADC_CLOCK, 30),
        (sysinfo::USB_CLOCK, 80),
        (sysinfo::CLOCK_DEVIATION, 1008),
        (sysinfo::LOGIC_PATCH, 1),
        (dvs::SIZE_COLUMNS, 260),
        (dvs::SIZE_ROWS, 346),
        (dvs::ORIENTATION, 0b100),
        (dvs::HAS_PIXEL_FILTER, 1),
        (dvs::HAS_BACKGROUND_ACTIVITY_FILTER, 1),
        (dvs::HAS_REGION_OF_INTEREST, 1),
        (dvs::HAS_SKIP_EVENTS, 1),
        (dvs::HAS_POLARITY_FILTER, 1),
        (dvs::HAS_STATISTICS, 1),
        (aps::SIZE_COLUMNS, 260),
        (aps::SIZE_ROWS, 346),
        (aps::ORIENTATION, 0b100),
        (aps::COLOR_FILTER, 0),
        (aps::HAS_GLOBAL_SHUTTER, 1),
        (imu::TYPE, 2),
        (imu::ORIENTATION, 0),
        (external_input::HAS_GENERATOR, 1),
        (mux::HAS_STATISTICS, 1),
    ])
}

/// The transfers of a recording as pieces of a stream.
pub fn pieces_of_capture<R: Read + Seek>(capture: &mut Capture<R>) -> Result<Vec<Piece>, CaptureError> {
    let mut pieces = Vec::new();
    while let Some(transfer) = capture.next_transfer()? {
        let time = transfer.host_ns.unwrap_or(0) / 1000;
        pieces.push(Piece { time, bytes: transfer.payload.to_vec() });
    }
    Ok(pieces)
}

impl Model {
    /// A camera with this serial number. Each time it is started it sends what `source` returns.
    pub fn new<I>(serial: &str, mut source: impl FnMut() -> I + Send + 'static) -> Self
    where
        I: Iterator<Item = Piece> + Send + 'static,
    {
        let identity =
            Identity { vendor_id: VENDOR_ID, product_id: PRODUCT_ID, device_version: 6, serial: serial.to_owned() };
        Self {
            identity,
            registers: default_registers(),
            log: Vec::new(),
            source: Box::new(move || Box::new(source())),
            pieces: Box::new(std::iter::empty()),
            next: None,
            fifo: VecDeque::new(),
            pace: Pace::default(),
            delay: Duration::ZERO,
            faults: Faults::default(),
            started: None,
            turned: None,
            asleep: Duration::ZERO,
            sent_last: None,
            sent: 0,
            cut: 0,
            halted: false,
        }
    }

    /// Sets what its descriptors say.
    pub fn with_identity(mut self, identity: Identity) -> Self {
        self.identity = identity;
        self
    }

    /// Sets registers, among them the read-only ones.
    pub fn with_registers(mut self, registers: impl IntoIterator<Item = (Register, u32)>) -> Self {
        registers.into_iter().for_each(|(register, value)| self.registers.set(register, value));
        self
    }

    /// Sets how fast it plays.
    pub fn with_pace(mut self, pace: Pace) -> Self {
        self.pace = pace;
        self
    }

    /// Sets how long after a start the stream begins.
    pub fn with_delay(mut self, delay: Duration) -> Self {
        self.delay = delay;
        self
    }

    /// Sets what goes wrong.
    pub fn with_faults(mut self, faults: Faults) -> Self {
        self.faults = faults;
        self
    }

    /// What its descriptors say.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Its registers.
    pub fn registers(&self) -> &RegisterSnapshot {
        &self.registers
    }

    /// All register writes so far, in order.
    pub fn log(&self) -> &[(Register, u32)] {
        &self.log
    }

    /// Bytes sent since the latest start.
    pub fn sent(&self) -> u64 {
        self.sent
    }

    pub(super) fn faults(&self) -> &Faults {
        &self.faults
    }

    pub(super) fn is_to_be_unplugged(&self) -> bool {
        self.faults.unplug_at.is_some_and(|at| self.sent >= at)
    }

    /// Answers a control request: what it returns are the bytes of a read, none for a write.
    pub fn control(&mut self, setup: [u8; 8], data: &[u8]) -> Result<Vec<u8>, Stall> {
        let [request_type, request, v0, v1, i0, i1, l0, l1] = setup;
        let (value, index) = (u16::from_le_bytes([v0, v1]), u16::from_le_bytes([i0, i1]));
        let register = Register::new(v0, i0);
        let mut answer = match (request_type, request) {
            (0xC0, REQUEST_REGISTER) => self.registers.get(register).unwrap_or(0).to_be_bytes().to_vec(),
            (0x40, REQUEST_REGISTER) => {
                let bytes = data.first_chunk::<4>().ok_or(Stall)?;
                self.write(register, u32::from_be_bytes(*bytes));
                Vec::new()
            }
            (0x40, REQUEST_REGISTERS) => {
                let (records, rest) = data.as_chunks::<REGISTERS_RECORD>();
                if records.len() != usize::from(value) || !rest.is_empty() {
                    return Err(Stall);
                }
                for &[module, parameter, b0, b1, b2, b3] in records {
                    self.write(Register::new(module, parameter), u32::from_be_bytes([b0, b1, b2, b3]));
                }
                Vec::new()
            }
            (0x80, 6) => self.descriptor(v1, v0, index)?,
            (0x80, 8) => vec![1],
            (0x80, 0) => vec![0, 0],
            (0x00, 9) | (0x01, 11) => Vec::new(),
            _ => return Err(Stall),
        };
        answer.truncate(usize::from(u16::from_le_bytes([l0, l1])));
        Ok(answer)
    }

    fn write(&mut self, register: Register, value: u32) {
        self.log.push((register, value));
        if register.is_read_only() {
            return;
        }
        let ran = self.runs();
        self.registers.set(register, value);
        if self.runs() && !ran {
            self.pieces = (self.source)();
            (self.next, self.started, self.sent, self.cut) = (None, Some(Instant::now()), 0, 0);
            self.asleep = Duration::ZERO;
            self.fifo.clear();
        }
    }

    /// Whether the way from pixels to bus is open.
    fn runs(&self) -> bool {
        let on = |register| self.registers.get(register).unwrap_or(0) != 0;
        let path = [mux::RUN_CHIP, mux::RUN, mux::TIMESTAMP_RUN, usb::RUN].into_iter().all(on);
        path && [dvs::RUN, aps::RUN].into_iter().any(on)
    }

    fn descriptor(&self, kind: u8, index: u8, _language: u16) -> Result<Vec<u8>, Stall> {
        match (kind, index) {
            (1, 0) => Ok(self.device_descriptor().to_vec()),
            (2, 0) => Ok(CONFIGURATION_DESCRIPTOR.to_vec()),
            (3, 0) => Ok(vec![4, 3, 0x09, 0x04]),
            (3, 1) => Ok(string_descriptor("INI")),
            (3, 2) => Ok(string_descriptor("DAViS FX3")),
            (3, 3) => Ok(string_descriptor(&self.identity.serial)),
            _ => Err(Stall),
        }
    }

    pub(super) fn device_descriptor(&self) -> [u8; 18] {
        let [v0, v1] = self.identity.vendor_id.to_le_bytes();
        let [p0, p1] = self.identity.product_id.to_le_bytes();
        let [d0, d1] = self.identity.device_version.to_le_bytes();
        [18, 1, 0x00, 0x03, 0, 0, 0, 9, v0, v1, p0, p1, d0, d1, 1, 2, 3, 1]
    }

    /// Device and configuration descriptor, as sysfs shows them.
    pub(super) fn descriptors(&self) -> Vec<u8> {
        [&self.device_descriptor()[..], CONFIGURATION_DESCRIPTOR].concat()
    }

    /// What a transfer from the data endpoint of at most `room` bytes brings now; `None` if there is
    /// nothing yet.
    pub fn bulk(&mut self, room: usize) -> Option<Result<Vec<u8>, Stall>> {
        if self.halted {
            return Some(Err(Stall));
        }
        let room = self.limit(room)?;
        self.fill(room);
        let take = self.fifo.len().min(room);
        if take == 0 || (take < room && self.waits()) {
            return None;
        }
        self.sent_last = Some(Instant::now());
        if !self.faults.cuts.is_empty() {
            self.cut += 1;
        }
        self.sent += take as u64;
        Some(Ok(self.fifo.drain(..take).collect()))
    }

    /// Whether a transfer that is not full must wait still: register 9.1.
    fn waits(&self) -> bool {
        let clocks = self.registers.clocks();
        let cycles = self.registers.get(usb::EARLY_PACKET_DELAY).unwrap_or(0);
        let delay = Duration::from_secs_f64(clocks.microseconds(clocks.usb, cycles) / 1e6);
        self.pace == Pace::Real && self.sent_last.is_some_and(|last| last.elapsed() < delay)
    }

    /// `room` cut to the next fault; `None` if that is now.
    fn limit(&mut self, room: usize) -> Option<usize> {
        let left = |at: Option<u64>| at.map_or(u64::MAX, |at| at.saturating_sub(self.sent));
        if left(self.faults.stall_at) == 0 {
            self.faults.stall_at = None;
            self.halted = true;
            return None;
        }
        let cuts = &self.faults.cuts;
        let cut = cuts.get(self.cut % cuts.len().max(1)).copied().unwrap_or(room).max(1);
        let left = left(self.faults.stall_at).min(left(self.faults.unplug_at));
        Some(room.min(cut).min(usize::try_from(left).unwrap_or(usize::MAX)))
    }

    /// To be called every few milliseconds. Where the computer was too busy for that, the camera's
    /// time stood still: a real camera would not have sent everything at once afterwards.
    pub(super) fn turn(&mut self) {
        let now = Instant::now();
        let gap = self.turned.replace(now).map_or(Duration::ZERO, |turned| now - turned);
        self.asleep += gap.saturating_sub(TURN_MOST);
    }

    /// The next piece, if its time has come.
    fn due(&mut self) -> Option<Piece> {
        if !self.runs() {
            return None;
        }
        let elapsed = self.started.map_or(Duration::ZERO, |started| started.elapsed()).saturating_sub(self.asleep);
        let elapsed = elapsed.checked_sub(self.delay)?;
        let piece = self.next.take().or_else(|| self.pieces.next())?;
        if self.pace == Pace::Real && Duration::from_micros(piece.time) > elapsed {
            self.next = Some(piece);
            return None;
        }
        Some(piece)
    }

    fn fill(&mut self, room: usize) {
        while self.fifo.len() < room {
            let Some(piece) = self.due() else { return };
            self.fifo.extend(piece.bytes);
        }
    }

    /// Counts a piece as one dropped event.
    fn drop_piece(&mut self) {
        let dropped = self.registers.counter(mux::DVS_DROPPED).unwrap_or(0) + 1;
        self.registers.set(mux::DVS_DROPPED, (dropped >> 32) as u32);
        self.registers.set(mux::DVS_DROPPED.next(), dropped as u32);
    }

    /// Lets time pass without a queued transfer.
    pub(super) fn idle(&mut self) {
        while self.pace == Pace::Real {
            let Some(piece) = self.due() else { return };
            if self.fifo.len() + piece.bytes.len() > FIFO_BYTES {
                self.drop_piece();
            } else {
                self.fifo.extend(piece.bytes);
            }
        }
    }

    /// Ends a halt of the data endpoint.
    pub fn clear_halt(&mut self) {
        self.halted = false;
    }
}

/// One interface, bulk endpoint 0x82, interrupt endpoint 0x81, each with its companion (USB 3).
const CONFIGURATION_DESCRIPTOR: &[u8] = &[
    9, 2, 44, 0, 1, 1, 0, 0x80, 100, //
    9, 4, 0, 0, 2, 0xFF, 0, 0, 0, //
    7, 5, 0x82, 2, 0x00, 0x04, 0, 6, 0x30, 15, 0, 0, 0, //
    7, 5, 0x81, 3, 0x40, 0x00, 1, 6, 0x30, 0, 0, 0x40, 0,
];

fn string_descriptor(text: &str) -> Vec<u8> {
    let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).take(252).collect();
    let mut descriptor = vec![(units.len() + 2) as u8, 3];
    descriptor.extend(units);
    descriptor
}

#[cfg(test)]
mod tests {
    use super::*;

    fn running(pieces: Vec<Piece>) -> Model {
        let mut model = Model::new("1", move || pieces.clone().into_iter());
        for register in [mux::RUN_CHIP, usb::RUN, mux::TIMESTAMP_RUN, mux::RUN, dvs::RUN] {
            model.write(register, 1);
        }
        model
    }

    #[test]
    fn control_requests() {
        let mut model = Model::new("00000001", std::iter::empty::<Piece>);
        assert_eq!(model.control([0xC0, 0xBF, 6, 0, 0, 0, 4, 0], &[]), Ok(vec![0, 0, 0, 18]));
        assert_eq!(model.control([0x40, 0xBF, 5, 0, 10, 0, 4, 0], &[0, 0, 0x42, 0x7F]), Ok(vec![]));
        assert_eq!(model.registers().get(Register::new(5, 10)), Some(0x427F));
        let two = [0, 2, 0, 0, 0, 1, 0, 2, 0, 0, 0, 0];
        assert_eq!(model.control([0x40, 0xC2, 2, 0, 0, 0, 12, 0], &two), Ok(vec![]));
        assert_eq!(model.log()[1..], [(mux::TIMESTAMP_RESET, 1), (mux::TIMESTAMP_RESET, 0)]);
        // Sizes cannot be written.
        assert_eq!(model.control([0x40, 0xBF, 1, 0, 0, 0, 4, 0], &[0; 4]), Ok(vec![]));
        assert_eq!(model.registers().get(dvs::SIZE_COLUMNS), Some(260));
        assert_eq!(model.control([0x80, 6, 0, 1, 0, 0, 8, 0], &[]).map(|answer| answer.len()), Ok(8));
        assert_eq!(model.control([0x40, 0xB9, 0, 0, 0, 0, 0, 0], &[]), Err(Stall));
        assert_eq!(usize::from(CONFIGURATION_DESCRIPTOR[2]), CONFIGURATION_DESCRIPTOR.len());
    }

    #[test]
    fn faults_come_at_their_byte() {
        let pieces = vec![Piece { time: 0, bytes: (0..100).collect() }];
        let mut model = running(pieces.clone());
        model.faults = Faults { cuts: vec![7, 3], stall_at: Some(12), unplug_at: Some(20), busy: false };
        let lengths: Vec<_> = (0..3).map(|_| model.bulk(64).map(|sent| sent.map(|bytes| bytes.len()))).collect();
        assert_eq!(lengths, [Some(Ok(7)), Some(Ok(3)), Some(Ok(2))]);
        assert_eq!(model.bulk(64), None);
        assert_eq!(model.bulk(64), Some(Err(Stall)));
        model.clear_halt();
        assert_eq!(model.bulk(64), Some(Ok(vec![12, 13, 14])));
        assert!(!model.is_to_be_unplugged());
        while !model.is_to_be_unplugged() {
            assert!(model.bulk(64).is_some());
        }
        assert_eq!(model.sent(), 20);
    }

    #[test]
    fn what_no_transfer_takes_is_dropped_and_counted_at_real_pace() {
        let pieces = (0..100).map(|_| Piece { time: 0, bytes: vec![0; 1000] }).collect();
        let mut model = running(pieces).with_pace(Pace::Real);
        model.idle();
        assert_eq!(model.registers().counter(mux::DVS_DROPPED), Some(35));
        assert_eq!(model.bulk(1 << 20).expect("65 of 100 fit").map(|bytes| bytes.len()), Ok(65_000));
    }
}
