#![doc = include_str!("../README.md")]
// These lints hold because no input may cause a panic, and because only the program prints, never a library.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod background;
pub mod checkpoint;
mod coverage;
pub mod frames;
pub mod guidance;
pub mod health;
pub mod latest;
pub mod observer;
pub mod obstacle;
#[cfg(feature = "page")]
pub mod page;
pub mod picture;
pub mod recorder;
pub mod replay;
pub mod wanted;
mod watcher;

use std::ops::ControlFlow;
use std::path::Path;

use usb_davis::device::Camera;
use usb_davis::dump::Transfer;

use self::recorder::{Moment, RecorderReport, RecordingError, RecordingPlan, RecordingStatus, record};

pub use self::coverage::{CoverageSummary, DISTANCES, LiveCoverage, Tilt};
pub use self::observer::{Memory, Seen};
pub use self::watcher::Watcher;

/// Records `camera` to `path` until `watcher` has seen enough, the plan ends the recording, or `stop` is set. `status`
/// is called once a second with the progress and the state; `pass_on` is called with every transfer once it is on the
/// disk, and must not block.
///
/// # Errors
/// [`RecordingError`] if nothing can be recorded.
pub fn record_board(
    camera: &mut Camera,
    path: &Path,
    plan: &RecordingPlan,
    watcher: &mut Watcher,
    stop: impl Fn() -> bool,
    pass_on: impl Fn(&Transfer<'_>),
    mut status: impl FnMut(&RecordingStatus, &Seen),
) -> Result<RecorderReport, RecordingError> {
    let mut enough = false;
    record(camera, path, plan, |moment| {
        match moment {
            Moment::Transfer(transfer) => {
                watcher.take(transfer);
                pass_on(transfer);
            }
            Moment::Status(now) => {
                let seen = watcher.seen();
                enough = seen.is_enough();
                status(now, &seen);
            }
            Moment::Silence => {}
        }
        if enough || stop() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
}
