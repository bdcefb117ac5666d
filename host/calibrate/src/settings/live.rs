//! When a live camera has seen enough.

use evcal_core::settings;
use evcal_core::settings::{above, at_least, from_to};
use serde::{Deserialize, Serialize};

settings! {
    /// When a live session has seen enough of the board and stops; none of these settings changes a calibration.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct LiveSettings {
        /// Fewest windows with the board.
        pub boards: u64 = 200, "windows", at_least(0.0);
        /// Smallest share of the cells of the sensor in which circles were seen.
        pub coverage: f64 = 0.8, "", from_to(0.0, 1.0);
        /// Columns of cells into which the sensor is cut.
        pub columns: u16 = 8, "cells", from_to(1.0, 64.0);
        /// Rows of cells.
        pub rows: u16 = 6, "cells", from_to(1.0, 64.0);
        /// Fewest circles in a cell that was seen.
        pub circles_per_cell: u64 = 5, "circles", at_least(1.0);
        /// Smallest angle between board and sensor that counts as tilt.
        pub tilt: f64 = 15.0, "°", from_to(0.0, 90.0);
        /// Fewest windows with the board tilted to the left, to the right, upwards and downwards each.
        pub boards_per_tilt: u64 = 10, "windows", at_least(0.0);
        /// Shortest time from the first sight of the board on.
        pub shortest: f64 = 15.0, "s", at_least(0.0);
        /// Largest error of the projection that a calibration of the recording so far may state: one standard
        /// deviation, root mean square over the sensor; the largest anywhere on it may be three times this.
        pub target: f64 = 0.05, "px", above(0.0);
        /// When the first such calibration is made, after the first sight of the board.
        pub first_checkpoint: f64 = 10.0, "s", at_least(0.0);
        /// Transfers that wait longer for the display's detector are left out of the display. The recording has
        /// them.
        pub longest_wait: f64 = 1.0, "s", at_least(0.0);
    }
}
