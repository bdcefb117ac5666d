//! Parameters of the pixels of an event camera.

use serde::{Deserialize, Serialize};

use super::smudges::Smudges;

/// Pixels of an event camera. Intensities are relative to a white sheet at the image centre.
///
/// | preset | sensor |
/// |---|---|
/// | [`SensorModel::default`] | a DAVIS346-like sensor in a well-lit room |
/// | [`SensorModel::low_light`] | the same sensor in dim light: slow photoreceptor, strong noise |
/// | [`SensorModel::ideal`] | thresholds and blur only: no noise, delay or mismatch |
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorModel {
    /// Standard deviation of the point-spread function (lens and pixel area) in pixels.
    pub point_spread: f64,
    /// Increase of log intensity that triggers an ON event.
    pub threshold_on: f64,
    /// Decrease of log intensity that triggers an OFF event, positive.
    pub threshold_off: f64,
    /// Standard deviation of the thresholds from pixel to pixel.
    pub threshold_mismatch: f64,
    /// Relative standard deviation of a pixel's threshold from event to event.
    pub threshold_jitter: f64,
    /// Low-pass of the photoreceptor; `None` for no delay.
    pub photoreceptor: Option<Photoreceptor>,
    /// Time after an event in which the pixel is held in reset, in seconds.
    pub refractory: f64,
    /// Dark current as an intensity, added to all light.
    pub dark: f64,
    /// Light loss in the corners of the image, as a fraction.
    pub vignette: f64,
    /// ON events per second and pixel from the leaking reset switch.
    pub leak_rate: f64,
    /// Mean events per second and pixel from shot noise, half of them ON.
    pub noise_rate: f64,
    /// Standard deviation of the decimal logarithm of the noise rate from pixel to pixel.
    pub noise_spread: f64,
    /// Number of hot pixels, which fire on their own.
    pub hot_pixels: u32,
    /// Lowest and highest rate of a hot pixel in events per second.
    pub hot_rate: [f64; 2],
    /// Number of columns that send nothing.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub dead_columns: u32,
    /// Dirt on the lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub smudges: Option<Smudges>,
    /// The read-out that serialises the events of all pixels; `None` for no delay.
    pub arbiter: Option<Arbiter>,
    /// Time between two scans of the whole sensor, in seconds: an event gets the time of the next scan. `None` for
    /// sensors that read pixels on request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<f64>,
}

/// First-order low-pass of log intensity with cut-off `bandwidth · (I + offset) / (1 + offset)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Photoreceptor {
    /// Cut-off frequency at white (I = 1) in hertz.
    pub bandwidth: f64,
    /// Intensity that corresponds to the bandwidth in the dark.
    pub offset: f64,
}

/// A bus that reads one event after another.
///
/// The default takes 110 ns for an event in another row than the previous one, which allows nine events per
/// microsecond, the highest rate in real DAVIS346 recordings. Within a row it takes 45 ns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arbiter {
    /// Shortest time from the pixel's request to the timestamp, in seconds.
    pub latency: f64,
    /// Standard deviation of an additional delay, in seconds.
    pub jitter: f64,
    /// Time on the bus per event, in seconds.
    pub event_time: f64,
    /// Additional time if the next event is in another row, in seconds.
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
    /// Dim light: the photoreceptor is slow, the dark current reduces contrast, noise is strong.
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

    /// No noise, delay or mismatch: an event marks the time at which the blurred log intensity crossed a threshold, to
    /// the microsecond.
    pub fn ideal() -> Self {
        Self {
            point_spread: 0.6,
            // With equal thresholds, a pixel in plain white would return to the very edge of firing.
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
