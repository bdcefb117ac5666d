//! Settings of a live session.

use evcal_core::settings;
use evcal_core::settings::{above, at_least, from_to};
use serde::{Deserialize, Serialize};

settings! {
    /// Conditions under which a live session has seen enough of the board and stops; none of these settings changes a
    /// calibration.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct LiveSettings {
        /// Smallest share of the cells of the sensor with circles.
        pub coverage: f64 = 0.8, "", from_to(0.0, 1.0);
        /// Smallest number of windows with the board tilted to the left, to the right, upwards and downwards each.
        pub boards_per_tilt: u64 = 10, "windows", at_least(0.0);
        /// Shortest time since the board was first seen. The first intermediate calibration is made after two thirds of it, at
        /// the earliest after 1 s.
        pub shortest: f64 = 15.0, "s", at_least(0.0);
        /// Largest error of the projection that a calibration of the recording so far may report: one standard deviation, root
        /// mean square over the sensor; the largest anywhere on the sensor may be three times this.
        pub target: f64 = 0.05, "px", above(0.0);
        /// Longest time that a transfer waits for the detector of the display. If the oldest one has waited longer, new transfers
        /// are neither searched nor displayed; the recording contains them.
        pub longest_wait: f64 = 1.0, "s", at_least(0.0);
    }
}

impl LiveSettings {
    /// Returns the time of the first intermediate calibration, after the board was first seen (s).
    pub fn first_checkpoint(&self) -> f64 {
        (self.shortest * 2.0 / 3.0).max(1.0)
    }
}
