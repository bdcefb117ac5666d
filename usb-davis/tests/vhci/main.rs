//! The real rusb and libusb, through a real kernel, with an emulated camera on the virtual USB controller. The tests
//! need root and the module `vhci-hcd`; `make test-usb-guest` runs them in a virtual machine. If both are available:
//! `cargo test -p usb-davis --test vhci -- --ignored --test-threads=1`.
#![cfg(target_os = "linux")]

mod camera;
mod davis_emulate;
#[path = "../support/session.rs"]
mod session;
#[path = "../support/streams.rs"]
mod streams;

use std::thread::sleep;
use std::time::{Duration, Instant};

use usb_davis::device::{Listing, list};

/// A virtual machine without hardware support is slow on a busy computer.
const PATIENCE: Duration = Duration::from_secs(120);
const NOBODY: u32 = 65_534;

/// Waits until the bus has `count` cameras.
fn listed(count: usize) -> Vec<Listing> {
    let end = Instant::now() + PATIENCE;
    loop {
        let cameras = list().expect("libusb works");
        if cameras.len() == count {
            return cameras;
        }
        assert!(Instant::now() < end, "{cameras:?}");
        sleep(Duration::from_millis(50));
    }
}
