//! Thresholds of the calibration from frames.

use evcal_core::settings;
use evcal_core::settings::{above, at_least, from_to};
use serde::{Deserialize, Serialize};

settings! {
    /// The camera's own frames, where a recording has them: how dots are found in them, and how their calibration
    /// is compared with that from events.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct PictureSettings {
        /// Smallest share of the light around a dot that is missing in its middle.
        pub min_contrast: f64 = 0.25, "", from_to(0.0, 1.0);
        /// Smallest half axis of a dot.
        pub min_radius: f64 = 2.0, "px", at_least(1.0).up_to("max_radius");
        /// Largest radius of a dot; grey levels are compared within this distance, and within a third of it.
        pub max_radius: f64 = 40.0, "px", above(1.0).at_most(1000.0);
        /// Largest ratio of a dot's longest to its shortest diameter.
        pub max_elongation: f64 = 4.0, "", at_least(1.0);
        /// Largest difference of a dot's area from that of the ellipse with its moments, as a share of it.
        pub max_ellipse_error: f64 = 0.25, "", above(0.0);
        /// Largest scatter of the light around a dot, as a share of the dot's contrast.
        pub max_unevenness: f64 = 0.15, "", above(0.0);
        /// Largest blur of the dots' edges (median of a frame), as the standard deviation of a Gaussian.
        pub max_blur: f64 = 2.5, "px", above(0.0);
        /// Distance from which a centre counts linearly instead of squared, in units of the centres' spread.
        pub huber: f64 = 2.5, "σ", above(0.0);
        /// Frames and events agree while their projections differ by at most this many times what the uncertainty
        /// of both makes likely.
        pub agreement: f64 = 2.0, "", above(0.0);
        /// Uncertainty of the frames' projection (rms over the sensor) above which they cannot tell whether the
        /// events are right.
        pub too_uncertain: f64 = 1.0, "px", above(0.0);
        /// Largest offset between frames and events where they are solved together; its standard deviation must be below a
        /// tenth of it.
        pub max_time_offset: f64 = 0.02, "s", at_least(0.0);
    }
}
