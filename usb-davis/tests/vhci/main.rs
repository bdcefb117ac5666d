//! The real rusb and libusb, through a real kernel, against an emulated camera on the virtual USB controller. Needs root and
//! the module `vhci-hcd`; `make test-usb-guest` runs it in a virtual machine, `cargo test -p usb-davis --test vhci --
//! --ignored --test-threads=1` where both are at hand.
#![cfg(target_os = "linux")]

mod camera;
#[path = "../support/session.rs"]
mod session;
#[path = "../support/streams.rs"]
mod streams;
