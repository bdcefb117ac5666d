//! Boards, lenses and the mathematics that the crates of evcal share.
//!
//! - [`board`]: the printed board, its homography and its sheet of paper;
//! - [`lens`]: camera files, priors on distortion, differences between two cameras;
//! - [`numerics`]: banded and arrow-shaped least squares, Levenberg-Marquardt, robust loss, statistics;
//! - [`timed_pose`] and [`tum`]: poses with a time, and their files.
// No input makes it panic; the program prints.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod board;
pub mod lens;
pub mod numerics;
pub mod timed_pose;
pub mod tum;

/// Version of evcal, which its files name.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
