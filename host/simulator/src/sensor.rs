//! The numbers that describe the pixels of an event camera.

use serde::{Deserialize, Serialize};

use super::smudges::Smudges;

/// Pixels of an event camera. Intensities are in units of a white sheet at the image centre.
///
/// | preset | for |
/// |---|---|
/// | [`SensorModel::default`] | a DAVIS346-like sensor in a well-lit room |
/// | [`SensorModel::low_light`] | the same in dim light: slow photoreceptor, strong noise |
/// | [`SensorModel::ideal`] | thresholds and blur only: neither noise nor delay nor mismatch |
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorModel {
    /// Standard deviation of the point-spread function (lens and pixel area) in pixels.
    pub point_spread: f64,
    /// Rise of log intensity that makes an ON event.
    pub threshold_on: f64,
    /// Fall of log intensity that makes an OFF event, positive.
    pub threshold_off: f64,
    /// Standard deviation of the thresholds from pixel to pixel.
    pub threshold_mismatch: f64,
    /// Standard deviation of a pixel's threshold from event to event, as a share of it.
    pub threshold_jitter: f64,
    /// Low-pass of the photoreceptor; `None` for one without delay.
    pub photoreceptor: Option<Photoreceptor>,
    /// Time after an event in which the pixel is held in reset, in seconds.
    pub refractory: f64,
    /// Dark current as an intensity, added to all light.
    pub dark: f64,
    /// Loss of light in the corners of the image, as a share.
    pub vignette: f64,
    /// ON events per second and pixel from the leaking reset switch.
    pub leak_rate: f64,
    /// Mean events per second and pixel from shot noise, half of them ON.
    pub noise_rate: f64,
    /// Standard deviation of the decimal logarithm of the noise rate from pixel to pixel.
    pub noise_spread: f64,
    /// Number of pixels that fire on their own.
    pub hot_pixels: u32,
    /// Lowest and highest rate of a hot pixel in events per second.
    pub hot_rate: [f64; 2],
    /// Number of columns that send nothing.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub dead_columns: u32,
    /// Dirt on the lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub smudges: Option<Smudges>,
    /// The read-out that puts events of all pixels in a row; `None` for one without delay.
    pub arbiter: Option<Arbiter>,
    /// Time between two scans of the whole sensor, in seconds: an event waits for the next one and has its time. `None` for
    /// sensors that read pixels when they ask for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<f64>,
}

/// First-order low-pass of log intensity with cut-off `bandwidth · (I + offset) / (1 + offset)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Photoreceptor {
    /// Cut-off frequency at white (I = 1) in hertz.
    pub bandwidth: f64,
    /// Intensity that stands for the bandwidth left in the dark.
    pub offset: f64,
}

/// A bus that reads one event after the other.
///
/// The default needs 110 ns for an event in another row than the one before: nine a microsecond, as many as real DAVIS346
/// recordings have at most. Within a row it needs 45 ns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arbiter {
    /// Least time from the pixel's request to the time stamp, in seconds.
    pub latency: f64,
    /// Standard deviation of an extra delay, in seconds.
    pub jitter: f64,
    /// Time on the bus per event, in seconds.
    pub event_time: f64,
    /// Extra time when the next event is in another row, in seconds.
    pub row_time: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(count: &u32) -> bool {
    *count == 0
}

impl Default for SensorModel {
    fn default() -> Self {
        Self {
            point_spread: 0.6,
            threshold_on: 0.42,
            threshold_off: 0.44,
            threshold_mismatch: 0.03,
            threshold_jitter: 0.02,
            photoreceptor: Some(Photoreceptor { bandwidth: 2000.0, offset: 0.1 }),
            refractory: 0.5e-3,
            dark: 0.004,
            vignette: 0.25,
            leak_rate: 0.1,
            noise_rate: 0.6,
            noise_spread: 0.15,
            hot_pixels: 12,
            hot_rate: [60.0, 400.0],
            dead_columns: 0,
            smudges: None,
            arbiter: Some(Arbiter { latency: 4e-6, jitter: 3e-6, event_time: 45e-9, row_time: 65e-9 }),
            scan: None,
        }
    }
}

impl SensorModel {
    /// Dim light: the photoreceptor is slow, the dark current eats contrast, noise is strong.
    pub fn low_light() -> Self {
        Self {
            threshold_mismatch: 0.035,
            threshold_jitter: 0.05,
            photoreceptor: Some(Photoreceptor { bandwidth: 300.0, offset: 0.12 }),
            dark: 0.05,
            leak_rate: 0.25,
            noise_rate: 5.0,
            hot_pixels: 30,
            ..Self::default()
        }
    }

    /// No noise, no delay, no mismatch: an event marks where the blurred log intensity crossed a
    /// threshold, to the microsecond.
    pub fn ideal() -> Self {
        Self {
            point_spread: 0.6,
            // Equal thresholds would bring a pixel back to the very edge of firing in plain white.
            threshold_on: 0.4,
            threshold_off: 0.43,
            threshold_mismatch: 0.0,
            threshold_jitter: 0.0,
            photoreceptor: None,
            refractory: 0.0,
            dark: 0.0,
            vignette: 0.0,
            leak_rate: 0.0,
            noise_rate: 0.0,
            noise_spread: 0.0,
            hot_pixels: 0,
            hot_rate: [60.0, 400.0],
            dead_columns: 0,
            smudges: None,
            arbiter: None,
            scan: None,
        }
    }
}
