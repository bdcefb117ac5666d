//! The DAVIS346 event camera: its wire protocol and its registers.
//!
//! Nothing here knows of calibration.
//!
//! | module | is |
//! |---|---|
//! | [`registers`] | every register of the camera's logic, and what it holds |
//! | [`protocol`] | the stream of 16-bit words: decoder, encoder |
#![cfg_attr(not(feature = "std"), no_std)]

#[cfg(all(test, not(feature = "std")))]
extern crate std;

pub mod protocol;
pub mod registers;
