#![doc = include_str!("../README.md")]

pub use evcal_calibrate::VERSION;
pub use evcal_calibrate::calibrate::calibrate;
pub use evcal_calibrate::calibrate::calibrated::Calibrated;
pub use evcal_calibrate::task::Task;
pub use evcal_calibrate::task::input::Input;
pub use evcal_calibrate::task::step::Step;
pub use evcal_geometry::board::{Board, CircleBoard};
pub use evcal_report::output::folder::write_new_folder;
pub use event_recordings::{Recording, RecordingOptions};
