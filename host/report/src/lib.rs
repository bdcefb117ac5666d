#![doc = include_str!("../README.md")]
// No input causes a panic; only the program prints.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod output;
pub mod report;

use evcal_geometry::VERSION;
