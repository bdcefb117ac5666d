//! Motions, lights and sensors by name.

mod sensor;

pub use sensor::SensorPreset;

use super::frame::ExposureModel;
use super::inertia::InertialSettings;
use super::motion::{MotionSettings, Turning};
use super::sensor::SensorModel;

/// Motion of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum MotionPreset {
    /// 150 px/s.
    Slow,
    /// 350 px/s.
    Fast,
    /// 700 px/s.
    Blur,
    /// 850 px/s, with jerks.
    Violent,
    /// 350 px/s, with pauses and looks away from the board.
    Interrupted,
    /// 350 px/s, with a pause of two seconds in the middle.
    Paused,
    /// 350 px/s, with the board far away.
    Far,
    /// 350 px/s, with the board hardly tilted.
    HeadOn,
    /// 350 px/s, in one corner of the image only.
    Corner,
    /// 350 px/s, without rotation.
    Slide,
    /// 350 px/s, with rotation about the camera's y axis only.
    OneAxis,
    /// 350 px/s, with rotation about the line of sight at a constant rate.
    EvenTurn,
    /// 350 px/s, with rotations of a few degrees only.
    LittleTurns,
    /// 350 px/s, back and forth along the same path every two seconds.
    ToAndFro,
}

impl MotionPreset {
    /// All motions.
    pub const ALL: &[Self] = &[
        Self::Slow,
        Self::Fast,
        Self::Blur,
        Self::Violent,
        Self::Interrupted,
        Self::Paused,
        Self::Far,
        Self::HeadOn,
        Self::Corner,
        Self::Slide,
        Self::OneAxis,
        Self::EvenTurn,
        Self::LittleTurns,
        Self::ToAndFro,
    ];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Slow => "slow",
            Self::Fast => "fast",
            Self::Blur => "blur",
            Self::Violent => "violent",
            Self::Interrupted => "interrupted",
            Self::Paused => "paused",
            Self::Far => "far",
            Self::HeadOn => "head-on",
            Self::Corner => "corner",
            Self::Slide => "slide",
            Self::OneAxis => "one-axis",
            Self::EvenTurn => "even-turn",
            Self::LittleTurns => "little-turns",
            Self::ToAndFro => "to-and-fro",
        }
    }

    /// Returns a short description.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Slow => "150 px/s",
            Self::Fast => "350 px/s",
            Self::Blur => "700 px/s",
            Self::Violent => "850 px/s, with jerks",
            Self::Interrupted => "350 px/s, with pauses, and looks away from the board",
            Self::Paused => "350 px/s, with a pause of two seconds in the middle",
            Self::Far => "350 px/s, the board far away",
            Self::HeadOn => "350 px/s, the board hardly tilted",
            Self::Corner => "350 px/s, in one corner of the image only",
            Self::Slide => "350 px/s, without rotation",
            Self::OneAxis => "350 px/s, rotated about the camera's y axis only",
            Self::EvenTurn => "350 px/s, rotated about the line of sight at a constant rate",
            Self::LittleTurns => "350 px/s, rotated by a few degrees only",
            Self::ToAndFro => "350 px/s, to and fro along the same path every two seconds",
        }
    }

    /// Returns the motion in a recording of `duration` seconds.
    pub fn settings(self, duration: f64) -> MotionSettings {
        match self {
            Self::Slow => MotionSettings::slow(),
            Self::Fast => MotionSettings::fast(),
            Self::Blur => MotionSettings::blur(),
            Self::Violent => MotionSettings::violent(),
            Self::Interrupted => MotionSettings::interrupted(duration),
            Self::Paused => MotionSettings::paused(duration),
            Self::Far => MotionSettings::far(),
            Self::HeadOn => MotionSettings::head_on(),
            Self::Corner => MotionSettings::corner(),
            Self::Slide => MotionSettings::turned(Turning::Never),
            Self::OneAxis => MotionSettings::turned(Turning::OneAxis),
            Self::EvenTurn => MotionSettings::turned(Turning::Evenly),
            Self::LittleTurns => MotionSettings::turned(Turning::Little),
            Self::ToAndFro => MotionSettings::to_and_fro(),
        }
    }
}

/// Quality of light and pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum LightPreset {
    /// A DAVIS346-like sensor in a well-lit room.
    Default,
    /// The same sensor in dim light: slow pixels, strong noise.
    Low,
    /// No noise, delay or mismatch.
    Ideal,
}

impl LightPreset {
    /// All light presets.
    pub const ALL: &[Self] = &[Self::Default, Self::Low, Self::Ideal];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Low => "low",
            Self::Ideal => "ideal",
        }
    }

    /// Returns a short description.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Default => "A DAVIS346-like sensor in a well-lit room",
            Self::Low => "The same in dim light: slow pixels, strong noise",
            Self::Ideal => "Neither noise nor delay nor mismatch",
        }
    }

    /// Returns the event pixels.
    pub fn sensor(self) -> SensorModel {
        match self {
            Self::Default => SensorModel::default(),
            Self::Low => SensorModel::low_light(),
            Self::Ideal => SensorModel::ideal(),
        }
    }

    /// Returns the frame settings for `rate` frames per second.
    pub fn frames(self, rate: f64) -> ExposureModel {
        let frames = match self {
            Self::Default => ExposureModel::default(),
            Self::Low => ExposureModel::low_light(),
            Self::Ideal => ExposureModel::ideal(),
        };
        ExposureModel { interval: (1e6 / rate).round() as u32, ..frames }
    }

    /// Returns the IMU settings.
    pub fn inertia(self) -> InertialSettings {
        match self {
            Self::Default | Self::Low => InertialSettings::default(),
            Self::Ideal => InertialSettings::ideal(),
        }
    }
}
