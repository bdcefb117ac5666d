//! Settings of the motion of a simulated camera.

use serde::{Deserialize, Serialize};

use super::turning::Turning;
use crate::clock::Interval;

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_free(turning: &Turning) -> bool {
    *turning == Turning::Free
}

/// Motion of the camera.
///
/// | preset | mean image speed |
/// |---|---|
/// | [`MotionSettings::slow`] | 150 px/s |
/// | [`MotionSettings::fast`] | 350 px/s |
/// | [`MotionSettings::interrupted`], [`MotionSettings::paused`] | 350 px/s while the camera moves |
/// | [`MotionSettings::blur`] | 700 px/s |
/// | [`MotionSettings::violent`] | 850 px/s, with jerks |
/// | all others | 350 px/s |
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionSettings {
    /// Mean speed in the image of the board's points in view, in pixels per second, while the camera moves.
    pub mean_speed: f64,
    /// Relative variation of the speed with a period of two seconds, 0 to 0.9.
    pub speed_variation: f64,
    /// Size of the circle area relative to the shorter side of the image, from farthest to nearest (0.6 and 1 mean 0.6
    /// m to 1 m for a lens of 330 px and a board of 0.45 m).
    pub fill: [f64; 2],
    /// Factor on the distance from the board.
    pub distance_scale: f64,
    /// Largest angle between the line of sight and the board's normal, in degrees, below 80.
    pub tilt: f64,
    /// Largest rotation about the line of sight from `roll_offset` to each side, in degrees.
    pub roll: f64,
    /// Mean rotation about the line of sight, in degrees.
    pub roll_offset: f64,
    /// Distance by which the circle area may leave the image, as a fraction of the half field of view.
    pub overshoot: f64,
    /// Mean position of the board's middle in the image, right and down from the middle of the image, as a fraction of
    /// the half field of view.
    pub aim: [f64; 2],
    /// Fraction of the available range of positions that the board's middle uses, 0 to 1.
    pub reach: f64,
    /// Amplitude of the tremor in degrees.
    pub tremor: f64,
    /// Intervals in which the camera is still; it slows down and speeds up within 0.2 s around them.
    pub pauses: Vec<Interval>,
    /// Intervals in which the camera looks away; it turns within 0.8 s around them.
    pub absences: Vec<Interval>,
    /// Rotation of the camera.
    #[serde(default, skip_serializing_if = "is_free")]
    pub turning: Turning,
    /// Period in seconds after which the motion repeats; without it the motion never repeats.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub period: Option<f64>,
}

impl MotionSettings {
    /// Slow sweeps: 150 px/s.
    pub fn slow() -> Self {
        Self {
            mean_speed: 150.0,
            speed_variation: 0.4,
            fill: [0.6, 1.0],
            distance_scale: 1.0,
            tilt: 45.0,
            roll: 50.0,
            roll_offset: 0.0,
            overshoot: 0.1,
            aim: [0.0, 0.0],
            reach: 1.0,
            tremor: 0.06,
            pauses: Vec::new(),
            absences: Vec::new(),
            turning: Turning::Free,
            period: None,
        }
    }

    /// Quick sweeps: 350 px/s.
    pub fn fast() -> Self {
        Self { mean_speed: 350.0, tremor: 0.1, ..Self::slow() }
    }

    /// Quick sweeps of 350 px/s with a pause and a look away every three seconds, up to `duration` seconds.
    pub fn interrupted(duration: f64) -> Self {
        let spans = |first: f64| {
            let starts = (0..).map(move |round| first + INTERRUPTION_PERIOD * f64::from(round));
            let starts = starts.take_while(|start| *start < duration);
            starts.map(|start| Interval { start, end: start + INTERRUPTION_LENGTH }).collect()
        };
        Self { pauses: spans(FIRST_PAUSE), absences: spans(FIRST_ABSENCE), ..Self::fast() }
    }

    /// Quick sweeps of 350 px/s with one pause of two seconds in the middle of `duration` seconds.
    pub fn paused(duration: f64) -> Self {
        let middle = 0.5 * duration;
        Self { pauses: vec![Interval { start: middle - 1.0, end: middle + 1.0 }], ..Self::fast() }
    }

    /// Quick sweeps at 2.6 times the distance: the board fills about a third of the image.
    pub fn far() -> Self {
        Self { distance_scale: 2.6, ..Self::fast() }
    }

    /// Quick sweeps in which the board is hardly tilted.
    pub fn head_on() -> Self {
        Self { tilt: 8.0, ..Self::fast() }
    }

    /// Quick motion in the upper left corner of the image only.
    pub fn corner() -> Self {
        Self { fill: [0.35, 0.45], aim: [-0.45, -0.45], reach: 0.15, ..Self::fast() }
    }

    /// Quick motion by a machine with this rotation, without a tremor.
    pub fn turned(turning: Turning) -> Self {
        Self { turning, tremor: 0.0, ..Self::fast() }
    }

    /// Quick sweeps back and forth along the same path, every two seconds.
    pub fn to_and_fro() -> Self {
        Self { period: Some(2.0), speed_variation: 0.0, tremor: 0.0, ..Self::fast() }
    }

    /// Sweeps that blur every picture: 700 px/s.
    pub fn blur() -> Self {
        Self { mean_speed: 700.0, tremor: 0.15, ..Self::slow() }
    }

    /// Shaking: 850 px/s on average, several times as fast at times, and a strong tremor.
    pub fn violent() -> Self {
        Self { mean_speed: 850.0, speed_variation: 0.55, tremor: 1.5, ..Self::slow() }
    }
}

/// Time in seconds from one pause, or look away, to the next.
const INTERRUPTION_PERIOD: f64 = 3.0;
/// Length of a pause or a look away in seconds, without its ramps.
const INTERRUPTION_LENGTH: f64 = 0.3;
const FIRST_PAUSE: f64 = 0.6;
const FIRST_ABSENCE: f64 = 2.0;
