//! Output of results: the folder of a calibration, and its summary on the terminal.

pub mod failure;
pub mod folder;
mod summary;
