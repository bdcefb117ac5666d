#![doc = include_str!("../README.md")]
// No input makes it panic; the program prints.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod advice;
pub mod calibrate;
pub mod check;
pub mod evaluate;
pub mod export;
pub mod inertial;
pub mod picture_calibration;
pub mod quality;
pub mod result;
pub mod second_camera;
pub mod settings;
pub mod task;
pub mod undistort;

pub use evcal_geometry::VERSION;
