//! What is known of an inertial unit beforehand.

use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

/// What is known beforehand, and how the solve is made.
#[derive(Clone, Debug, PartialEq)]
pub struct InertialSettings {
    /// Size of gravity at the place of the recording in m/s².
    pub gravity: f64,
    /// Distance of the knots of the inertial solve in seconds; without it, it suits the rate of the samples.
    pub knot_spacing: Option<f64>,
    /// σ of scale errors before any measurement.
    pub scale: f64,
    /// σ of misalignments before any measurement, in radians.
    pub misalignment: f64,
}

impl Default for InertialSettings {
    fn default() -> Self {
        Self { gravity: STANDARD_GRAVITY, knot_spacing: None, scale: 0.03, misalignment: 0.03 }
    }
}
