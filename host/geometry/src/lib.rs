#![doc = include_str!("../README.md")]
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
