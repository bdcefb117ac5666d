//! The results of a calibration: its folder of files, and the summary for a terminal.

pub mod failure;
pub mod folder;
pub mod input_files;
pub mod summary;
