#![doc = include_str!("../README.md")]
// These lints hold because no input may cause a panic, and because only the program prints, never a library.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod alignment;
pub mod bearings;
mod blurred_print;
pub mod charuco;
pub mod checkerboard;
pub mod crossing;
pub mod found_point;
pub mod picture;
pub mod print_fit;
pub mod quads;
pub mod recognition;
pub mod reconstruction;
#[cfg(test)]
mod rendering;
pub mod saddles;
pub mod tags;
