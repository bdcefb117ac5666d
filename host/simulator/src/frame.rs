//! The frame sensor that shares the pixels of a DAVIS, which takes ordinary pictures.
//!
//! With a global shutter a frame consists of these steps: all pixels are reset and their reset levels read, the
//! exposure, the signal levels are read. A pixel's value is the mean of the light over the exposure, sampled at evenly
//! spaced moments, so that moving edges blur. Shot noise of the collected electrons, noise of the two reads and a fixed
//! pattern of pixels and columns are added.
//!
//! Rates, times and noise are close to recordings of real DAVIS346 cameras: 25 Hz, 9.2 ms to read all pixels, noise of
//! 2 to 7 steps of 1023 from frame to frame.

use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::SimulationError;
use super::row::Stage;
use super::smudges::scattered;
use super::view::View;
use evcal_geometry::numerics::random::normal;

/// Largest value of a pixel: 10 bits.
pub const FULL_SCALE: u16 = 1023;
/// Stream of random numbers for the fixed pattern.
const PATTERN_STREAM: u64 = u64::MAX - 2;
/// First stream of random numbers for the frames' noise: one per frame and row, above the streams of rows of events.
const FRAME_STREAM: u64 = 1 << 32;

/// Settings of the frame sensor. Pixel values range from 0 to [`FULL_SCALE`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureModel {
    /// Time between the starts of consecutive frames in microseconds.
    pub interval: u32,
    /// Exposure time in microseconds.
    pub exposure: u32,
    /// Time in microseconds to read the reset levels of all pixels before the exposure, and again to read their signal
    /// levels after it.
    pub readout: u32,
    /// Number of moments within the exposure at which the scene is rendered.
    pub moments: u16,
    /// Pixel value of a white sheet at the image centre.
    pub white: f64,
    /// Electrons per step of the pixel value: more electrons mean less shot noise; `None` for no shot noise.
    pub electrons_per_step: Option<f64>,
    /// Standard deviation of a pixel value from the two reads.
    pub read_noise: f64,
    /// Standard deviation of the dark values from pixel to pixel.
    pub pixel_offset: f64,
    /// Standard deviation of the dark values from column to column of the chip (rows of the image of a DAVIS346).
    pub column_offset: f64,
    /// Relative standard deviation of the sensitivity from pixel to pixel.
    pub gain_spread: f64,
}

impl Default for ExposureModel {
    fn default() -> Self {
        Self {
            interval: 40_000,
            exposure: 4000,
            readout: 9200,
            moments: 8,
            white: 700.0,
            electrons_per_step: Some(30.0),
            read_noise: 3.0,
            pixel_offset: 4.0,
            column_offset: 2.0,
            gain_spread: 0.01,
        }
    }
}

impl ExposureModel {
    /// Dim light: a long exposure with little signal.
    pub fn low_light() -> Self {
        Self { exposure: 20_000, moments: 32, white: 300.0, read_noise: 5.0, ..Self::default() }
    }

    /// Motion blur and quantisation only.
    pub fn ideal() -> Self {
        Self {
            electrons_per_step: None,
            read_noise: 0.0,
            pixel_offset: 0.0,
            column_offset: 0.0,
            gain_spread: 0.0,
            ..Self::default()
        }
    }

    /// Checks all settings; returns an error with the first setting that is out of range.
    pub fn check(&self) -> Result<(), SimulationError> {
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        const NOT_NEGATIVE: &str = "0 or above";
        let electrons = self.electrons_per_step.unwrap_or(1.0);
        let busy = u64::from(self.exposure) + 2 * u64::from(self.readout);
        let checks = [
            ("frames.exposure", f64::from(self.exposure), self.exposure > 0, "above 0 us"),
            ("frames.moments", f64::from(self.moments), self.moments > 0, "at least 1"),
            (
                "frames.interval",
                f64::from(self.interval),
                u64::from(self.interval) >= busy,
                "at least the exposure and two read-outs in us",
            ),
            ("frames.white", self.white, self.white > 0.0 && self.white.is_finite(), "above 0"),
            ("frames.electrons_per_step", electrons, electrons > 0.0, "above 0"),
            ("frames.read_noise", self.read_noise, not_negative(self.read_noise), NOT_NEGATIVE),
            ("frames.pixel_offset", self.pixel_offset, not_negative(self.pixel_offset), NOT_NEGATIVE),
            ("frames.column_offset", self.column_offset, not_negative(self.column_offset), NOT_NEGATIVE),
            ("frames.gain_spread", self.gain_spread, not_negative(self.gain_spread), NOT_NEGATIVE),
        ];
        match checks.into_iter().find(|(.., right, _)| !right) {
            Some((name, value, _, range)) => Err(SimulationError::Setting { name, value, range }),
            None => Ok(()),
        }
    }
}

/// Times of a frame, in microseconds since the start of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTimes {
    /// Start of reading the reset levels.
    pub start: u64,
    /// Start of the exposure.
    pub exposure_start: u64,
    /// End of the exposure.
    pub exposure_end: u64,
    /// End of reading the signal levels.
    pub end: u64,
}

impl FrameTimes {
    /// Returns the times of frame `number`, counted from 0 at the start of the recording.
    pub fn new(settings: &ExposureModel, number: u32) -> Self {
        let start = u64::from(number) * u64::from(settings.interval);
        let exposure_start = start + u64::from(settings.readout);
        let exposure_end = exposure_start + u64::from(settings.exposure);
        Self { start, exposure_start, exposure_end, end: exposure_end + u64::from(settings.readout) }
    }
}

/// A picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SimulatedFrame {
    /// Times of the frame.
    pub times: FrameTimes,
    /// Values of all pixels row by row, from 0 (dark) to [`FULL_SCALE`].
    pub pixels: Vec<u16>,
}

/// A frame sensor with a fixed pattern.
#[derive(Clone, Debug)]
pub struct FrameSensor {
    settings: ExposureModel,
    seed: u64,
    /// Dark value and relative sensitivity of each pixel, row by row.
    pattern: Vec<(f64, f64)>,
}

impl FrameSensor {
    /// Creates the sensor on `stage`, with a fixed pattern from `seed`.
    pub fn new(stage: &Stage, settings: ExposureModel, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(PATTERN_STREAM);
        let Sensor { width, height } = stage.rays.sensor();
        let mut pattern = Vec::with_capacity(usize::from(width) * usize::from(height));
        for _ in 0..height {
            let column = settings.column_offset * normal(&mut rng);
            pattern.extend((0..width).map(|_| {
                let offset = column + settings.pixel_offset * normal(&mut rng);
                (offset, 1.0 + settings.gain_spread * normal(&mut rng))
            }));
        }
        Self { settings, seed, pattern }
    }

    /// Takes frame `number` of a camera that moves along `pose` (`T_world_camera` at a time in seconds).
    pub fn expose(&self, stage: &Stage, pose: impl Fn(f64) -> Isometry3<f64> + Sync, number: u32) -> SimulatedFrame {
        self.expose_rolling(stage, pose, number, 0.0)
    }

    /// Takes a frame with a rolling shutter: each row is exposed `line_delay` (µs) later than the row above, the first
    /// row at the times of the frame.
    pub fn expose_rolling(
        &self,
        stage: &Stage,
        pose: impl Fn(f64) -> Isometry3<f64> + Sync,
        number: u32,
        line_delay: f64,
    ) -> SimulatedFrame {
        let times = FrameTimes::new(&self.settings, number);
        let moments = f64::from(self.settings.moments);
        let views_at = |start: f64| -> Vec<(View, f64)> {
            let of_moment = |moment: u16| {
                let share = (f64::from(moment) + 0.5) / moments;
                let t = start + share * f64::from(self.settings.exposure);
                (View::new(&pose(t * 1e-6)).at(t * 1e-6), stage.scene.light(t))
            };
            (0..self.settings.moments).map(of_moment).collect()
        };
        let start = times.exposure_start as f64;
        let of_all = views_at(start);
        let width = usize::from(stage.rays.sensor().width).max(1);
        let mut pixels = vec![0; self.pattern.len()];
        pixels.par_chunks_mut(width).zip(self.pattern.par_chunks(width)).enumerate().for_each(
            |(y, (pixels, pattern))| {
                let y = y as u16;
                let own = (line_delay != 0.0).then(|| views_at(start + line_delay * f64::from(y)));
                let views = own.as_ref().unwrap_or(&of_all);
                let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
                rng.set_stream(FRAME_STREAM + (u64::from(number) << 16) + u64::from(y));
                for (x, (pixel, &(offset, gain))) in (0..).zip(pixels.iter_mut().zip(pattern)) {
                    let scatter = stage.scatter(x, y);
                    let radiance =
                        |(view, light): &(View, f64)| scattered(stage.sample(view, x, y).radiance, scatter) * light;
                    let light = views.iter().map(radiance).sum::<f64>() / moments;
                    let intensity = stage.gain(x, y) * light + stage.sensor.dark;
                    *pixel = self.value(gain * intensity, offset, &mut rng);
                }
            },
        );
        SimulatedFrame { times, pixels }
    }

    /// Returns the pixel value of an intensity (1 for white at the image centre), with noise.
    fn value(&self, intensity: f64, offset: f64, rng: &mut ChaCha8Rng) -> u16 {
        let mean = self.settings.white * intensity;
        // The shot noise of n electrons is √n; the two noises are independent.
        let shot = self.settings.electrons_per_step.map_or(0.0, |electrons| mean.max(0.0) / electrons);
        let variance = shot + self.settings.read_noise * self.settings.read_noise;
        let noise = if variance > 0.0 { variance.sqrt() * normal(rng) } else { 0.0 };
        (mean + offset + noise + 0.5).clamp(0.0, f64::from(FULL_SCALE)) as u16
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, Vector3};

    use super::*;
    use crate::rays::Rays;
    use crate::row::STEPPING;
    use crate::scene::{Scene, SceneSettings};
    use crate::sensor::SensorModel;
    use crate::tests::{board, radtan};

    fn stage() -> Stage {
        let sensor = SensorModel::ideal();
        let scene = Scene::new(board(), SceneSettings::default(), sensor.point_spread);
        Stage { rays: Rays::new(&radtan(), Sensor::new(346, 260)), scene, sensor, stepping: STEPPING }
    }

    /// In front of the board's middle, moving sideways at 0.5 m/s: 1 px in 4 ms at 0.7 m.
    fn sliding(t: f64) -> Isometry3<f64> {
        let position = board().middle().push(-0.7) + Vector3::new(0.5 * t, 0.0, 0.0);
        Isometry3::from_parts(Translation3::from(position), nalgebra::UnitQuaternion::identity())
    }

    #[test]
    fn a_frame_is_the_mean_light_of_its_exposure() {
        let stage = stage();
        let sensor = FrameSensor::new(&stage, ExposureModel::ideal(), 1);
        let frame = sensor.expose(&stage, sliding, 3);
        assert_eq!(
            frame.times,
            FrameTimes { start: 120_000, exposure_start: 129_200, exposure_end: 133_200, end: 142_400 }
        );
        // Simpson's rule over 100 intervals, computed from the scene alone.
        let weight = |step: i32| match step {
            0 | 100 => 1.0,
            step if step % 2 == 1 => 4.0,
            _ => 2.0,
        };
        let views: Vec<(f64, View)> = (0..=100)
            .map(|step| (weight(step) / 300.0, View::new(&sliding(0.1292 + f64::from(step) * 4e-5))))
            .collect();
        let mut blurred = 0;
        for index in (0..frame.pixels.len()).step_by(13) {
            let (x, y) = ((index % 346) as u16, (index / 346) as u16);
            let ray = stage.rays.get(x, y).unwrap();
            let radiance = |view: &View| stage.scene.sample(view, ray).radiance;
            let expected = 700.0 * views.iter().map(|(weight, view)| weight * radiance(view)).sum::<f64>();
            let value = f64::from(frame.pixels[index]);
            assert!((value - expected).abs() < 1.0, "({x}, {y}): {value}, not {expected}");
            let middle = 700.0 * radiance(&views[50].1);
            blurred += usize::from((middle - expected).abs() > 5.0);
        }
        assert!(blurred > 20, "{blurred}");
    }

    /// Noise from frame to frame has the variance of read and shot noise; the mean over frames is the pattern.
    #[test]
    fn noise_has_its_variance() {
        let stage = stage();
        let settings = ExposureModel { moments: 1, ..ExposureModel::default() };
        let sensor = FrameSensor::new(&stage, settings, 1);
        let frames: Vec<SimulatedFrame> =
            (0..40).map(|number| sensor.expose(&stage, |_| sliding(0.0), number)).collect();
        let clean = FrameSensor::new(&stage, ExposureModel { moments: 1, ..ExposureModel::ideal() }, 1);
        let clean = clean.expose(&stage, |_| sliding(0.0), 0);
        let (mut variance, mut pattern, mut count) = (0.0, 0.0, 0.0);
        for (index, &value) in clean.pixels.iter().enumerate().filter(|(_, value)| **value == 700) {
            let values = frames.iter().map(|frame| f64::from(frame.pixels[index]));
            let mean = values.clone().sum::<f64>() / 40.0;
            variance += values.map(|value| (value - mean).powi(2)).sum::<f64>() / 39.0;
            pattern += (mean - f64::from(value)).powi(2);
            count += 1.0;
        }
        assert!(count > 5000.0);
        // 9 from the reads, 700 / 30 from the electrons, 1/12 from rounding.
        let expected = 9.0 + 700.0 / 30.0 + 1.0 / 12.0;
        assert!((variance / count - expected).abs() < 0.02 * expected, "{}", variance / count);
        // 4² from pixels, 2² from columns, 7² from gain, and the remaining noise in a mean of 40 frames.
        let expected = 16.0 + 4.0 + 49.0 + expected / 40.0;
        assert!((pattern / count - expected).abs() < 0.05 * expected, "{}", pattern / count);
    }

    /// Each row equals the row of a global-shutter frame at the row's own time.
    #[test]
    fn rows_of_a_rolling_shutter_have_times_of_their_own() {
        let stage = stage();
        let sensor = FrameSensor::new(&stage, ExposureModel::ideal(), 1);
        let (line_delay, row) = (20.0, 100);
        let rolling = sensor.expose_rolling(&stage, sliding, 3, line_delay);
        let later = |t: f64| sliding(t + 1e-6 * line_delay * row as f64);
        let global = sensor.expose(&stage, later, 3);
        let of_row = |frame: &SimulatedFrame| frame.pixels[row * 346..(row + 1) * 346].to_vec();
        // The times differ in their last bit.
        let off = of_row(&rolling).iter().zip(of_row(&global)).map(|(a, b)| a.abs_diff(b)).max();
        assert!(off <= Some(1), "{off:?}");
        assert_ne!(of_row(&rolling), of_row(&sensor.expose(&stage, sliding, 3)));
    }

    #[test]
    fn bright_pixels_saturate_and_dark_ones_stay_at_zero() {
        let stage = stage();
        let bright = ExposureModel { white: 5000.0, moments: 1, ..ExposureModel::ideal() };
        let frame = FrameSensor::new(&stage, bright, 1).expose(&stage, sliding, 0);
        assert_eq!(frame.pixels.iter().max(), Some(&FULL_SCALE));
        let dark = ExposureModel { white: 1.0, moments: 1, read_noise: 30.0, ..ExposureModel::ideal() };
        let frame = FrameSensor::new(&stage, dark, 1).expose(&stage, sliding, 0);
        assert_eq!(frame.pixels.iter().min(), Some(&0));
    }

    #[test]
    fn impossible_times_are_refused() {
        assert!(ExposureModel { exposure: 30_000, ..ExposureModel::default() }.check().is_err());
        for settings in [ExposureModel::default(), ExposureModel::low_light(), ExposureModel::ideal()] {
            assert_eq!(settings.check(), Ok(()));
        }
    }
}
