//! Writer of `.dvraw` dumps from events, frames and IMU samples, as a DAVIS346 would have sent them over USB.
//!
//! Items go through the camera's multiplexer in order of time. Among items of the same time, IMU samples precede events, and
//! events precede parts of a frame. A transfer ends when it is full or when the early-packet delay has passed.

use std::io::Write;
use std::rc::Rc;

use evcal_core::event::{Event, Polarity};
use usb_davis::configuration::Configuration;
use usb_davis::dump::{Compression, DumpHeader, DumpWriter, Identity, Transfer, TransferStatus};
use usb_davis::protocol::{Encoder, Frame, FrameStep, ImuSample, Polarity as WirePolarity, PolarityEvent, frame_steps};
use usb_davis::registers::default_registers;
use usb_davis::{PRODUCT_ID, VENDOR_ID};

use crate::encode::{Pauses, WriteError};

/// Size of a transfer in bytes, as `usb_davis::device` requests it.
const TRANSFER_BYTES: usize = 128 * 1024;
/// Compression of dumps that are not written live.
pub const COMPRESSION: Compression = Compression::Zstd(9);
/// Time in microseconds from the end of a transfer in the camera to its arrival at the host.
const LATENCY: u64 = 150;

/// Returns the header of a dump of a DAVIS346 with this serial number and configuration.
pub fn davis346_header(serial: &str, configuration: &Configuration) -> DumpHeader {
    let mut registers = default_registers();
    let clocks = registers.clocks();
    let imu = registers.layout().imu.model;
    configuration.writes(&clocks, imu, |register, value| registers.set(register, value));
    let identity =
        Identity { vendor_id: VENDOR_ID, product_id: PRODUCT_ID, device_version: 6, serial: serial.to_owned() };
    DumpHeader { identity: Some(identity), registers, ..DumpHeader::default() }
}

/// Input of the multiplexer.
enum Item {
    Imu(ImuSample),
    Event(PolarityEvent),
    Frame(Rc<OwnedFrame>, FrameStep),
}

impl Item {
    /// Order of items with the same time: lower numbers first.
    fn priority(&self) -> u8 {
        match self {
            Self::Imu(_) => 0,
            Self::Event(_) => 1,
            Self::Frame(..) => 2,
        }
    }
}

/// A frame that has not been sent completely.
struct OwnedFrame {
    /// The frame without its pixels.
    head: Frame<'static>,
    pixels: Vec<u16>,
}

/// Encoder of a dump.
///
/// Each kind of item must be given in order of time, in microseconds since the start of the camera's clock.
/// [`DumpEncoder::advance`] declares all kinds complete up to a time.
pub struct DumpEncoder<W: Write> {
    dump: DumpWriter<W>,
    encoder: Encoder,
    header: DumpHeader,
    early_packet_delay: u64,
    waiting: Vec<(u64, Item)>,
    /// Words of the next transfer.
    words: Vec<u8>,
    /// End of the latest transfer in µs, or the time of the first word after a pause.
    since: u64,
    pauses: Pauses,
}

impl<W: Write> DumpEncoder<W> {
    /// Writes the header of a dump to `output`.
    ///
    /// # Errors
    /// When writing to `output` fails.
    pub fn new(output: W, header: DumpHeader, compression: Compression) -> Result<Self, WriteError> {
        let dump = DumpWriter::new(output, &header, compression)?;
        let encoder = Encoder::new(header.registers.layout());
        let early_packet_delay = u64::from(Configuration::default().early_packet_delay);
        Ok(Self {
            dump,
            encoder,
            header,
            early_packet_delay,
            waiting: Vec::new(),
            words: Vec::new(),
            since: 0,
            pauses: Pauses::default(),
        })
    }

    /// Adds events.
    pub fn events(&mut self, events: &[Event]) {
        self.waiting.extend(events.iter().map(|event| {
            let time = u64::try_from(event.t).unwrap_or(0);
            let polarity = match event.polarity {
                Polarity::Off => WirePolarity::Off,
                Polarity::On => WirePolarity::On,
            };
            (time, Item::Event(PolarityEvent { time, x: event.x, y: event.y, polarity }))
        }));
    }

    /// Adds a frame.
    pub fn frame(&mut self, frame: &Frame<'_>) {
        let owned = Rc::new(OwnedFrame { head: Frame { pixels: &[], ..*frame }, pixels: frame.pixels.to_vec() });
        let steps = frame_steps(&self.header.registers.layout(), frame);
        self.waiting.extend(steps.map(|(time, step)| (time, Item::Frame(Rc::clone(&owned), step))));
    }

    /// Adds an IMU sample.
    pub fn imu(&mut self, sample: &ImuSample) {
        self.waiting.push((sample.time, Item::Imu(*sample)));
    }

    /// Sends everything before `end` (µs). Nothing earlier may be added afterwards.
    ///
    /// # Errors
    /// When an item is earlier than one already sent, more than a day later, or outside the sensor, or writing fails.
    pub fn advance(&mut self, end: u64) -> Result<(), WriteError> {
        self.waiting.sort_by_key(|(time, item)| (*time, item.priority()));
        let later = self.waiting.split_off(self.waiting.partition_point(|(time, _)| *time < end));
        for (time, item) in std::mem::replace(&mut self.waiting, later) {
            self.send(time, &item)?;
        }
        Ok(())
    }

    fn send(&mut self, time: u64, item: &Item) -> Result<(), WriteError> {
        let [before, now] = [self.encoder.time(), time].map(|time| i64::try_from(time).unwrap_or(i64::MAX));
        self.pauses.check(before, now)?;
        let due = self.since.saturating_add(self.early_packet_delay);
        if self.words.is_empty() {
            self.since = self.since.max(time);
        } else if time >= due {
            self.hand_over(due, self.words.len())?;
            self.since = due.max(time);
        }
        let words = &mut self.words;
        match item {
            Item::Event(event) => self.encoder.event(event, words)?,
            Item::Imu(sample) => self.encoder.imu(sample, words)?,
            Item::Frame(frame, step) => {
                let whole = Frame { pixels: &frame.pixels, ..frame.head };
                self.encoder.frame_step(time, &whole, *step, words)?;
            }
        }
        while self.words.len() >= TRANSFER_BYTES {
            self.hand_over(time, TRANSFER_BYTES)?;
            self.since = time;
        }
        Ok(())
    }

    /// Ends a transfer of `length` bytes at `time` (µs).
    fn hand_over(&mut self, time: u64, length: usize) -> Result<(), WriteError> {
        let rest = self.words.split_off(length.min(self.words.len()));
        let transfer = Transfer {
            host_ns: Some(noticed(time)),
            gap_before: false,
            status: TransferStatus::Completed,
            payload: &self.words,
        };
        self.dump.transfer(&transfer)?;
        self.words = rest;
        Ok(())
    }

    /// Sends all remaining items and completes the dump.
    ///
    /// # Errors
    /// As [`DumpEncoder::advance`].
    pub fn finish(mut self) -> Result<W, WriteError> {
        self.advance(u64::MAX)?;
        if !self.words.is_empty() {
            self.hand_over(self.since.saturating_add(self.early_packet_delay), self.words.len())?;
        }
        Ok(self.dump.finish()?)
    }
}

/// Returns the arrival time at the host, in nanoseconds, of a transfer that the camera sent at `time` (µs).
fn noticed(time: u64) -> u64 {
    time.saturating_add(LATENCY).saturating_mul(1000)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(times: &[i64]) -> Result<Vec<u8>, WriteError> {
        let mut encoder = DumpEncoder::new(Vec::new(), DumpHeader::default(), Compression::None)?;
        let event = |&t| Event { t, x: 1, y: 2, polarity: Polarity::On };
        encoder.events(&times.iter().map(event).collect::<Vec<_>>());
        encoder.finish()
    }

    /// The camera's stream would need gigabytes of words to count such a time.
    #[test]
    fn a_jump_of_years_is_rejected() {
        let error = written(&[0, 1_700_000_000_000_000]).unwrap_err().to_string();
        assert!(error.contains("1700000000000000 us") && error.contains("more than a day"), "{error}");
        assert!(written(&[0, 86_400_000_000, 172_800_000_000]).is_ok());
    }

    /// Times up to 2⁵⁵ µs can be read, whose nanoseconds exceed 64 bits.
    #[test]
    fn the_latest_times_do_not_overflow() {
        assert_eq!((noticed(7), noticed(1 << 55), noticed(u64::MAX)), (157_000, u64::MAX, u64::MAX));
    }
}
