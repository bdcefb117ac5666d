//! Event cameras by name.

use evcal_core::sensor::Sensor;

use crate::motion::MotionSettings;
use crate::sensor::{Arbiter, Photoreceptor, SensorModel};

/// An event camera.
///
/// Size, smallest contrast, latency and throughput are taken from table 1 of Gallego et al., "Event-based Vision: A
/// Survey" (TPAMI 2020, [arXiv:1904.08405](https://arxiv.org/abs/1904.08405)). The table contains IMX636 as Gen4 CD,
/// Gen3.1 as Gen3 CD and DVXplorer as DVS-Gen3. Throughput and scan time of DVXplorer are from iniVation instead. Pixel
/// data of GenX320 are not public; the values of IMX636 are used.
///
/// The table does not contain mismatch, noise, leak, refractory time and blur; these are the same as for the DAVIS346.
/// Cameras are not operated at their smallest contrast, so the ratio of a sensor's thresholds to its smallest contrast
/// is also taken from the DAVIS346.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SensorPreset {
    /// 128x128.
    Dvs128,
    /// 240x180.
    Davis240,
    /// 346x260.
    Davis346,
    /// 640x480, read in scans of 200 µs.
    DvXplorer,
    /// Prophesee's Gen3.1, 640x480.
    Gen31,
    /// Prophesee's GenX320, 320x320.
    GenX320,
    /// Sony's and Prophesee's IMX636, 1280x720.
    Imx636,
}

/// Properties that differ between sensors.
struct Figures {
    size: Sensor,
    /// Smallest contrast that triggers an event, as a fraction.
    contrast: f64,
    /// Cut-off of the photoreceptor at white in hertz: 1 / (2 π · largest specified latency).
    bandwidth: f64,
    /// Time on the bus per event in seconds: 1 / throughput.
    event_time: f64,
    /// Additional time on the bus if the next event is in another row, in seconds.
    row_time: f64,
    /// Time between two scans of the whole sensor in seconds, for sensors that scan.
    scan: Option<f64>,
}

/// In the table, the smallest contrast is 14.3 to 22.5 %; the value here is the middle of this range.
const DAVIS346: Figures = Figures {
    size: Sensor::new(346, 260),
    contrast: 0.184,
    bandwidth: 2000.0,
    event_time: 45e-9,
    row_time: 65e-9,
    scan: None,
};
/// The pixels of the three oldest sensors, DVS128, DAVIS240 and DAVIS346, belong to one family and are equally fast in
/// the same light.
const DVS128: Figures =
    Figures { size: Sensor::new(128, 128), contrast: 0.17, event_time: 1e-6, row_time: 0.0, ..DAVIS346 };
const DAVIS240: Figures = Figures { size: Sensor::new(240, 180), contrast: 0.11, ..DAVIS346 };
const DVXPLORER: Figures = Figures {
    size: Sensor::new(640, 480),
    contrast: 0.15,
    bandwidth: 3200.0,
    event_time: 1.0 / 165e6,
    row_time: 0.0,
    scan: Some(200e-6),
};
const GEN31: Figures = Figures {
    size: Sensor::new(640, 480),
    contrast: 0.12,
    bandwidth: 800.0,
    event_time: 1.0 / 66e6,
    row_time: 0.0,
    scan: None,
};
const IMX636: Figures = Figures {
    size: Sensor::new(1280, 720),
    contrast: 0.11,
    bandwidth: 1060.0,
    event_time: 1.0 / 1066e6,
    row_time: 0.0,
    scan: None,
};
const GENX320: Figures = Figures { size: Sensor::new(320, 320), ..IMX636 };

impl SensorPreset {
    /// All sensors.
    pub const ALL: &[Self] =
        &[Self::Dvs128, Self::Davis240, Self::Davis346, Self::DvXplorer, Self::Gen31, Self::GenX320, Self::Imx636];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Dvs128 => "dvs128",
            Self::Davis240 => "davis240",
            Self::Davis346 => "davis346",
            Self::DvXplorer => "dvxplorer",
            Self::Gen31 => "gen31",
            Self::GenX320 => "genx320",
            Self::Imx636 => "imx636",
        }
    }

    /// Returns the number of columns and rows.
    pub const fn size(self) -> Sensor {
        self.figures().size
    }

    const fn figures(self) -> &'static Figures {
        match self {
            Self::Dvs128 => &DVS128,
            Self::Davis240 => &DAVIS240,
            Self::Davis346 => &DAVIS346,
            Self::DvXplorer => &DVXPLORER,
            Self::Gen31 => &GEN31,
            Self::GenX320 => &GENX320,
            Self::Imx636 => &IMX636,
        }
    }

    /// Returns the pixels of this sensor in the same light as `davis346`: the fraction of hot pixels is the same, and
    /// delays that are absent there are absent here.
    pub fn pixels(self, davis346: SensorModel) -> SensorModel {
        let Figures { size, contrast, bandwidth, event_time, row_time, scan } = self.figures();
        let threshold = libm::log1p(*contrast) / libm::log1p(DAVIS346.contrast);
        let hot_pixels =
            f64::from(davis346.hot_pixels) * size.pixel_count() as f64 / DAVIS346.size.pixel_count() as f64;
        SensorModel {
            threshold_on: davis346.threshold_on * threshold,
            threshold_off: davis346.threshold_off * threshold,
            threshold_mismatch: davis346.threshold_mismatch * threshold,
            photoreceptor: davis346.photoreceptor.map(|photoreceptor| Photoreceptor {
                bandwidth: photoreceptor.bandwidth * bandwidth / DAVIS346.bandwidth,
                ..photoreceptor
            }),
            hot_pixels: hot_pixels.round() as u32,
            arbiter: davis346.arbiter.map(|arbiter| Arbiter {
                event_time: arbiter.event_time * event_time / DAVIS346.event_time,
                row_time: arbiter.row_time * row_time / DAVIS346.row_time,
                ..arbiter
            }),
            scan: scan.filter(|_| davis346.arbiter.is_some()),
            ..davis346
        }
    }

    /// Returns the same motion of the hand. Image speeds are proportional to the number of columns, because the focal
    /// length of the usual lens is too.
    pub fn motion(self, davis346: MotionSettings) -> MotionSettings {
        let columns = |sensor: Sensor| f64::from(sensor.width);
        MotionSettings { mean_speed: davis346.mean_speed * columns(self.size()) / columns(DAVIS346.size), ..davis346 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_davis346_by_name_is_the_one_without_a_name() {
        for pixels in [SensorModel::default(), SensorModel::low_light(), SensorModel::ideal()] {
            assert_eq!(SensorPreset::Davis346.pixels(pixels.clone()), pixels);
        }
        assert_eq!(SensorPreset::Davis346.motion(MotionSettings::fast()), MotionSettings::fast());
    }

    #[test]
    fn preset_values_agree_with_the_table() {
        // The thresholds of IMX636 and DAVIS346 have the ratio of ln 1.11 to ln 1.184; the bus of IMX636 carries 1066
        // events per microsecond.
        let imx636 = SensorPreset::Imx636.pixels(SensorModel::default());
        assert!((imx636.threshold_on - 0.42 * 0.10436 / 0.16890).abs() < 1e-4, "{}", imx636.threshold_on);
        assert!((imx636.arbiter.unwrap().event_time - 1e-6 / 1066.0).abs() < 1e-15);
        assert_eq!((imx636.hot_pixels, imx636.scan), (123, None));
        let latency = |preset: SensorPreset| {
            1.0 / (std::f64::consts::TAU * preset.pixels(SensorModel::default()).photoreceptor.unwrap().bandwidth)
        };
        for (preset, expected) in
            [(SensorPreset::Imx636, 150e-6), (SensorPreset::Gen31, 200e-6), (SensorPreset::DvXplorer, 50e-6)]
        {
            assert!((latency(preset) / expected - 1.0).abs() < 0.01, "{}", preset.name());
        }
        let ideal = SensorPreset::DvXplorer.pixels(SensorModel::ideal());
        assert_eq!((ideal.photoreceptor, ideal.arbiter, ideal.scan, ideal.hot_pixels), (None, None, None, 0));
    }
}
