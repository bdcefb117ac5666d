//! All streams of a DAVIS: events, frames and IMU samples of one motion.

use evcal_core::event::Event;
use serde::{Deserialize, Serialize};
use usb_davis::protocol::ImuSample;

use super::frame::{ExposureModel, FrameSensor, FrameTimes, SimulatedFrame};
use super::inertia::{InertialBias, InertialSettings, InertialUnit};
use super::inertial_truth::InertialTruth;
use super::row::TICK;
use super::{EventCounts, SLICE_TICKS, Simulation, SimulationError};
use evcal_geometry::lens::camera_file::CameraDescription;

/// Settings of the streams other than events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DavisSettings {
    /// Frames, if enabled.
    pub frames: Option<ExposureModel>,
    /// IMU samples, if enabled.
    pub imu: Option<InertialSettings>,
}

impl DavisSettings {
    /// Checks all settings; returns an error with the first setting that is out of range.
    pub fn check(&self) -> Result<(), SimulationError> {
        self.frames.map_or(Ok(()), |frames| frames.check())?;
        self.imu.map_or(Ok(()), |imu| imu.check())
    }
}

/// Output of a camera in 25 ms, each stream in order of time.
#[derive(Clone, Copy, Debug)]
pub struct DavisSlice<'a> {
    /// Pixel events; a few at the end may be later than `end`, but no event of the next slice is earlier.
    pub events: &'a [Event],
    /// Complete frames that begin in the slice.
    pub frames: &'a [SimulatedFrame],
    /// IMU samples.
    pub imu: &'a [ImuSample],
    /// End of the slice in microseconds; the next slice contains nothing earlier.
    pub end: u64,
}

/// The streams other than events, as described in `truth.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DavisDescription {
    /// Settings.
    pub settings: DavisSettings,
    /// The lens of the frames, if it differs from the lens of the events.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_camera: Option<CameraDescription>,
    /// Constant errors of the IMU, if enabled.
    pub imu_bias: Option<InertialBias>,
}

/// Ground truth of the streams other than events.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DavisTruth {
    /// Times of the frames.
    pub frames: Vec<FrameTimes>,
    /// Ideal IMU readings.
    pub imu: Vec<InertialTruth>,
    /// Constant errors of the IMU, if enabled.
    pub bias: Option<InertialBias>,
}

impl Simulation {
    /// Simulates like [`Simulation::run`], with the same events, and passes them together with the streams in
    /// `settings` to `sink`. Frames that would end after the recording are omitted.
    pub fn run_davis<E>(
        &self,
        settings: &DavisSettings,
        mut sink: impl FnMut(DavisSlice<'_>) -> Result<(), E>,
    ) -> Result<(EventCounts, DavisTruth), E> {
        let seed = self.settings.seed;
        let stage = self.frame_stage.as_ref().unwrap_or(&self.stage);
        let sensor = settings.frames.map(|frames| (frames, FrameSensor::new(stage, frames, seed)));
        let mut unit = settings.imu.map(|imu| (imu, InertialUnit::new(imu, seed)));
        let mut truth = DavisTruth { bias: unit.as_ref().map(|(_, unit)| unit.bias()), ..DavisTruth::default() };
        let time_of = |tick: usize| (tick as f64 * TICK) as u64;
        let (ticks, mut tick) = (self.tick_count(), 0);
        let (mut frames, mut samples) = (Vec::new(), Vec::new());
        let mut next_sample = settings.imu.map_or(0, |imu| 1000 * u64::from(imu.interval));
        let counts = self.run(|events| {
            tick = (tick + SLICE_TICKS).min(ticks);
            let end = time_of(tick);
            frames.clear();
            samples.clear();
            if let Some((settings, sensor)) = &sensor {
                let number = |taken: &[FrameTimes]| u32::try_from(taken.len()).unwrap_or(u32::MAX);
                let mut times = FrameTimes::new(settings, number(&truth.frames));
                while times.start < end && times.end < time_of(ticks) {
                    frames.push(sensor.expose(stage, |t| self.pose(t), number(&truth.frames)));
                    truth.frames.push(times);
                    times = FrameTimes::new(settings, number(&truth.frames));
                }
            }
            if let Some((settings, unit)) = &mut unit {
                let interval = 1000 * u64::from(settings.interval);
                while next_sample < end {
                    if let Some((ideal_reading, read)) = unit.sample(|t| self.pose(t), next_sample) {
                        samples.push(read);
                        truth.imu.push(ideal_reading);
                    }
                    next_sample += interval;
                }
            }
            sink(DavisSlice { events, frames: &frames, imu: &samples, end })
        })?;
        Ok((counts, truth))
    }
}

impl DavisTruth {
    /// Returns the times of the frames as CSV with a header line.
    pub fn frames_csv(&self) -> String {
        let mut text = "frame,start_us,exposure_start_us,exposure_end_us,end_us\n".to_owned();
        for (number, times) in self.frames.iter().enumerate() {
            let FrameTimes { start, exposure_start, exposure_end, end } = times;
            text += &format!("{number},{start},{exposure_start},{exposure_end},{end}\n");
        }
        text
    }

    /// Returns the ideal IMU readings, without bias and noise, as CSV with a header line.
    pub fn imu_csv(&self) -> String {
        let mut text = "t_us,ax_g,ay_g,az_g,gx_deg_s,gy_deg_s,gz_deg_s\n".to_owned();
        for InertialTruth { time, acceleration: a, angular_velocity: w } in &self.imu {
            text += &format!("{time},{:.6},{:.6},{:.6},{:.5},{:.5},{:.5}\n", a.x, a.y, a.z, w.x, w.y, w.z);
        }
        text
    }
}
