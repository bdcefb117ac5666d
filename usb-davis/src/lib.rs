#![cfg_attr(feature = "std", doc = include_str!("../README.md"))]
//!
//! # Modules
//!
//! | module | is |
//! |---|---|
//! | [`registers`] | every register of the camera's logic, and what it holds |
//! | [`bias`] | the sensor's bias currents and voltages |
//! | [`configuration`] | all settings, and the register writes that make them |
//! | [`protocol`] | the stream of 16-bit words: decoder, encoder |
//! | [`dump`] | `.dvraw` files: transfers as they arrived, crash-safe |
//! | [`capture`] | any recording of transfers: `.dvraw`, pcap, pcapng, bare payload |
//! | [`device`] | the camera itself |
//! | [`emulator`] | a camera in software, with faults on demand |
#![cfg_attr(not(feature = "std"), no_std)]
// No input makes it panic.
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::indexing_slicing,
    clippy::string_slice
)]

#[cfg(all(test, not(feature = "std")))]
extern crate std;

pub mod bias;
#[cfg(feature = "std")]
pub mod capture;
pub mod configuration;
#[cfg(feature = "device")]
pub mod device;
#[cfg(feature = "std")]
pub mod dump;
#[cfg(feature = "emulator")]
pub mod emulator;
pub mod protocol;
pub mod registers;

/// iniVation's USB vendor.
pub const VENDOR_ID: u16 = 0x152A;
/// The DAVIS family on a Cypress FX3, the DAVIS346 among it.
pub const PRODUCT_ID: u16 = 0x841A;
