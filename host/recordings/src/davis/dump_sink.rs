//! Writer of a recording as the stream of a DAVIS346, in `.dvraw`.

use std::fs::File;
use std::io;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use usb_davis::configuration::Configuration;
use usb_davis::protocol::{Frame as WireFrame, ImuModel, ImuSample, ImuScale, Region, Shutter};

use super::dump::{COMPRESSION, DumpEncoder, davis346_header};
use super::transfers;
use crate::encode::{Description, Encode, OutputFormat, WriteError};
use crate::extras::{Extra, Frame, InertialSample, READOUT};

/// Dumps of a DAVIS346.
pub const OUTPUT: OutputFormat = OutputFormat {
    contains_extras: true,
    copy_transfers: Some(transfers::copy),
    ..OutputFormat::of_events("dvraw", &["dvraw"], |file, it| Ok(Box::new(DumpSink::create(file, it)?)))
};

/// Size of the sensor of a DAVIS346.
const DAVIS346_SENSOR: Sensor = Sensor::new(346, 260);
/// Prefix of the camera name, before the serial number.
const DAVIS346_NAME: &str = "DAVIS346_";
/// Duration in µs above which the times of a frame are damaged.
const LONGEST_FRAME: i64 = 60_000_000;

/// Encoder of a dump, with the conversion to the camera's units.
struct DumpSink {
    /// `None` once the file is complete.
    encoder: Option<DumpEncoder<File>>,
    exposure_cycles_per_us: f64,
    /// Time in µs that is the zero of the camera's clock.
    origin: i64,
    /// Time in µs before which everything has been sent.
    sent: i64,
    /// End of the latest frame and time of the latest IMU sample, in µs.
    frame_end: i64,
    inertial_time: i64,
    frames_overlap: u64,
    frames_without_place: u64,
    samples_back: u64,
}

impl DumpSink {
    fn create(
        file: &mut dyn FnMut() -> io::Result<File>,
        &Description { sensor, camera_name, zero: origin, .. }: &Description,
    ) -> Result<Self, WriteError> {
        if sensor != DAVIS346_SENSOR {
            return Err(WriteError::Sensor(sensor));
        }
        let serial = camera_name.strip_prefix(DAVIS346_NAME);
        let mut header = davis346_header(serial.unwrap_or_default(), &Configuration::default());
        if serial.is_none() {
            header.identity = None;
        }
        header.writer = env!("CARGO_PKG_NAME").to_owned();
        header.note = "converted from events; the settings of the camera are not known".to_owned();
        if origin != 0 {
            header.start_unix_ns = u64::try_from(origin).unwrap_or(0).saturating_mul(1000);
            header.note += &format!("; times count from {origin} us");
        }
        let clocks = header.registers.clocks();
        let exposure_cycles_per_us = f64::from(clocks.cycles(clocks.adc, 1_000_000)) / 1e6;
        let encoder = Some(DumpEncoder::new(file()?, header, COMPRESSION)?);
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

    /// Converts a time in µs to the camera's clock.
    fn time(&self, t: i64) -> u64 {
        u64::try_from(t.saturating_sub(self.origin)).unwrap_or(0)
    }

    /// Converts the times in an error of the encoder back to times of the recording.
    fn recorded(&self, error: WriteError) -> WriteError {
        match error {
            WriteError::Jump { before, time } => {
                WriteError::Jump { before: before.saturating_add(self.origin), time: time.saturating_add(self.origin) }
            }
            other => other,
        }
    }

    fn encoder(&mut self) -> Result<&mut DumpEncoder<File>, WriteError> {
        self.encoder.as_mut().ok_or_else(|| io::Error::other("the file is closed").into())
    }

    /// Adds a frame. Returns `false` if the camera could not have sent it.
    fn frame(&mut self, frame: &Frame) -> Result<bool, WriteError> {
        let ((width, height), (x, y)) = (frame.size, frame.position);
        let inside = |start: u16, size: u16, all: u16| size > 0 && u32::from(start) + u32::from(size) <= u32::from(all);
        let fits = inside(x, width, DAVIS346_SENSOR.width) && inside(y, height, DAVIS346_SENSOR.height);
        if !fits || frame.channels != 1 {
            self.frames_without_place += 1;
            return Ok(false);
        }
        let (exposure_start, exposure_end) = frame.exposure.unwrap_or((frame.t, frame.t));
        let readout = (exposure_start.saturating_sub(READOUT), exposure_end.saturating_add(READOUT));
        let (start, end) = frame.readout.unwrap_or(readout);
        let (start, end) = (start.min(exposure_start), end.max(exposure_end));
        // Frames on the wire must not overlap. The read-out of this one may start late, up to the exposure.
        let start = start.max(self.frame_end).max(self.sent);
        if start > exposure_start || end.saturating_sub(start) > LONGEST_FRAME {
            self.frames_overlap += 1;
            return Ok(false);
        }
        self.frame_end = end;
        let cycles = (exposure_end - exposure_start) as f64 * self.exposure_cycles_per_us;
        // 8 bits become 10: the upper 2 bits are repeated, so that the 8 bits are restored exactly and white stays
        // white.
        let pixels: Vec<u16> =
            frame.pixels.iter().map(|&pixel| u16::from(pixel) << 2 | u16::from(pixel >> 6)).collect();
        let [start, end, exposure_start, exposure_end] =
            [start, end, exposure_start, exposure_end].map(|t| self.time(t));
        self.encoder()?.frame(&WireFrame {
            shutter: Shutter::Global,
            start,
            end,
            exposure_start: Some(exposure_start),
            exposure_end: Some(exposure_end),
            exposure_cycles: cycles as u32,
            region: Region { x, y, width, height },
            damaged_columns: 0,
            pixels: &pixels,
        });
        Ok(true)
    }

    fn inertial_sample(&mut self, sample: &InertialSample) -> Result<bool, WriteError> {
        if sample.t < self.inertial_time.max(self.sent) {
            self.samples_back += 1;
            return Ok(false);
        }
        self.inertial_time = sample.t;
        let (acceleration, accelerometer) = in_units(sample.acceleration, 2.0);
        let (angular_velocity, gyroscope) = in_units(sample.angular_velocity, 250.0);
        let time = self.time(sample.t);
        self.encoder()?.imu(&ImuSample {
            time,
            acceleration: Some(acceleration),
            angular_velocity: Some(angular_velocity),
            // The inverse of `ImuSample::temperature_celsius` for this model.
            temperature: Some(((sample.temperature - 21.0) * 333.87).round() as i16),
            scale: ImuScale { accelerometer, gyroscope },
            model: ImuModel::Mpu9250,
        });
        Ok(true)
    }
}

impl Encode for DumpSink {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        let events: Vec<Event> =
            events.iter().map(|event| Event { t: event.t.saturating_sub(self.origin), ..*event }).collect();
        self.encoder()?.events(&events);
        Ok(())
    }

    fn extra(&mut self, extra: Extra) -> Result<bool, WriteError> {
        match extra {
            Extra::Frame(frame) => self.frame(&frame),
            Extra::Inertial(sample) => self.inertial_sample(&sample),
        }
    }

    fn advance(&mut self, end: i64) -> Result<(), WriteError> {
        self.sent = end;
        let end = self.time(end);
        self.encoder()?.advance(end).map_err(|error| self.recorded(error))
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        match self.encoder.take() {
            Some(encoder) => encoder.finish().map(|_| ()).map_err(|error| self.recorded(error)),
            None => Ok(()),
        }
    }

    fn lost(&self) -> Vec<String> {
        let counted = |count: u64, what: &str| (count > 0).then(|| format!("{count} {what}"));
        let origin = (self.origin != 0).then(|| {
            let back = if self.origin > 0 { " (it is in the header)" } else { "" };
            format!("times count from {} us{back}", self.origin)
        });
        [
            counted(self.frames_overlap, "frames whose timestamps overlap, are out of order or are impossible"),
            counted(self.frames_without_place, "frames in colour or beyond the sensor"),
            counted(self.samples_back, "IMU samples earlier than the one before them"),
            origin,
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

/// Converts three values to 16-bit integers. Returns them with n, the exponent of their full scale `first` · 2ⁿ: the
/// smallest of 1 (the camera's default) to 3 that can represent them.
fn in_units(values: [f32; 3], first: f32) -> ([i16; 3], u8) {
    let largest = values.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
    let full_scale = |scale: u8| first * f32::from(1u8 << scale);
    let scale = (1..3).find(|&scale| largest * 32768.0 / full_scale(scale) <= 32767.0).unwrap_or(3);
    (values.map(|value| (value * 32768.0 / full_scale(scale)).round() as i16), scale)
}
