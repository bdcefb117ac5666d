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

use evcal_core::settings;
use evcal_core::settings::{at_least, from_to};
use serde::{Deserialize, Serialize};
use usb_davis::device::Camera;

use self::recorder::{Moment, RecorderReport, RecordingError, RecordingPlan, RecordingStatus, record};

pub use self::coverage::{LiveCoverage, Tilt};
pub use self::watcher::{Seen, Watcher};

settings! {
    /// When `evcal live` has seen enough of the board and stops; nothing of it changes a calibration.
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
        /// Transfers that wait longer for the display's detector are left out of the display. The recording has
        /// them.
        pub longest_wait: f64 = 1.0, "s", at_least(0.0);
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
