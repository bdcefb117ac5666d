#![doc = include_str!("../README.md")]
// No input makes it panic; the program prints.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod circles;
pub mod detection;
pub mod diagnosis;
