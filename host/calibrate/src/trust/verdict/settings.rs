//! Where the verdict draws its lines.

use evcal_core::settings;
use evcal_core::settings::at_least;
use serde::{Deserialize, Serialize};

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

/// An error of the projection so many times that of a good calibration is not good enough.
pub(super) const POOR: f64 = 3.0;

/// Shortest time for which the board must have been followed (s).
pub(super) const SHORTEST: f64 = 2.5;

/// How much of the image's shorter side the board must have filled at times (in 5 of 100 poses).
pub(super) const SMALLEST_FILL: f64 = 0.5;

/// How far the board must have been tilted at times (°, in 5 of 100 poses).
pub(super) const SMALLEST_TILT: f64 = 20.0;

/// Smallest share of the sensor's 12 × 9 cells with observations.
pub const SMALLEST_COVERAGE: f64 = 0.7;

/// Largest difference between the circles' radius as the events see it and the stated one, as a share of it.
pub(super) const LARGEST_RADIUS_DIFFERENCE: f64 = 0.06;

/// A model that another one contradicts by more than this over the sensor (px, rms) is not good enough.
pub(super) const LARGEST_MISFIT: f64 = 0.03;

/// Largest difference of fx and fy, as a share, if it is certain too.
pub(super) const SQUARE_PIXELS: f64 = 0.01;

settings! {
    /// When a calibration is called good; none of these settings changes the camera.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct VerdictSettings {
        /// Largest error of the projection over the sensor (rms, 95 %) of a good calibration; one with more than three times as
        /// much is not good enough.
        pub good: f64 = 0.1, "px", at_least(0.0);
    }
}
