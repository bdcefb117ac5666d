#![cfg_attr(feature = "std", doc = include_str!("../README.md"))]
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`registers`] | every register of the camera's logic |
//! | [`bias`] | the sensor's bias currents and voltages |
//! | [`configuration`] | all settings, and the register writes that apply them |
//! | [`protocol`] | the stream of 16-bit words: decoder, encoder |
//! | [`dump`] | `.dvraw` files: transfers as they arrived, crash-safe |
//! | [`capture`] | recordings of transfers in any format: `.dvraw`, pcap, pcapng, bare payload |
//! | [`device`] | access to a camera |
//! | [`emulator`] | an emulated camera with configurable faults |
#![cfg_attr(not(feature = "std"), no_std)]
// No input causes a panic.
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

/// USB vendor number of iniVation.
pub const VENDOR_ID: u16 = 0x152A;
/// USB product number of the DAVIS family on a Cypress FX3, which includes the DAVIS346.
pub const PRODUCT_ID: u16 = 0x841A;
