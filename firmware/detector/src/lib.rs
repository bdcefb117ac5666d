//! The circle detector of evcal as firmware, without board-specific code.
//!
//! ```text
//! bytes of the sensor ─► Source ─► events ─► Pipeline ─► frames of the circle stream ─► serial port
//! ```
//!
//! [`Source`] decodes; [`Pipeline`] filters events, collects windows, finds circles with [`evcal_core::detector`] and
//! puts them into frames of [`evcal_link`]. The host finds the board among the circles and calibrates.
//!
//! `no_std`, no allocation, no `unsafe`, no panics. All storage is in [`Storage`], whose initial value is all zeros, so
//! a static of this type takes RAM but no flash.
//!
//! ```
//! use evcal_core::sensor::Sensor;
//! use evcal_core::window::Progress;
//! use evcal_detector::{Pipeline, Settings, Source, Storage, row_bytes, row_count};
//!
//! // On a device: a static.
//! let mut storage = Storage::<{ row_bytes(346) }, { row_count(260) }, 2048, 128, 4000, 1452, 512>::new();
//! let settings = Settings::new("my board 1.0", Sensor { width: 346, height: 260 }, 36);
//! let mut pipeline = Pipeline::new(settings, &mut storage)?;
//! let mut source = Source::evt2();
//!
//! let mut sent = Vec::new();
//! let mut send = |frame: &[u8]| {
//!     sent.extend_from_slice(frame);
//!     true // false when the output has no room
//! };
//! pipeline.announce(0, &mut send);
//! for byte in [0x10, 0x00, 0x00, 0x80, 0x07, 0x18, 0x40, 0x11] {
//!     let Some(event) = source.push(byte) else { continue };
//!     let mut progress = pipeline.push(event);
//!     while progress == Progress::Complete {
//!         pipeline.detect();
//!         progress = pipeline.report(&mut send);
//!     }
//! }
//! assert_eq!(pipeline.statistics().events, 1);
//! # Ok::<(), evcal_detector::SetupError>(())
//! ```
#![no_std]

#[cfg(test)]
extern crate std;

mod messages;
mod pipeline;
mod settings;
mod source;
#[cfg(test)]
mod tests;

pub use evcal_core::cluster::{row_bytes, row_count};
pub use pipeline::{Pipeline, SetupError, Storage};
pub use settings::Settings;
pub use source::Source;
