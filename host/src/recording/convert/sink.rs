//! The writers behind one face.

use evcal_core::sensor::Sensor;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use evcal_core::event::Event;
use usb_davis::configuration::Configuration;

use usb_davis::protocol::{Frame as WireFrame, ImuModel, ImuSample, ImuScale, Region, Shutter};

use super::{Extra, Target};
use crate::recording::aedat4::other_streams::{Frame, InertialSample};
use crate::recording::aedat4::write::{Encoder, OtherStreams};
use crate::recording::davis::dump::{COMPRESSION, DumpEncoder, READOUT, davis346_header};
use crate::recording::write::{Encode, EventWriter, OutputFormat, WriteError};

/// Size of the sensor of a DAVIS346.
const DAVIS346_SENSOR: Sensor = Sensor::new(346, 260);
/// What the model of a camera's name is.
const DAVIS346_NAME: &str = "DAVIS346_";
/// A frame that takes longer has damaged times (µs).
const LONGEST_FRAME: i64 = 60_000_000;

/// How much was written beside events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Frames.
    pub frames: u64,
    /// Inertial samples.
    pub inertial_samples: u64,
}

/// Where the content of a recording goes.
pub struct Sink {
    writer: Writer,
    written: Written,
}

enum Writer {
    Events(EventWriter),
    Aedat4(Box<Aedat4Sink>),
    Dump(Box<DumpSink>),
}

impl Sink {
    /// Creates the file at `path`. `zero` becomes the zero of a camera's clock (µs).
    pub fn create(
        path: &Path,
        target: Target,
        sensor: Sensor,
        camera_name: &str,
        held: OtherStreams,
        zero: i64,
    ) -> Result<Self, WriteError> {
        let writer = match target {
            Target::Dvraw => Writer::Dump(Box::new(DumpSink::create(path, sensor, camera_name, zero)?)),
            Target::Events(OutputFormat::Aedat4(compression)) => {
                let file = BufWriter::with_capacity(1 << 18, File::create_new(path)?);
                let encoder = Encoder::with_streams(file, compression, sensor, camera_name, held)?;
                Writer::Aedat4(Box::new(Aedat4Sink { encoder, samples: Vec::new() }))
            }
            Target::Events(format) => Writer::Events(EventWriter::create(path, format, sensor, camera_name)?),
        };
        Ok(Self { writer, written: Written::default() })
    }

    /// Writes events.
    pub fn events(&mut self, events: &[Event]) -> Result<(), WriteError> {
        match &mut self.writer {
            Writer::Events(writer) => writer.write(events),
            Writer::Aedat4(file) => file.encoder.write(events),
            Writer::Dump(dump) => {
                dump.events(events);
                Ok(())
            }
        }
    }

    /// Writes a frame or an inertial sample.
    pub fn extra(&mut self, extra: Extra) -> Result<(), WriteError> {
        let written = match (&mut self.writer, &extra) {
            (Writer::Events(_), _) => false,
            (Writer::Aedat4(file), Extra::Frame(frame)) => file.encoder.frame(frame).map(|()| true)?,
            (Writer::Aedat4(file), Extra::Inertial(sample)) => {
                file.samples.push(*sample);
                true
            }
            (Writer::Dump(dump), Extra::Frame(frame)) => dump.frame(frame),
            (Writer::Dump(dump), Extra::Inertial(sample)) => dump.inertial_sample(sample),
        };
        match extra {
            Extra::Frame(_) => self.written.frames += u64::from(written),
            Extra::Inertial(_) => self.written.inertial_samples += u64::from(written),
        }
        Ok(())
    }

    /// Everything before `end` has been given.
    pub fn advance(&mut self, end: i64) -> Result<(), WriteError> {
        match &mut self.writer {
            Writer::Events(_) => Ok(()),
            Writer::Aedat4(file) => file.write_samples(),
            Writer::Dump(dump) => {
                dump.sent = end;
                dump.encoder.advance(dump.time(end))
            }
        }
    }

    /// Closes the file. What could not be kept goes to `lost`.
    pub fn finish(self, lost: &mut Vec<String>) -> Result<Written, WriteError> {
        match self.writer {
            Writer::Events(writer) => writer.finish()?,
            Writer::Aedat4(mut file) => {
                file.write_samples()?;
                file.encoder.finish()?;
            }
            Writer::Dump(dump) => dump.finish(lost)?,
        }
        Ok(self.written)
    }
}

/// An AEDAT4 file and the samples of its next packets.
struct Aedat4Sink {
    encoder: Encoder<BufWriter<File>>,
    samples: Vec<InertialSample>,
}

impl Aedat4Sink {
    fn write_samples(&mut self) -> Result<(), WriteError> {
        self.encoder.imu(&std::mem::take(&mut self.samples))
    }
}

/// A dump and what is needed to say things in the camera's words.
struct DumpSink {
    encoder: DumpEncoder<File>,
    exposure_cycles_per_us: f64,
    /// Time that counts as the camera's zero (µs).
    origin: i64,
    /// Up to when everything is on the wire.
    sent: i64,
    /// End of the latest frame and time of the latest inertial sample.
    frame_end: i64,
    inertial_time: i64,
    frames_overlap: u64,
    frames_without_place: u64,
    samples_back: u64,
}

impl DumpSink {
    fn create(path: &Path, sensor: Sensor, camera_name: &str, origin: i64) -> Result<Self, WriteError> {
        if sensor != DAVIS346_SENSOR {
            return Err(WriteError::Sensor(sensor));
        }
        let serial = camera_name.strip_prefix(DAVIS346_NAME);
        let mut header = davis346_header(serial.unwrap_or_default(), &Configuration::default());
        if serial.is_none() {
            header.identity = None;
        }
        header.writer = "evcal convert".to_owned();
        header.note = "converted from events; the settings of the camera are not known".to_owned();
        if origin != 0 {
            header.start_unix_ns = u64::try_from(origin).unwrap_or(0).saturating_mul(1000);
            header.note += &format!("; times count from {origin} us");
        }
        let clocks = header.registers.clocks();
        let exposure_cycles_per_us = f64::from(clocks.cycles(clocks.adc, 1_000_000)) / 1e6;
        let encoder = DumpEncoder::new(File::create_new(path)?, header, COMPRESSION)?;
        Ok(Self {
            encoder,
            exposure_cycles_per_us,
            origin,
            sent: origin,
            frame_end: i64::MIN,
            inertial_time: i64::MIN,
            frames_overlap: 0,
            frames_without_place: 0,
            samples_back: 0,
        })
    }

    /// A time on the camera's clock.
    fn time(&self, t: i64) -> u64 {
        u64::try_from(t.saturating_sub(self.origin)).unwrap_or(0)
    }

    fn events(&mut self, events: &[Event]) {
        let events: Vec<Event> = events.iter().map(|event| Event { t: event.t - self.origin, ..*event }).collect();
        self.encoder.events(&events);
    }

    /// False if the camera could not have sent it.
    fn frame(&mut self, frame: &Frame) -> bool {
        let ((width, height), (x, y)) = (frame.size, frame.position);
        let inside = |start: u16, size: u16, all: u16| size > 0 && u32::from(start) + u32::from(size) <= u32::from(all);
        let fits = inside(x, width, DAVIS346_SENSOR.width) && inside(y, height, DAVIS346_SENSOR.height);
        if !fits || frame.channels != 1 {
            self.frames_without_place += 1;
            return false;
        }
        let (exposure_start, exposure_end) = frame.exposure.unwrap_or((frame.t, frame.t));
        let readout = (exposure_start.saturating_sub(READOUT), exposure_end.saturating_add(READOUT));
        let (start, end) = frame.readout.unwrap_or(readout);
        let (start, end) = (start.min(exposure_start), end.max(exposure_end));
        // Frames follow each other on the wire; the beginning can wait until the exposure.
        let start = start.max(self.frame_end).max(self.sent);
        if start > exposure_start || end.saturating_sub(start) > LONGEST_FRAME {
            self.frames_overlap += 1;
            return false;
        }
        self.frame_end = end;
        let cycles = (exposure_end - exposure_start) as f64 * self.exposure_cycles_per_us;
        // The upper bits come back as the lower ones: 8 bits are restored exactly, white stays white.
        let pixels: Vec<u16> =
            frame.pixels.iter().map(|&pixel| u16::from(pixel) << 2 | u16::from(pixel >> 6)).collect();
        self.encoder.frame(&WireFrame {
            shutter: Shutter::Global,
            start: self.time(start),
            end: self.time(end),
            exposure_start: Some(self.time(exposure_start)),
            exposure_end: Some(self.time(exposure_end)),
            exposure_cycles: cycles as u32,
            region: Region { x, y, width, height },
            damaged_columns: 0,
            pixels: &pixels,
        });
        true
    }

    fn inertial_sample(&mut self, sample: &InertialSample) -> bool {
        if sample.t < self.inertial_time.max(self.sent) {
            self.samples_back += 1;
            return false;
        }
        self.inertial_time = sample.t;
        let (acceleration, accelerometer) = in_units(sample.acceleration, 2.0);
        let (angular_velocity, gyroscope) = in_units(sample.angular_velocity, 250.0);
        self.encoder.imu(&ImuSample {
            time: self.time(sample.t),
            acceleration: Some(acceleration),
            angular_velocity: Some(angular_velocity),
            // The inverse of `ImuSample::temperature_celsius` for this model.
            temperature: Some(((sample.temperature - 21.0) * 333.87).round() as i16),
            scale: ImuScale { accelerometer, gyroscope },
            model: ImuModel::Mpu9250,
        });
        true
    }

    fn finish(self, lost: &mut Vec<String>) -> Result<(), WriteError> {
        let mut tell = |count: u64, what: &str| {
            if count > 0 {
                lost.push(format!("{count} {what}"));
            }
        };
        tell(self.frames_overlap, "frames whose times overlap, are out of order or cannot be");
        tell(self.frames_without_place, "frames in colour or beyond the sensor");
        tell(self.samples_back, "inertial samples earlier than the one before them");
        if self.origin != 0 {
            let back =
                if self.origin > 0 { " (it is in the header; evcal convert --unix-time adds it again)" } else { "" };
            lost.push(format!("times count from {} us{back}", self.origin));
        }
        self.encoder.finish()?;
        Ok(())
    }
}

/// Three values in 16-bit units of the smallest full scale `first` · 2ⁿ from n = 1, the camera's
/// default, to 3 that holds them, and n.
fn in_units(values: [f32; 3], first: f32) -> ([i16; 3], u8) {
    let largest = values.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
    let full_scale = |scale: u8| first * f32::from(1u8 << scale);
    let scale = (1..3).find(|&scale| largest * 32768.0 / full_scale(scale) <= 32767.0).unwrap_or(3);
    (values.map(|value| (value * 32768.0 / full_scale(scale)).round() as i16), scale)
}
