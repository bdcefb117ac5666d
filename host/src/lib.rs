//! evcal: from a recording of a moving circle grid to a calibrated event camera.
//!
//! Stages are plain functions over plain structs, and data flows one way:
//! recording → window → circles → grid → reference frames → initial model and poses → segments →
//! splines → associations → joint solve → result → export. `docs/architecture.md` has a table of the
//! modules here and of what each may use.
//!
//! A camera in a few lines (`host/examples` has more):
//!
//! ```no_run
//! use std::ops::ControlFlow;
//!
//! use evcal::{Board, Recording, RecordingOptions, Task, calibrate};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let board: Board = "acircles:9x4:55mm:r17.5mm".parse()?;
//! let inputs = [Recording::new("recording.dvraw", RecordingOptions::default())?.into()];
//! let task = Task::new(&inputs, &board);
//! let calibrated = calibrate(&task, |stage| {
//!     println!("{stage}");
//!     ControlFlow::Continue(())
//! })?;
//! println!("{:?} ± {:?}", calibrated.camera().parameters(), calibrated.sigma());
//! println!("{}", calibrated.verdict);
//! calibrated.write("calibration", &task)?;
//! # Ok(())
//! # }
//! ```
// No input makes it panic; what is printed is printed by the program.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod board;
pub mod calibrate;
pub mod check;
pub mod circles;
pub mod detection;
pub mod evaluate;
pub mod export;
pub mod files;
pub mod inertial;
pub mod initial;
pub mod lens;
pub mod live;
pub mod motion_capture;
pub mod numerics;
#[cfg(feature = "opencv")]
pub mod opencv;
pub mod output;
#[cfg(feature = "page")]
pub mod page;
pub mod picture_calibration;
pub mod recording;
pub mod report;
pub mod result;
pub mod second_camera;
pub mod settings;
pub mod simulate;
pub mod solve;
pub mod trajectory;
pub mod trust;
pub mod undistort;
mod yaml;

pub use self::board::Board;
pub use self::calibrate::calibrated::Calibrated;
pub use self::calibrate::input::Input;
pub use self::calibrate::step::Step;
pub use self::calibrate::{Task, calibrate};
pub use self::recording::{Recording, RecordingOptions};

/// Version of the program, which its files name.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
