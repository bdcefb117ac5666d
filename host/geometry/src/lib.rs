#![doc = include_str!("../README.md")]
// These lints hold because no input may cause a panic, and because only the program prints, never a library.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod board;
pub mod lens;
pub mod numerics;
pub mod timed_pose;
pub mod tum;

/// Version of evcal, written into its files.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
