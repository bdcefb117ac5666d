//! Watching a camera while it is recorded: has enough of the board been seen for a calibration?
//!
//! The detection stages of a calibration (windows, circles, grid) run on a thread of their own on
//! what the camera sends. The recording never waits for them: transfers that they have no time for
//! are left out of the display, and counted.

pub mod coverage;
pub mod recorder;
mod watcher;

use serde::{Deserialize, Serialize};

pub use coverage::{LiveCoverage, Tilt};
pub use watcher::{Seen, Watcher};

/// When enough has been seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LiveSettings {
    /// Fewest windows with the board.
    pub boards: u64,
    /// Smallest share of the cells of the sensor in which circles were seen.
    pub coverage: f64,
    /// Columns of cells into which the sensor is cut, 1 to 64.
    pub columns: u16,
    /// Rows of cells, 1 to 64.
    pub rows: u16,
    /// Fewest circles in a cell that was seen.
    pub circles_per_cell: u64,
    /// Smallest angle between the board and the sensor that counts as tilt (degrees).
    pub tilt: f64,
    /// Fewest windows with the board tilted to the left, to the right, upwards and downwards each.
    pub boards_per_tilt: u64,
    /// What waits longer for the display's detector is left out (s).
    pub longest_wait: f64,
}

impl Default for LiveSettings {
    fn default() -> Self {
        Self {
            boards: 200,
            coverage: 0.8,
            columns: 8,
            rows: 6,
            circles_per_cell: 5,
            tilt: 15.0,
            boards_per_tilt: 10,
            longest_wait: 1.0,
        }
    }
}
