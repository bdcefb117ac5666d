//! Where results go: the folder of a calibration, and what the terminal says of it.

pub mod failure;
pub mod folder;
mod summary;
