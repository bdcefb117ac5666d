//! Disturbances of the scene and the sensor, by name.

use std::str::FromStr;

use super::light::{Glare, Lamp};
use super::scene::SceneSettings;
use super::sensor::SensorModel;
use super::smudges::Smudges;
use super::surroundings::{Hand, Texture};

/// A disturbance that a calibration should tolerate or report.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Effect {
    /// A flickering lamp.
    Flicker(Lamp),
    /// A textured room that drifts behind the board.
    Background,
    /// A hand over a part of the board.
    Hand,
    /// The mirror image of a lamp in a glossy print.
    Glare,
    /// Dirt on the lens.
    Smudges,
    /// Vignetting: light loss in the corners as a fraction, instead of the usual 25 %.
    Vignetting(f64),
    /// Defocus: standard deviation of the blur in pixels.
    Defocus(f64),
    /// Number of hot pixels, which fire on their own.
    HotPixels(u32),
    /// Number of columns that send nothing.
    DeadColumns(u32),
}

/// Error: a text is not the name of an effect.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0} is not an effect: write flicker:100Hz:20%, background, hand, glare, smudges, vignetting:60%, defocus:2px, hot-pixels:300 or dead-columns:5"
)]
pub struct EffectError(String);

impl FromStr for Effect {
    type Err = EffectError;

    fn from_str(text: &str) -> Result<Self, EffectError> {
        let error = || EffectError(text.to_owned());
        let parts: Vec<&str> = text.split(':').collect();
        let number = |part: &str, unit: &str| part.strip_suffix(unit)?.parse::<f64>().ok();
        let count = |part: &str| part.parse::<u32>().ok();
        let effect = match parts.as_slice() {
            ["flicker", frequency, depth] => number(frequency, "Hz")
                .zip(number(depth, "%"))
                .map(|(frequency, percent)| Self::Flicker(Lamp { frequency, depth: 0.01 * percent })),
            ["background"] => Some(Self::Background),
            ["hand"] => Some(Self::Hand),
            ["glare"] => Some(Self::Glare),
            ["smudges"] => Some(Self::Smudges),
            ["vignetting", share] => number(share, "%").map(|percent| Self::Vignetting(0.01 * percent)),
            ["defocus", blur] => number(blur, "px").map(Self::Defocus),
            ["hot-pixels", pixels] => count(pixels).map(Self::HotPixels),
            ["dead-columns", columns] => count(columns).map(Self::DeadColumns),
            _ => None,
        };
        effect.ok_or_else(error)
    }
}

impl Effect {
    /// Adds the effect to the scene or to the sensor.
    pub fn apply(self, scene: &mut SceneSettings, sensor: &mut SensorModel) {
        match self {
            Self::Flicker(lamp) => scene.lamp = Some(lamp),
            Self::Background => scene.texture = Some(Texture::default()),
            Self::Hand => scene.hand = Some(Hand::default()),
            Self::Glare => scene.glare = Some(Glare::default()),
            Self::Smudges => sensor.smudges = Some(Smudges::default()),
            Self::Vignetting(share) => sensor.vignette = share,
            Self::Defocus(blur) => sensor.point_spread = libm::hypot(sensor.point_spread, blur),
            Self::HotPixels(pixels) => sensor.hot_pixels = pixels,
            Self::DeadColumns(columns) => sensor.dead_columns = columns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_have_names() {
        let lamp = Lamp { frequency: 100.0, depth: 0.2 };
        for (text, effect) in [
            ("flicker:100Hz:20%", Effect::Flicker(lamp)),
            ("hand", Effect::Hand),
            ("defocus:1.5px", Effect::Defocus(1.5)),
            ("vignetting:60%", Effect::Vignetting(0.6)),
            ("dead-columns:4", Effect::DeadColumns(4)),
        ] {
            assert_eq!(text.parse(), Ok(effect));
        }
        for text in ["", "flicker", "flicker:100:20", "hand:2", "hot-pixels:-1", "vignetting:0.6", "defocus:px", "fog"]
        {
            assert!(text.parse::<Effect>().is_err(), "{text}");
        }
    }
}
