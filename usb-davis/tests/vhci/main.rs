//! The real rusb and libusb, through a real kernel, against an emulated camera on the virtual USB controller. Needs root and
//! the module `vhci-hcd`; `make test-usb-guest` runs it in a virtual machine, `cargo test -p usb-davis --test vhci --
//! --ignored --test-threads=1` where both are at hand.
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

/// A virtual machine without hardware support on a busy computer is slow.
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
