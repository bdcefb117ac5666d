//! A simulation as a file.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use usb_davis::configuration::Configuration;
use usb_davis::dump;
use usb_davis::protocol::{Frame as WireFrame, ImuSample, Region, Shutter};

use super::davis::{DavisSettings, DavisSlice, DavisTruth};
use super::frame::{FrameTimes, SimulatedFrame};
use super::{EventCounts, Simulation};
use crate::source::aedat4::header::Compression;
use crate::source::aedat4::other_streams::{Frame, InertialSample};
use crate::source::aedat4::write::{Encoder, OtherStreams};
use crate::source::davis::dump::{DumpEncoder, davis346_header};
use crate::source::write::{Encode, EventWriter, OutputFormat, WriteError};

/// Size of the sensor of a DAVIS346.
pub const DAVIS346_SENSOR: (u16, u16) = (346, 260);
/// Name of the camera in files that have a place for it.
const CAMERA_NAME: &str = "evcal simulator";
/// Serial number of the camera in dumps.
const SERIAL: &str = "evcalsim";
/// Level at which dumps are compressed: they are made once and kept.
const DUMP_COMPRESSION: dump::Compression = dump::Compression::Zstd(19);

/// What kind of file to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingFormat {
    /// Events only, in any format for them.
    Events(OutputFormat),
    /// AEDAT4 with all streams.
    Aedat4,
    /// What a DAVIS346 sends over USB, as `.dvraw`, with all streams.
    Davis346,
}

/// Runs `simulation`, with what `davis` asks for, into the file at `path`. `progress` is called with
/// the number of slices done ([`Simulation::slice_count`] in all).
///
/// # Errors
/// When the file cannot be written, or the sensor is not that of a DAVIS346 where the format asks for
/// it.
pub fn write(
    simulation: &Simulation,
    davis: &DavisSettings,
    path: &Path,
    format: RecordingFormat,
    mut progress: impl FnMut(usize),
) -> Result<(EventCounts, DavisTruth), WriteError> {
    let sensor = (simulation.rays().width(), simulation.rays().height());
    let mut done = 0;
    let mut tick = || {
        done += 1;
        progress(done);
    };
    match format {
        RecordingFormat::Events(format) => {
            let mut writer = EventWriter::create(path, format, sensor, CAMERA_NAME)?;
            let results = simulation.run_davis(&DavisSettings::default(), |slice| {
                tick();
                writer.write(slice.events)
            })?;
            writer.finish()?;
            Ok(results)
        }
        RecordingFormat::Aedat4 => {
            let output = BufWriter::with_capacity(1 << 18, File::create(path)?);
            let others = OtherStreams { frames: davis.frames.is_some(), imu: davis.imu.is_some() };
            let mut encoder = Encoder::with_streams(output, Compression::Zstd, sensor, CAMERA_NAME, others)?;
            let results = simulation.run_davis(davis, |slice| {
                tick();
                write_aedat4(&mut encoder, &slice, sensor)
            })?;
            encoder.finish()?;
            Ok(results)
        }
        RecordingFormat::Davis346 => {
            if sensor != DAVIS346_SENSOR {
                return Err(WriteError::Sensor(sensor));
            }
            let configuration = configuration(davis);
            let mut header = davis346_header(SERIAL, &configuration);
            // Neither version nor time: the same command gives the same bytes.
            header.writer = "evcal simulate".to_owned();
            header.note = "simulated".to_owned();
            let clocks = header.registers.clocks();
            let exposure_cycles = clocks.cycles(clocks.adc, configuration.exposure);
            let mut encoder = DumpEncoder::new(File::create(path)?, header, DUMP_COMPRESSION)?;
            let results = simulation.run_davis(davis, |slice| {
                tick();
                encoder.events(slice.events);
                slice.imu.iter().for_each(|sample| encoder.imu(sample));
                slice.frames.iter().for_each(|frame| encoder.frame(&wire_frame(frame, exposure_cycles)));
                encoder.advance(slice.end)
            })?;
            encoder.finish()?;
            Ok(results)
        }
    }
}

/// The settings of a camera that sends this.
fn configuration(davis: &DavisSettings) -> Configuration {
    let mut configuration = Configuration::calibration();
    if let Some(frames) = davis.frames {
        configuration.exposure = frames.exposure;
        configuration.frame_interval = frames.interval;
    }
    if let Some(imu) = davis.imu {
        configuration.imu_divider = u8::try_from(imu.interval.saturating_sub(1)).unwrap_or(u8::MAX);
        configuration.accelerometer_scale = imu.accelerometer_scale;
        configuration.gyroscope_scale = imu.gyroscope_scale;
    }
    configuration
}

fn wire_frame(frame: &SimulatedFrame, exposure_cycles: u32) -> WireFrame<'_> {
    let FrameTimes { start, exposure_start, exposure_end, end } = frame.times;
    let (width, height) = DAVIS346_SENSOR;
    WireFrame {
        shutter: Shutter::Global,
        start,
        end,
        exposure_start: Some(exposure_start),
        exposure_end: Some(exposure_end),
        exposure_cycles,
        region: Region { x: 0, y: 0, width, height },
        damaged_columns: 0,
        pixels: &frame.pixels,
    }
}

fn write_aedat4<W: std::io::Write + std::io::Seek>(
    encoder: &mut Encoder<W>,
    slice: &DavisSlice<'_>,
    sensor: (u16, u16),
) -> Result<(), WriteError> {
    encoder.write(slice.events)?;
    for SimulatedFrame { times, pixels } in slice.frames {
        let time = |time: u64| i64::try_from(time).unwrap_or(i64::MAX);
        let exposure = (time(times.exposure_start), time(times.exposure_end));
        encoder.frame(&Frame {
            t: exposure.0 + (exposure.1 - exposure.0) / 2,
            exposure: Some(exposure),
            readout: Some((time(times.start), time(times.end))),
            size: sensor,
            position: (0, 0),
            channels: 1,
            pixels: pixels.iter().map(|pixel| (pixel >> 2) as u8).collect(),
        })?;
    }
    let samples: Vec<InertialSample> = slice.imu.iter().map(inertial_sample).collect();
    encoder.imu(&samples)
}

fn inertial_sample(sample: &ImuSample) -> InertialSample {
    InertialSample {
        t: i64::try_from(sample.time).unwrap_or(i64::MAX),
        temperature: sample.temperature_celsius().unwrap_or(0.0),
        acceleration: sample.acceleration_g().unwrap_or_default(),
        angular_velocity: sample.angular_velocity_degrees().unwrap_or_default(),
    }
}
