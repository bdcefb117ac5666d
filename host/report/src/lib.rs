#![doc = include_str!("../README.md")]
// These lints hold because no input may cause a panic, and because only the program prints, never a library.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod output;
pub mod report;

use evcal_geometry::VERSION;
