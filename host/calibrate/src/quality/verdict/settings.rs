//! Bounds of the verdict.

use evcal_core::settings;
use evcal_core::settings::at_least;
use serde::{Deserialize, Serialize};

/// Number of standard deviations from which fx and fy differ significantly: by chance in one calibration of 16 000.
pub(super) const CERTAIN_DIFFERENCE: f64 = 4.0;

/// Number of standard deviations below which a coefficient is not significantly different from zero (95 %).
pub(super) const SIGNIFICANT: f64 = 2.0;

/// Share of the focal length above which its σ suggests that it is only determined together with another parameter.
pub(super) const OPEN_FOCAL_LENGTH: f64 = 0.02;

/// The focal length and the other parameter are determined together if the uncertainty of the projection is below this
/// share of the focal length's uncertainty.
pub(super) const KNOWN_TOGETHER: f64 = 0.1;

/// Multiple of [`VerdictSettings::good`] from which the error of the projection is not good enough.
pub(super) const POOR: f64 = 3.0;

/// Shortest time for which the board must have been followed (s).
pub(super) const SHORTEST: f64 = 2.5;

/// Smallest share of the image's shorter side that the board must have filled in 5 % of the poses.
pub(super) const SMALLEST_FILL: f64 = 0.5;

/// Smallest tilt that the board must have reached in 5 % of the poses (°).
pub(super) const SMALLEST_TILT: f64 = 20.0;

/// Smallest share of the sensor's 12 × 9 cells with observations.
pub const SMALLEST_COVERAGE: f64 = 0.7;

/// Largest difference between the circles' radius from the events and the nominal one, as a share of it.
pub(super) const LARGEST_RADIUS_DIFFERENCE: f64 = 0.06;

/// Largest difference of the projection from a better model (px, rms over the sensor); above it, the model is not good
/// enough.
pub(super) const LARGEST_MISFIT: f64 = 0.03;

/// Largest difference of fx and fy, as a share, if it is also significant.
pub(super) const SQUARE_PIXELS: f64 = 0.01;

settings! {
    /// Bounds of a good calibration; none of these settings changes the camera.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct VerdictSettings {
        /// Largest error of the projection over the sensor (rms, 95 %) of a good calibration; with more than three times as much,
        /// a calibration is not good enough.
        pub good: f64 = 0.1, "px", at_least(0.0);
    }
}
