//! Degenerate rotations of a camera, which do not determine all calibration parameters.

use nalgebra::{Rotation3, Vector3};
use serde::{Deserialize, Serialize};

/// Rotation of the camera while it moves in front of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Turning {
    /// About all axes, like a hand.
    #[default]
    Free,
    /// No rotation.
    Never,
    /// About its y axis only.
    OneAxis,
    /// About its line of sight, at a constant rate.
    Evenly,
    /// About all axes, by a few degrees.
    Little,
}

/// Tilt of the board about the x axis of a camera that does not rotate, in degrees: a frontal view would not determine
/// the focal length.
const TILT: f64 = 30.0;
/// Largest angle of rotations about one axis, and of small rotations, in degrees.
const WIDE: f64 = 40.0;
const SMALL: f64 = 8.0;
/// Constant rate of rotation in degrees per second.
const RATE: f64 = 60.0;

impl Turning {
    /// Returns the rotation from the board's axes to the camera's at time `t`, for three waves with values `waves`;
    /// `None` if the rotation is free.
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
