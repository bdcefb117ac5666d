//! The real rusb and libusb against an emulated camera on umockdev's preload library (Debian package `umockdev`).
#![cfg(target_os = "linux")]

mod killed_recorder;
mod plugging_and_access;
mod recorder;
#[path = "../support/session.rs"]
mod session;
mod slow_reader;
#[path = "../support/streams.rs"]
mod streams;
