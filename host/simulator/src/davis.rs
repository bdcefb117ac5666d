//! Everything that a DAVIS sends: events, frames and inertial samples of one motion.

use evcal_core::event::Event;
use serde::{Deserialize, Serialize};
use usb_davis::protocol::ImuSample;

use super::frame::{ExposureModel, FrameSensor, FrameTimes, SimulatedFrame};
use super::inertia::{InertialBias, InertialSettings, InertialUnit};
use super::inertial_truth::InertialTruth;
use super::row::TICK;
use super::{EventCounts, SLICE_TICKS, Simulation, SimulationError};
use evcal_geometry::lens::camera_file::CameraDescription;

/// What a camera sends beside its events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DavisSettings {
    /// Frames, if any.
    pub frames: Option<ExposureModel>,
    /// Inertial samples, if any.
    pub imu: Option<InertialSettings>,
}

impl DavisSettings {
    /// Tells which setting is out of its range, if one is.
    pub fn check(&self) -> Result<(), SimulationError> {
        self.frames.map_or(Ok(()), |frames| frames.check())?;
        self.imu.map_or(Ok(()), |imu| imu.check())
    }
}

/// What a camera sent in 25 ms, each kind in order of time.
#[derive(Clone, Copy, Debug)]
pub struct DavisSlice<'a> {
    /// Pixel events; a few at the end may be later than `end`, but none of the next slice is
    /// earlier.
    pub events: &'a [Event],
    /// Frames that begin in the slice, whole.
    pub frames: &'a [SimulatedFrame],
    /// Inertial samples.
    pub imu: &'a [ImuSample],
    /// End of the slice in microseconds: the next one brings nothing earlier.
    pub end: u64,
}

/// The streams beside the events, as `truth.json` has them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DavisDescription {
    /// How they were made.
    pub settings: DavisSettings,
    /// The lens of the frames, where it is not that of the events.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_camera: Option<CameraDescription>,
    /// Constant errors of the inertial unit, if there is one.
    pub imu_bias: Option<InertialBias>,
}

/// What is known of the streams beside the events.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DavisTruth {
    /// When the frames were taken.
    pub frames: Vec<FrameTimes>,
    /// What the inertial unit should have read.
    pub imu: Vec<InertialTruth>,
    /// What it added to that, if there is one.
    pub bias: Option<InertialBias>,
}

impl Simulation {
    /// Simulates as [`Simulation::run`] does, with the same events, and hands what `settings` asks
    /// for to `sink` with them. Frames that would end after the recording are left out.
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
                    if let Some((felt, read)) = unit.sample(|t| self.pose(t), next_sample) {
                        samples.push(read);
                        truth.imu.push(felt);
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
    /// The times of the frames as CSV with a line of names.
    pub fn frames_csv(&self) -> String {
        let mut text = "frame,start_us,exposure_start_us,exposure_end_us,end_us\n".to_owned();
        for (number, times) in self.frames.iter().enumerate() {
            let FrameTimes { start, exposure_start, exposure_end, end } = times;
            text += &format!("{number},{start},{exposure_start},{exposure_end},{end}\n");
        }
        text
    }

    /// What the inertial unit felt, without bias and noise, as CSV with a line of names.
    pub fn imu_csv(&self) -> String {
        let mut text = "t_us,ax_g,ay_g,az_g,gx_deg_s,gy_deg_s,gz_deg_s\n".to_owned();
        for InertialTruth { time, acceleration: a, angular_velocity: w } in &self.imu {
            text += &format!("{time},{:.6},{:.6},{:.6},{:.5},{:.5},{:.5}\n", a.x, a.y, a.z, w.x, w.y, w.z);
        }
        text
    }
}
