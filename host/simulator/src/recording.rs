//! Writes a simulation as a recording.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use usb_davis::configuration::Configuration;
use usb_davis::protocol::{Frame as WireFrame, ImuSample, Region, Shutter};

use super::davis::{DavisSettings, DavisSlice, DavisTruth};
use super::frame::{FrameTimes, SimulatedFrame};
use super::{EventCounts, Simulation};
use event_recordings::aedat4::header::Compression;
use event_recordings::aedat4::write::Encoder;
use event_recordings::davis::dump::{COMPRESSION, DumpEncoder, davis346_header};
use event_recordings::encode::{Encode, WriteError};
use event_recordings::extras::{Frame, InertialSample, OtherStreams};
use event_recordings::write::EventWriter;
use event_recordings::{aedat4, event_calib, prophesee, text};

/// Size of the sensor of a DAVIS346.
pub const DAVIS346_SENSOR: Sensor = Sensor::new(346, 260);
/// Name of the program in the header of a dump, the same as in existing simulated recordings.
const WRITER: &str = "evcal simulate";
/// Name of the camera in file formats that contain one.
const CAMERA_NAME: &str = "evcal simulator";
/// Serial number of the camera in dumps.
const SERIAL: &str = "evcalsim";

/// File format of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum RecordingFormat {
    /// AEDAT4 with all streams.
    Aedat4,
    /// The USB stream of a DAVIS346, as `.dvraw`, with all streams.
    Davis346,
    /// Events as text.
    Text,
    /// Events as EventCalib binary.
    EventCalib,
    /// Events as Prophesee RAW.
    PropheseeRaw,
}

impl RecordingFormat {
    /// All formats.
    pub const ALL: &[Self] = &[Self::Aedat4, Self::Davis346, Self::Text, Self::EventCalib, Self::PropheseeRaw];

    /// Returns the name, which is the extension of the files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Aedat4 => "aedat4",
            Self::Davis346 => "dvraw",
            Self::Text => "csv",
            Self::EventCalib => "bin",
            Self::PropheseeRaw => "raw",
        }
    }

    /// Returns a short description.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Aedat4 => "AEDAT4, as iniVation's software writes it",
            Self::Davis346 => "What a DAVIS346 sends over USB",
            Self::Text => "Text, events only",
            Self::EventCalib => "EventCalib binary, events only",
            Self::PropheseeRaw => "Prophesee RAW (EVT 3.0), events only",
        }
    }

    /// Returns the name of the recording in the folder of a simulation.
    pub(super) fn file_name(self) -> String {
        format!("events.{}", self.name())
    }

    /// Returns the format for a second camera: the same, or AEDAT4 if the format supports only one camera.
    pub(super) const fn of_second_camera(self) -> Self {
        match self {
            Self::Davis346 => Self::Aedat4,
            other => other,
        }
    }

    /// Returns `true` if the format contains frames and IMU samples.
    pub const fn contains_more_than_events(self) -> bool {
        matches!(self, Self::Aedat4 | Self::Davis346)
    }
}

/// Writes `simulation` with the streams in `davis` into the file at `path`. `progress` is called with the number of
/// finished slices, of [`Simulation::slice_count`] in total.
///
/// # Errors
/// If the file cannot be written, or if the format requires the sensor of a DAVIS346 and the sensor differs.
pub fn write(
    simulation: &Simulation,
    davis: &DavisSettings,
    path: &Path,
    format: RecordingFormat,
    mut progress: impl FnMut(usize),
) -> Result<(EventCounts, DavisTruth), WriteError> {
    let sensor = simulation.rays().sensor();
    let mut done = 0;
    let mut tick = || {
        done += 1;
        progress(done);
    };
    let mut events_only = |format| {
        let mut writer = EventWriter::create(path, format, sensor, CAMERA_NAME)?;
        let results = simulation.run_davis(&DavisSettings::default(), |slice| {
            tick();
            writer.write(slice.events)
        })?;
        writer.finish()?;
        Ok(results)
    };
    match format {
        RecordingFormat::Text => events_only(text::OUTPUT),
        RecordingFormat::EventCalib => events_only(event_calib::OUTPUT),
        RecordingFormat::PropheseeRaw => events_only(prophesee::RAW_OUTPUT),
        RecordingFormat::Aedat4 if *davis == DavisSettings::default() => events_only(aedat4::OUTPUT),
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
            // Neither version nor time, so that the same settings produce the same bytes.
            header.writer = WRITER.to_owned();
            header.note = "simulated".to_owned();
            let clocks = header.registers.clocks();
            let exposure_cycles = clocks.cycles(clocks.adc, configuration.exposure);
            let mut encoder = DumpEncoder::new(File::create(path)?, header, COMPRESSION)?;
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

/// Runs `simulation` and writes its events, transformed by `stamped`, into the file at `path`. Returns their number.
/// `progress` is called with the number of finished slices.
///
/// # Errors
/// If the file cannot be written.
pub(super) fn write_events(
    simulation: &Simulation,
    path: &Path,
    format: RecordingFormat,
    stamped: impl Fn(&[Event]) -> Vec<Event>,
    mut progress: impl FnMut(usize),
) -> Result<EventCounts, WriteError> {
    let format = match format {
        RecordingFormat::Text => text::OUTPUT,
        RecordingFormat::EventCalib => event_calib::OUTPUT,
        RecordingFormat::PropheseeRaw => prophesee::RAW_OUTPUT,
        RecordingFormat::Aedat4 | RecordingFormat::Davis346 => aedat4::OUTPUT,
    };
    let mut writer = EventWriter::create(path, format, simulation.rays().sensor(), CAMERA_NAME)?;
    let (mut done, mut counts) = (0, EventCounts::default());
    simulation.run(|events| {
        done += 1;
        progress(done);
        let events = stamped(events);
        let on = events.iter().map(|event| event.polarity.index() as u64).sum::<u64>();
        counts.on += on;
        counts.off += events.len() as u64 - on;
        writer.write(&events)
    })?;
    writer.finish()?;
    Ok(counts)
}

/// Returns the settings of a camera that sends these streams.
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
    let Sensor { width, height } = DAVIS346_SENSOR;
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
    sensor: Sensor,
) -> Result<(), WriteError> {
    encoder.write(slice.events)?;
    for SimulatedFrame { times, pixels } in slice.frames {
        let time = |time: u64| i64::try_from(time).unwrap_or(i64::MAX);
        let exposure = (time(times.exposure_start), time(times.exposure_end));
        encoder.frame(&Frame {
            t: exposure.0 + (exposure.1 - exposure.0) / 2,
            exposure: Some(exposure),
            readout: Some((time(times.start), time(times.end))),
            size: (sensor.width, sensor.height),
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

#[cfg(test)]
mod tests {
    use evcal_core::event::Event;
    use usb_davis::capture::Capture;
    use usb_davis::protocol::Message;

    use super::*;
    use crate::SimulationSettings;
    use crate::frame::ExposureModel;
    use crate::inertia::InertialSettings;
    use crate::motion::MotionSettings;
    use crate::rays::Rays;
    use crate::scene::SceneSettings;
    use crate::sensor::SensorModel;
    use crate::tests::{board, radtan};
    use event_recordings::extras::Extra;
    use event_recordings::{Recording, RecordingOptions, davis};

    const DAVIS: fn() -> DavisSettings =
        || DavisSettings { frames: Some(ExposureModel::default()), imu: Some(InertialSettings::default()) };

    fn simulation(width: u16) -> Simulation {
        let settings = SimulationSettings {
            duration: 0.14,
            seed: 3,
            scene: SceneSettings::default(),
            sensor: SensorModel::default(),
            motion: MotionSettings::fast(),
        };
        Simulation::new(Rays::new(&radtan(), Sensor::new(width, 260)), board(), settings).unwrap()
    }

    /// Returns everything that the simulation produces.
    fn everything(simulation: &Simulation) -> (Vec<Event>, Vec<SimulatedFrame>, Vec<ImuSample>) {
        let (mut events, mut frames, mut samples) = (Vec::new(), Vec::new(), Vec::new());
        let collect = |slice: DavisSlice<'_>| {
            events.extend_from_slice(slice.events);
            frames.extend_from_slice(slice.frames);
            samples.extend_from_slice(slice.imu);
            Ok::<(), ()>(())
        };
        simulation.run_davis(&DAVIS(), collect).unwrap();
        (events, frames, samples)
    }

    #[test]
    fn a_dump_decodes_to_the_simulated_data() {
        let simulation = simulation(346);
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.dvraw");
        write(&simulation, &DAVIS(), &path, RecordingFormat::Davis346, |_| {}).unwrap();
        let (events, frames, samples) = everything(&simulation);
        assert_eq!((frames.len(), samples.len()), (3, 139));

        let mut capture = Capture::open(&path).unwrap();
        assert_eq!(capture.header().camera_name(), "DAVIS346_evcalsim");
        let mut decoder = capture.header().decoder();
        let (mut seen_events, mut seen_frames, mut seen_samples) = (Vec::new(), Vec::new(), Vec::new());
        let mut latest = (0, 0);
        while let Some(transfer) = capture.next_transfer().unwrap() {
            assert!(!transfer.gap_before && transfer.payload.len() <= TRANSFER_MOST);
            let host_us = transfer.host_ns.unwrap() / 1000;
            assert!(host_us > latest.0, "host times rise");
            assert!(host_us - latest.0 < 2000, "a transfer every millisecond");
            latest.0 = host_us;
            decoder.decode(transfer.payload, |message| match message {
                Message::Events(events) => {
                    latest.1 = events.last().unwrap().time;
                    seen_events.extend_from_slice(events);
                }
                Message::Frame(frame) => {
                    seen_frames.push((frame.start, frame.exposure_middle(), frame.pixels.to_vec()));
                }
                Message::Imu(sample) => seen_samples.push(sample),
                other => panic!("{other:?}"),
            });
            assert!(latest.0 > latest.1, "nothing arrives before it happened");
        }
        assert!(events.len() > 50_000);
        assert!(seen_events.iter().map(|seen| davis::event(seen, 0)).eq(events));
        let expected = frames
            .into_iter()
            .map(|SimulatedFrame { times, pixels }| (times.start, Some(times.exposure_start + 2000), pixels));
        assert!(seen_frames.into_iter().eq(expected));
        assert_eq!(seen_samples, samples);
    }

    #[test]
    fn an_aedat4_file_contains_the_simulated_data() {
        let simulation = simulation(346);
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.aedat4");
        write(&simulation, &DAVIS(), &path, RecordingFormat::Aedat4, |_| {}).unwrap();
        let (events, frames, samples) = everything(&simulation);

        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        let counts: Vec<u64> = recording.streams().unwrap().iter().map(|stream| stream.elements).collect();
        assert_eq!(counts, [events.len() as u64, 3, 139]);
        let mut reader = recording.open().unwrap();
        let (mut seen, mut batch) = (Vec::new(), Vec::new());
        while reader.next_batch(&mut batch).unwrap() {
            seen.extend_from_slice(&batch);
        }
        assert_eq!(seen, events);
        let (mut extras, mut lost) = (recording.open_extras().unwrap(), Vec::new());
        let (mut found_frames, mut found_samples) = (Vec::new(), Vec::new());
        while let Some(extra) = extras.next_until(i64::MAX, &mut lost) {
            match extra {
                Extra::Frame(frame) => found_frames.push(frame),
                Extra::Inertial(sample) => found_samples.push(sample),
            }
        }
        assert_eq!((found_frames.len(), lost), (frames.len(), vec![]));
        for (SimulatedFrame { times, pixels }, frame) in frames.iter().zip(found_frames) {
            assert_eq!(frame.exposure, Some((times.exposure_start as i64, times.exposure_end as i64)));
            assert_eq!(frame.readout, Some((times.start as i64, times.end as i64)));
            assert_eq!((frame.size, frame.channels, frame.t), ((346, 260), 1, times.exposure_start as i64 + 2000));
            assert!(frame.pixels.iter().zip(pixels).all(|(eight, ten)| u16::from(*eight) == ten / 4));
        }
        assert_eq!(found_samples, samples.iter().map(inertial_sample).collect::<Vec<_>>());
    }

    #[test]
    fn other_sensors_have_no_dump() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.dvraw");
        let result = write(&simulation(320), &DAVIS(), &path, RecordingFormat::Davis346, |_| {});
        assert!(result.unwrap_err().to_string().contains("320x260"));
        assert!(!path.exists());
    }

    const TRANSFER_MOST: usize = 128 * 1024;
}
