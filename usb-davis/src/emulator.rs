//! An emulated camera with registers, vendor requests, descriptors, a stream and configurable faults, for testing
//! programs that use a camera through libusb.
//!
//! [`Model`] is the USB side of the camera; a transport makes it available to clients. There are two (Linux):
//!
//! - [`umockdev`] serves processes that run under umockdev's preload library, without privileges;
//! - [`vhci`] plugs the camera into the kernel's virtual USB host controller, so that every program on the computer
//!   sees it in `/dev/bus/usb`. It needs root and the module `vhci-hcd`.

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
