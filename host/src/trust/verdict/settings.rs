//! Where the verdict draws its lines.

use serde::{Deserialize, Serialize};

/// Bounds of the verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerdictSettings {
    /// A calibration whose projection is known better than this over the sensor is good (px, 95 %).
    pub good: f64,
    /// One that is known worse than this is not good enough (px, 95 %).
    pub poor: f64,
    /// Trajectories shorter than this in all are too short (s).
    pub shortest: f64,
    /// The board must fill at least this much of the image's shorter side at times.
    pub smallest_fill: f64,
    /// The board must be tilted at least so much at times (degrees).
    pub smallest_tilt: f64,
    /// Smallest part of the sensor that must be covered.
    pub coverage: f64,
    /// Largest relative difference of the circles' radius from the stated one.
    pub radius: f64,
    /// Displacements over the sensor that are larger than noise explains, by less than this, are let pass (px).
    pub pattern: f64,
    /// Displacements must be so many times what noise makes of them to count.
    pub pattern_ratio: f64,
    /// Largest relative difference of fx and fy, if it is also beyond four σ.
    pub square_pixels: f64,
}

impl Default for VerdictSettings {
    fn default() -> Self {
        Self {
            good: 0.1,
            poor: 0.3,
            shortest: 2.5,
            smallest_fill: 0.5,
            smallest_tilt: 20.0,
            coverage: 0.7,
            radius: 0.06,
            pattern: 0.008,
            pattern_ratio: 1.5,
            square_pixels: 0.01,
        }
    }
}
