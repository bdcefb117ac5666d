//! evcal: from a recording of a moving circle grid to a calibrated event camera.
//!
//! A camera in a few lines (`host/evcal/examples` has more):
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
//! evcal::write_new_folder("calibration", &calibrated, &task)?;
//! # Ok(())
//! # }
//! ```
//!
//! The names here are those that such a program needs. Their crates have the rest: [`event_recordings`] reads recordings,
//! [`evcal_geometry`] has boards and lenses, [`evcal_calibrate`] the stages of a calibration, [`evcal_report`] what is written.

pub use evcal_calibrate::VERSION;
pub use evcal_calibrate::calibrate::calibrated::Calibrated;
pub use evcal_calibrate::calibrate::input::Input;
pub use evcal_calibrate::calibrate::step::Step;
pub use evcal_calibrate::calibrate::{Task, calibrate};
pub use evcal_geometry::board::Board;
pub use evcal_report::output::folder::write_new_folder;
pub use event_recordings::{Recording, RecordingOptions};
