//! A camera in software: registers, vendor requests, descriptors and a stream, with faults on
//! demand, for testing programs that talk to a camera through libusb.
//!
//! [`Model`] is the camera as its USB side sees it; a transport gives it to clients. [`umockdev`]
//! (Linux) serves processes that run under umockdev's preload library, without privileges.

mod model;
#[cfg(target_os = "linux")]
pub mod umockdev;
#[cfg(target_os = "linux")]
mod usbfs;

pub use model::{Faults, Model, Pace, Piece, Stall, default_registers, pieces_of_capture};
