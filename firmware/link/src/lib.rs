#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]
// No input causes a panic.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::indexing_slicing)]

#[cfg(test)]
extern crate std;

mod decoder;
mod encoder;
mod frame;
mod message;
#[cfg(test)]
mod tests;

pub use decoder::{Decoder, DecoderCounts};
pub use encoder::Encoder;
pub use frame::{Frame, MAX_FRAME};
pub use message::{Circle, DeviceName, Hello, Losses, Message, PROTOCOL_VERSION, Statistics, WindowEnd};
