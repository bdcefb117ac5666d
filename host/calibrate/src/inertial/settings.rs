//! Prior knowledge about an IMU.

use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

/// Prior knowledge, and options of the solve.
#[derive(Clone, Debug, PartialEq)]
pub struct InertialSettings {
    /// Magnitude of gravity at the site of the recording in m/s².
    pub gravity: f64,
    /// Knot spacing of the IMU solve in seconds; `None` to derive it from the rate of the samples.
    pub knot_spacing: Option<f64>,
    /// Prior σ of scale errors.
    pub scale: f64,
    /// Prior σ of misalignments, in radians.
    pub misalignment: f64,
}

impl Default for InertialSettings {
    fn default() -> Self {
        Self { gravity: STANDARD_GRAVITY, knot_spacing: None, scale: 0.03, misalignment: 0.03 }
    }
}
