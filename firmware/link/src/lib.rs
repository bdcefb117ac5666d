//! The circle stream: how a detector on a microcontroller tells the host what it found.
//!
//! A detector sends [`Message`]s, each in a frame of its own: a sequence number, the kind of the
//! message, its body in [postcard](https://postcard.jamesmunns.com/wire-format), and a CRC-32, all of it
//! in COBS with a zero byte at the end. So a receiver may join at any byte, a damaged frame costs
//! that frame alone, and what was lost is counted. `docs/formats.md` has the layout byte by byte.
//!
//! `no_std`, no allocation, no `unsafe`, no panics: device and host use the same code.
//!
//! ```
//! use evcal_link::{Circle, Decoder, Encoder, Message};
//!
//! // On the device: every byte of `frame` goes to a serial port.
//! let mut encoder = Encoder::new();
//! let circle = Circle { window: 7, time_us: 81_250, x: 120.5, y: 64.25, radius: 9.0, ..Circle::default() };
//! let frame = encoder.encode(&Message::Circle(circle));
//!
//! // On the host: bytes as they come.
//! let mut decoder = Decoder::new();
//! let received: Vec<Message> = frame.iter().filter_map(|&byte| decoder.push(byte)).collect();
//! assert_eq!(received, [Message::Circle(circle)]);
//! assert_eq!(decoder.counts().frames, 1);
//! ```
#![no_std]
#![forbid(unsafe_code)]
// No input makes it panic.
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
