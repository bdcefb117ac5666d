//! The USB side of the camera: registers, requests, endpoints.

use std::time::Duration;

use super::descriptors::descriptors;
use super::faults::Faults;
use super::output::{Output, Pace, Taken};
use super::piece::Piece;
use super::requests::standard_request;
use super::stall::{Stall, TransferFault};
use crate::configuration::Streams;
use crate::dump::{DumpHeader, Identity};
use crate::registers::{
    REGISTERS_RECORD, REQUEST_REGISTER, REQUEST_REGISTERS, Register, RegisterSnapshot, aps, default_registers, dvs,
    external_input, imu, mux, usb,
};
use crate::{PRODUCT_ID, VENDOR_ID};

/// One emulated camera.
pub struct Model {
    identity: Identity,
    /// The registers after power-on.
    factory: RegisterSnapshot,
    registers: RegisterSnapshot,
    /// Register writes in the order of arrival.
    log: Vec<(Register, u32)>,
    output: Output,
    halted: bool,
}

impl Model {
    /// Creates a camera with this serial number. At each start it sends the pieces that `source` returns.
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

    /// Sets the identity in the descriptors.
    pub fn with_identity(mut self, identity: Identity) -> Self {
        self.identity = identity;
        self
    }

    /// Sets the serial number.
    pub fn with_serial(mut self, serial: &str) -> Self {
        serial.clone_into(&mut self.identity.serial);
        self
    }

    /// Sets registers, including read-only ones.
    pub fn with_registers(mut self, registers: impl IntoIterator<Item = (Register, u32)>) -> Self {
        for (register, value) in registers {
            self.factory.set(register, value);
            self.registers.set(register, value);
        }
        self
    }

    /// Takes over descriptors and read-only registers of the camera of a recording, as far as the header contains them.
    /// Counters begin at zero.
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

    /// Sets the playback speed.
    pub fn with_pace(mut self, pace: Pace) -> Self {
        self.output.pace = pace;
        self
    }

    /// Sets the delay between a start and the beginning of the stream.
    pub fn with_delay(mut self, delay: Duration) -> Self {
        self.output.delay = delay;
        self
    }

    /// Sets the faults.
    pub fn with_faults(mut self, faults: Faults) -> Self {
        self.output.faults = faults;
        self
    }

    /// Returns the identity in the descriptors.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Returns the registers.
    pub fn registers(&self) -> &RegisterSnapshot {
        &self.registers
    }

    /// Returns all register writes so far, in order.
    pub fn log(&self) -> &[(Register, u32)] {
        &self.log
    }

    /// Returns the number of bytes sent since the latest start.
    pub fn sent(&self) -> u64 {
        self.output.sent()
    }

    /// Switches the power off and on, which resets the registers.
    pub fn power_cycle(&mut self) {
        self.registers = self.factory.clone();
        self.output.clear();
        self.halted = false;
    }

    /// Returns `true` once, when it is time to unplug the camera.
    pub(super) fn take_unplug(&mut self) -> bool {
        self.output.take_unplug()
    }

    /// Returns device and configuration descriptor, as in sysfs.
    pub(super) fn descriptors(&self) -> Vec<u8> {
        descriptors(&self.identity)
    }

    /// Answers a control request: returns the bytes of a read, or no bytes for a write.
    pub fn control(&mut self, setup: [u8; 8], data: &[u8]) -> Result<Vec<u8>, Stall> {
        let [request_type, request, v0, v1, i0, _, l0, l1] = setup;
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
                if records.len() != usize::from(u16::from_le_bytes([v0, v1])) || !rest.is_empty() {
                    return Err(Stall);
                }
                for &[module, parameter, b0, b1, b2, b3] in records {
                    self.write(Register::new(module, parameter), u32::from_be_bytes([b0, b1, b2, b3]));
                }
                Vec::new()
            }
            _ => standard_request(&self.identity, &mut self.halted, setup)?,
        };
        answer.truncate(usize::from(u16::from_le_bytes([l0, l1])));
        Ok(answer)
    }

    fn write(&mut self, register: Register, value: u32) {
        self.log.push((register, value));
        if register.is_read_only() {
            return;
        }
        let rises = value != 0 && !self.is_on(register);
        self.registers.set(register, value);
        self.output.switch(self.streams());
        if register == mux::TIMESTAMP_RESET && rises {
            self.output.restart_time();
        }
    }

    fn is_on(&self, register: Register) -> bool {
        self.registers.get(register).unwrap_or(0) != 0
    }

    /// Returns the running streams, if any module runs and the path from it to the bus is open.
    fn streams(&self) -> Option<Streams> {
        let any = |registers: &[Register]| registers.iter().any(|&register| self.is_on(register));
        let streams = Streams {
            events: self.is_on(dvs::RUN),
            frames: self.is_on(aps::RUN),
            imu: any(&[imu::RUN_ACCELEROMETER, imu::RUN_GYROSCOPE, imu::RUN_TEMPERATURE]),
            signals: any(&[external_input::RUN_DETECTOR, external_input::RUN_GENERATOR]),
        };
        let path = [mux::RUN_CHIP, mux::RUN, mux::TIMESTAMP_RUN, usb::RUN].into_iter().all(|on| self.is_on(on));
        (path && (streams.events || streams.frames || streams.imu || streams.signals)).then_some(streams)
    }

    /// Returns the result of a transfer of at most `room` bytes from the data endpoint; `None` if there is no data yet.
    pub fn bulk(&mut self, room: usize) -> Option<Result<Vec<u8>, TransferFault>> {
        if !self.halted {
            let clocks = self.registers.clocks();
            let cycles = self.registers.get(usb::EARLY_PACKET_DELAY).unwrap_or(0);
            let delay = Duration::from_secs_f64(clocks.microseconds(clocks.usb, cycles) / 1e6);
            match self.output.take(room, delay) {
                Taken::Nothing => return None,
                Taken::Bytes(bytes) => return Some(Ok(bytes)),
                Taken::Failure => return Some(Err(TransferFault::Bus)),
                Taken::Halt => self.halted = true,
            }
        }
        Some(Err(TransferFault::Stall))
    }

    /// Returns the time until the next call of [`Model::turn`].
    pub(super) fn turn_interval(&self) -> Duration {
        self.output.turn_interval()
    }

    /// Advances the camera; call it at the interval of [`Model::turn_interval`].
    pub(super) fn turn(&mut self) {
        self.output.turn();
    }

    /// Advances the time without a queued transfer. Counts the data for which there was no room.
    pub(super) fn idle(&mut self) {
        let (events, signals) = (self.is_on(mux::DROP_DVS_ON_STALL), self.is_on(mux::DROP_EXTERNAL_INPUT_ON_STALL));
        let drops = self.output.idle(events, signals);
        for (counter, dropped) in [(mux::DVS_DROPPED, drops.events), (mux::EXTERNAL_INPUT_DROPPED, drops.signals)] {
            if dropped > 0 {
                let dropped = self.registers.counter(counter).unwrap_or(0) + dropped;
                self.registers.set(counter, (dropped >> 32) as u32);
                self.registers.set(counter.next(), dropped as u32);
            }
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
    use crate::capture::DATA_ENDPOINT;
    use crate::registers::sysinfo;

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
        for register in PATH.into_iter().chain([dvs::RUN]) {
            assert_eq!(model.bulk(64), None);
            model.write(register, 1);
        }
        let status = |model: &mut Model| model.control([0x82, 0, 0, 0, DATA_ENDPOINT, 0, 2, 0], &[]);
        assert_eq!((model.bulk(64), status(&mut model)), (Some(Ok(vec![1; 60])), Ok(vec![0, 0])));
        assert_eq!((model.bulk(64), status(&mut model)), (Some(Err(TransferFault::Stall)), Ok(vec![1, 0])));
        assert_eq!(model.bulk(64), Some(Err(TransferFault::Stall)));
        assert_eq!(model.control(CLEAR_HALT, &[]), Ok(vec![]));
        assert_eq!((model.bulk(64), status(&mut model)), (Some(Ok(vec![1; 40])), Ok(vec![0, 0])));
    }

    /// The register writes that start everything except the modules.
    const PATH: [Register; 4] = [mux::RUN_CHIP, usb::RUN, mux::TIMESTAMP_RUN, mux::RUN];

    #[test]
    fn dropped_events_are_counted_as_events() {
        // Row 0, then 499 columns.
        let bytes: Vec<u8> = [0x00, 0x10].into_iter().chain([0x00, 0x20].repeat(499)).collect();
        let pieces = vec![Piece { time: 0, bytes }; 100];
        let mut model = Model::new("1", move || pieces.clone().into_iter()).with_pace(Pace::Real);
        for register in PATH.into_iter().chain([mux::DROP_DVS_ON_STALL, dvs::RUN]) {
            model.write(register, 1);
        }
        model.idle();
        let Some(Ok(bytes)) = model.bulk(1 << 20) else { panic!("nothing") };
        let columns = bytes.as_chunks::<2>().0.iter().filter(|word| word[1] == 0x20).count() as u64;
        assert_eq!(model.registers().counter(mux::DVS_DROPPED), Some(100 * 499 - columns));
        assert!(columns > 30_000);
    }

    #[test]
    fn a_pulse_of_the_reset_register_puts_a_reset_into_the_stream() {
        let pieces: Vec<_> = (0..4u8).map(|low| Piece { time: 0, bytes: vec![low, 0x80, 5, 0x10, 6, 0x20] }).collect();
        let mut model = Model::new("1", move || pieces.clone().into_iter());
        for register in PATH.into_iter().chain([dvs::RUN]) {
            model.write(register, 1);
        }
        assert_eq!(model.bulk(12), Some(Ok(vec![0, 0x80, 5, 0x10, 6, 0x20, 1, 0x80, 5, 0x10, 6, 0x20])));
        let pulse = [0, 2, 0, 0, 0, 1, 0, 2, 0, 0, 0, 0];
        assert_eq!(model.control([0x40, 0xC2, 2, 0, 0, 0, 12, 0], &pulse), Ok(vec![]));
        assert_eq!(model.bulk(64), Some(Ok(vec![1, 0, 1, 0x80, 5, 0x10, 6, 0x20, 2, 0x80, 5, 0x10, 6, 0x20])));
        // When switched off, it sends nothing, not even the time.
        model.write(dvs::RUN, 0);
        model.write(mux::TIMESTAMP_RESET, 1);
        assert_eq!(model.bulk(64), None);
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
