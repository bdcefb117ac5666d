//! A camera in software: registers, vendor requests, descriptors and a stream, with faults on
//! demand, for testing programs that talk to a camera through libusb.
//!
//! [`Model`] is the camera as its USB side sees it; a transport gives it to clients. There are two
//! (Linux):
//!
//! - [`umockdev`] serves processes that run under umockdev's preload library, without privileges;
//! - [`vhci`] plugs the camera into the kernel's virtual USB host controller: every program on the
//!   computer sees it in `/dev/bus/usb`. Needs root and the module `vhci-hcd`.

mod descriptors;
mod faults;
mod model;
mod multiplexer;
mod output;
mod piece;
mod requests;
mod stall;
#[cfg(target_os = "linux")]
mod transfers;
#[cfg(target_os = "linux")]
pub mod umockdev;
#[cfg(target_os = "linux")]
mod usbfs;
#[cfg(target_os = "linux")]
mod usbip;
#[cfg(target_os = "linux")]
pub mod vhci;

pub use faults::{Failures, Faults};
pub use model::Model;
pub use output::Pace;
pub use piece::{CapturePieces, Piece};
pub use stall::{Stall, TransferFault};
