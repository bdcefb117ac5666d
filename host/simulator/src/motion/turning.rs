//! Ways to turn a camera that leave something open.

use nalgebra::{Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// How the camera turns while it moves before the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Turning {
    /// About all axes, as a hand does.
    #[default]
    Free,
    /// Not at all.
    Never,
    /// About its y axis only.
    OneAxis,
    /// About its line of sight, at the same rate all the time.
    Evenly,
    /// About all axes, by a few degrees.
    Little,
}

/// How the board is tilted about the x axis of a camera that does not turn, in degrees: seen from the front it would not tell the
/// focal length.
const TILT: f64 = 30.0;
/// Greatest angle of turns about one axis, and of little turns, in degrees.
const WIDE: f64 = 40.0;
const SMALL: f64 = 8.0;
/// Rate of even turns in degrees per second.
const RATE: f64 = 60.0;

impl Turning {
    /// The rotation from the board's axes to the camera's at time `t` where three waves are at `waves`; `None` where it is free.
    pub fn rotation(self, t: f64, waves: [f64; 3]) -> Option<Rotation3<f64>> {
        let turn = match self {
            Self::Free => return None,
            Self::Never => Vector3::zeros(),
            Self::OneAxis => Vector3::y() * (WIDE * waves[1]),
            Self::Evenly => Vector3::z() * (RATE * t),
            Self::Little => Vector3::from(waves) * SMALL,
        };
        let radians = turn.map(f64::to_radians);
        Some(Rotation3::new(radians) * Rotation3::from_axis_angle(&Vector3::x_axis(), TILT.to_radians()))
    }
}
