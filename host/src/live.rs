//! Watching a camera while it is recorded: has enough of the board been seen for a calibration?
//!
//! The detection stages of a calibration (windows, circles, grid) run on a thread of their own on
//! what the camera sends. The recording never waits for them: transfers that they have no time for
//! are left out of the display, and counted.

mod coverage;
pub mod recorder;
mod watcher;

use std::ops::ControlFlow;
use std::path::Path;

use serde::{Deserialize, Serialize};
use usb_davis::device::Camera;

use self::recorder::{Moment, RecorderReport, RecordingError, RecordingPlan, RecordingStatus, record};

pub use self::coverage::{LiveCoverage, Tilt};
pub use self::watcher::{Seen, Watcher};

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

/// Records `camera` to `path` until `watcher` has seen enough, the plan ends it or `stop` says so. `status` is told once
/// a second how it goes and what was seen so far.
///
/// # Errors
/// [`RecordingError`] when nothing can be recorded.
pub fn record_board(
    camera: &mut Camera,
    path: &Path,
    plan: &RecordingPlan,
    watcher: &mut Watcher,
    stop: impl Fn() -> bool,
    mut status: impl FnMut(&RecordingStatus, &Seen),
) -> Result<RecorderReport, RecordingError> {
    let mut enough = false;
    record(camera, path, plan, |moment| {
        match moment {
            Moment::Transfer(transfer) => watcher.take(transfer),
            Moment::Status(now) => {
                let seen = watcher.seen();
                enough = seen.coverage.missing().is_empty();
                status(now, &seen);
            }
            Moment::Silence => {}
        }
        if enough || stop() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
}
