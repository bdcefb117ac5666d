//! The camera as its USB side sees it: registers, requests, endpoints.

use std::time::Duration;

use super::descriptors::{descriptor, descriptors};
use super::faults::Faults;
use super::output::{Output, Pace, Taken};
use super::piece::Piece;
use crate::capture::DATA_ENDPOINT;
use crate::dump::{DumpHeader, Identity};
use crate::registers::{
    REGISTERS_RECORD, REQUEST_REGISTER, REQUEST_REGISTERS, Register, RegisterSnapshot, aps, dvs, external_input, imu,
    mux, sysinfo, usb,
};
use crate::{PRODUCT_ID, VENDOR_ID};

/// The endpoint is halted, or the request is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall;

/// One emulated camera.
pub struct Model {
    identity: Identity,
    /// The registers with power just switched on.
    factory: RegisterSnapshot,
    registers: RegisterSnapshot,
    /// Register writes in the order in which they came.
    log: Vec<(Register, u32)>,
    output: Output,
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

impl Model {
    /// A camera with this serial number. Each time it is started it sends what `source` returns.
    pub fn new<I>(serial: &str, source: impl FnMut() -> I + Send + 'static) -> Self
    where
        I: Iterator<Item = Piece> + Send + 'static,
    {
        let identity =
            Identity { vendor_id: VENDOR_ID, product_id: PRODUCT_ID, device_version: 6, serial: serial.to_owned() };
        Self {
            identity,
            factory: default_registers(),
            registers: default_registers(),
            log: Vec::new(),
            output: Output::new(source),
            halted: false,
        }
    }

    /// Sets what its descriptors say.
    pub fn with_identity(mut self, identity: Identity) -> Self {
        self.identity = identity;
        self
    }

    /// Sets its serial number.
    pub fn with_serial(mut self, serial: &str) -> Self {
        serial.clone_into(&mut self.identity.serial);
        self
    }

    /// Sets registers, among them the read-only ones.
    pub fn with_registers(mut self, registers: impl IntoIterator<Item = (Register, u32)>) -> Self {
        for (register, value) in registers {
            self.factory.set(register, value);
            self.registers.set(register, value);
        }
        self
    }

    /// Makes it the camera of a recording, as far as that describes it: descriptors and read-only
    /// registers. Counters begin at zero.
    pub fn with_header(self, header: &DumpHeader) -> Self {
        let is_counter = |register: Register| matches!(register.module, 0 | 1) && register.parameter > 80;
        let kept = |register: Register| register.is_read_only() && !is_counter(register);
        let registers: Vec<_> = header.registers.iter().filter(|(register, _)| kept(*register)).collect();
        let model = self.with_registers(registers);
        match &header.identity {
            Some(identity) => model.with_identity(identity.clone()),
            None => model,
        }
    }

    /// Sets how fast it plays.
    pub fn with_pace(mut self, pace: Pace) -> Self {
        self.output.pace = pace;
        self
    }

    /// Sets how long after a start the stream begins.
    pub fn with_delay(mut self, delay: Duration) -> Self {
        self.output.delay = delay;
        self
    }

    /// Sets what goes wrong.
    pub fn with_faults(mut self, faults: Faults) -> Self {
        self.output.faults = faults;
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
        self.output.sent()
    }

    /// Switches the power off and on: registers are as they were at first.
    pub fn power_cycle(&mut self) {
        self.registers = self.factory.clone();
        self.output.clear();
        self.halted = false;
    }

    /// Whether it is time to unplug it; true once.
    pub(super) fn take_unplug(&mut self) -> bool {
        self.output.take_unplug()
    }

    /// Device and configuration descriptor, as sysfs shows them.
    pub(super) fn descriptors(&self) -> Vec<u8> {
        descriptors(&self.identity)
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
            _ => self.standard_request(request_type, request, value, index)?,
        };
        answer.truncate(usize::from(u16::from_le_bytes([l0, l1])));
        Ok(answer)
    }

    /// Requests that every USB device answers (USB 3.2, table 9-4).
    fn standard_request(&mut self, kind: u8, request: u8, value: u16, index: u16) -> Result<Vec<u8>, Stall> {
        const DEVICE: u8 = 0x00;
        const INTERFACE: u8 = 0x01;
        const ENDPOINT: u8 = 0x02;
        const IN: u8 = 0x80;
        const CLEAR_FEATURE: u8 = 1;
        const SET_FEATURE: u8 = 3;
        const ENDPOINT_HALT: u16 = 0;
        let data_endpoint = index == u16::from(DATA_ENDPOINT);
        match (kind ^ (kind & IN), kind & IN, request) {
            // Status of device and interface, of an endpoint.
            (DEVICE | INTERFACE, IN, 0) => Ok(vec![0, 0]),
            (ENDPOINT, IN, 0) => Ok(vec![u8::from(data_endpoint && self.halted), 0]),
            (ENDPOINT, 0, CLEAR_FEATURE | SET_FEATURE) if value == ENDPOINT_HALT => {
                if data_endpoint {
                    self.halted = request == SET_FEATURE;
                }
                Ok(Vec::new())
            }
            // Power saving of device and interface: nothing is saved here.
            (DEVICE | INTERFACE, 0, CLEAR_FEATURE | SET_FEATURE) => Ok(Vec::new()),
            (DEVICE, IN, 6) => {
                let [index, kind] = value.to_le_bytes();
                descriptor(&self.identity, kind, index)
            }
            // Configuration, alternate setting: there is one each.
            (DEVICE, IN, 8) => Ok(vec![1]),
            (DEVICE, 0, 9) | (INTERFACE, 0, 11) => Ok(Vec::new()),
            (INTERFACE, IN, 10) => Ok(vec![0]),
            // System exit latency, isochronous delay.
            (DEVICE, 0, 48 | 49) => Ok(Vec::new()),
            _ => Err(Stall),
        }
    }

    fn write(&mut self, register: Register, value: u32) {
        self.log.push((register, value));
        if register.is_read_only() {
            return;
        }
        let ran = self.runs();
        self.registers.set(register, value);
        match (ran, self.runs()) {
            (false, true) => self.output.start(),
            (true, false) => self.output.stop(),
            _ => {}
        }
    }

    /// Whether the way from pixels to bus is open.
    fn runs(&self) -> bool {
        let on = |register| self.registers.get(register).unwrap_or(0) != 0;
        let path = [mux::RUN_CHIP, mux::RUN, mux::TIMESTAMP_RUN, usb::RUN].into_iter().all(on);
        path && [dvs::RUN, aps::RUN].into_iter().any(on)
    }

    /// What a transfer from the data endpoint of at most `room` bytes brings now; `None` if there is
    /// nothing yet.
    pub fn bulk(&mut self, room: usize) -> Option<Result<Vec<u8>, Stall>> {
        if !self.halted {
            let clocks = self.registers.clocks();
            let cycles = self.registers.get(usb::EARLY_PACKET_DELAY).unwrap_or(0);
            let delay = Duration::from_secs_f64(clocks.microseconds(clocks.usb, cycles) / 1e6);
            match self.output.take(room, delay) {
                Taken::Nothing => return None,
                Taken::Bytes(bytes) => return Some(Ok(bytes)),
                Taken::Halt => self.halted = true,
            }
        }
        Some(Err(Stall))
    }

    /// After what time it wants its next turn.
    pub(super) fn turn_interval(&self) -> Duration {
        self.output.turn_interval()
    }

    /// To be called when it wants a turn.
    pub(super) fn turn(&mut self) {
        self.output.turn();
    }

    /// Lets time pass without a queued transfer. Each piece that found no room counts as one dropped
    /// event.
    pub(super) fn idle(&mut self) {
        let dropped = self.output.idle();
        if dropped > 0 {
            let dropped = self.registers.counter(mux::DVS_DROPPED).unwrap_or(0) + dropped;
            self.registers.set(mux::DVS_DROPPED, (dropped >> 32) as u32);
            self.registers.set(mux::DVS_DROPPED.next(), dropped as u32);
        }
    }

    /// Ends a halt of the data endpoint.
    pub fn clear_halt(&mut self) {
        self.halted = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLEAR_HALT: [u8; 8] = [0x02, 1, 0, 0, DATA_ENDPOINT, 0, 0, 0];

    fn none() -> Model {
        Model::new("00000001", std::iter::empty::<Piece>)
    }

    #[test]
    fn control_requests() {
        let mut model = none();
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
        model.power_cycle();
        assert_eq!(model.registers(), &default_registers());
    }

    #[test]
    fn a_halt_lasts_until_it_is_cleared_by_request() {
        let pieces = [Piece { time: 0, bytes: vec![1; 100] }];
        let faults = Faults { stall_at: Some(60), ..Faults::default() };
        let mut model = Model::new("1", move || pieces.clone().into_iter()).with_faults(faults);
        for register in [mux::RUN_CHIP, usb::RUN, mux::TIMESTAMP_RUN, mux::RUN, dvs::RUN] {
            assert_eq!(model.bulk(64), None);
            model.write(register, 1);
        }
        let status = |model: &mut Model| model.control([0x82, 0, 0, 0, DATA_ENDPOINT, 0, 2, 0], &[]);
        assert_eq!((model.bulk(64), status(&mut model)), (Some(Ok(vec![1; 60])), Ok(vec![0, 0])));
        assert_eq!((model.bulk(64), status(&mut model)), (Some(Err(Stall)), Ok(vec![1, 0])));
        assert_eq!(model.bulk(64), Some(Err(Stall)));
        assert_eq!(model.control(CLEAR_HALT, &[]), Ok(vec![]));
        assert_eq!((model.bulk(64), status(&mut model)), (Some(Ok(vec![1; 40])), Ok(vec![0, 0])));
    }

    #[test]
    fn a_piece_without_room_counts_as_a_dropped_event() {
        let pieces: Vec<_> = (0..100).map(|_| Piece { time: 0, bytes: vec![0; 1000] }).collect();
        let mut model = Model::new("1", move || pieces.clone().into_iter()).with_pace(Pace::Real);
        for register in [mux::RUN_CHIP, usb::RUN, mux::TIMESTAMP_RUN, mux::RUN, dvs::RUN] {
            model.write(register, 1);
        }
        model.idle();
        assert_eq!(model.registers().counter(mux::DVS_DROPPED), Some(35));
    }

    #[test]
    fn a_recording_describes_its_camera() {
        let identity = Identity { serial: "00000007".to_owned(), ..none().identity().clone() };
        let registers = [(sysinfo::LOGIC_PATCH, 2), (mux::RUN, 1), (mux::DVS_DROPPED.next(), 5), (dvs::DROPPED, 6)];
        let header = DumpHeader::new(Some(identity.clone()), registers.into_iter().collect());
        let model = none().with_header(&header);
        assert_eq!(model.identity(), &identity);
        let mut expected = default_registers();
        expected.set(sysinfo::LOGIC_PATCH, 2);
        assert_eq!(model.registers(), &expected);
    }
}
