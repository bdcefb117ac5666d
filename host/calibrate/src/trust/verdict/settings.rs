//! Where the verdict draws its lines.

use evcal_core::settings;
use evcal_core::settings::{at_least, from_to};
use serde::{Deserialize, Serialize};

use crate::trust::residual_map::ResidualPattern;

/// fx and fy differ where their difference is beyond this many of its standard deviations: that is chance in one
/// calibration of 16 000.
pub(super) const CERTAIN_DIFFERENCE: f64 = 4.0;

/// A coefficient nearer to zero than this many of its standard deviations may be zero: 95 of 100 cases.
pub(super) const TOLD_FROM_ZERO: f64 = 2.0;

/// A focal length known worse than this share of it may be open for want of a second parameter: the two are only known
/// together.
pub(super) const OPEN_FOCAL_LENGTH: f64 = 0.02;

/// They are known together if the projection is uncertain by less than this share of the focal length's uncertainty.
pub(super) const KNOWN_TOGETHER: f64 = 0.1;

settings! {
    /// When a calibration is called good; none of these settings changes the camera.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct VerdictSettings {
        /// Largest error of the projection over the sensor (rms, 95 %) of a good calibration.
        pub good: f64 = 0.1, "px", at_least(0.0);
        /// Beyond this error a calibration is not good enough.
        pub poor: f64 = 0.3, "px", at_least(0.0);
        /// Shortest time for which the board must have been followed.
        pub shortest: f64 = 2.5, "s", at_least(0.0);
        /// How much of the image's shorter side the board must have filled at times (in 5 of 100 poses).
        pub smallest_fill: f64 = 0.5, "", at_least(0.0);
        /// How far the board must have been tilted at times (in 5 of 100 poses).
        pub smallest_tilt: f64 = 20.0, "°", from_to(0.0, 90.0);
        /// Smallest share of the sensor's 12 × 9 cells with observations.
        pub coverage: f64 = 0.7, "", from_to(0.0, 1.0);
        /// Largest difference between the circles' radius as the events see it and the stated one.
        pub radius: f64 = 0.06, "", at_least(0.0);
        /// Displacements that stay in the same places of the image, beyond what noise explains: from this size on (rms)
        /// other lens models are asked.
        pub suspicious_pattern: f64 = 0.002, "px", at_least(0.0);
        /// They must also be so many times what noise makes of them.
        pub suspicious_ratio: f64 = 1.2, "", at_least(1.0);
        /// Such displacements larger than this (rms) speak against the calibration although no other model is better.
        pub pattern: f64 = 0.008, "px", at_least(0.0);
        /// They must also be so many times what noise makes of them.
        pub pattern_ratio: f64 = 1.5, "", at_least(1.0);
        /// A model that another one contradicts by more than this over the sensor (rms) is not good enough.
        pub misfit: f64 = 0.03, "px", at_least(0.0);
        /// Largest difference of fx and fy, if it is beyond four σ too.
        pub square_pixels: f64 = 0.01, "", at_least(0.0);
    }
}

impl VerdictSettings {
    /// Whether displacements that stay in the same places are large enough to ask other models.
    pub fn suspects(&self, pattern: &ResidualPattern) -> bool {
        pattern.shift > self.suspicious_pattern && pattern.shift_ratio > self.suspicious_ratio
    }

    /// Whether they speak against the calibration although no other model is better.
    pub(super) fn condemns(&self, pattern: &ResidualPattern) -> bool {
        pattern.shift > self.pattern && pattern.shift_ratio > self.pattern_ratio
    }
}
