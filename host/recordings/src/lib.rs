#![doc = include_str!("../README.md")]
//!
//! To add a format, write a module with a [`FileFormat`] constant and add the constant to [`FORMATS`].

// Untrusted input must not cause a panic, and this library prints nothing.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod aedat2;
mod aedat3;
pub mod aedat4;
pub mod bytes;
mod chain;
pub mod columns;
pub mod continued;
pub mod convert;
mod counted;
mod counter;
pub mod date;
pub mod davis;
mod doubtful_unit;
pub mod encode;
mod error;
pub mod event_calib;
mod event_stream;
pub mod extras;
mod files;
mod format;
mod formats;
pub mod given_sensor;
#[cfg(feature = "hdf5")]
pub mod hdf5;
pub mod image_file;
pub mod image_folder;
pub mod images;
pub mod likely_sensor;
mod memory;
mod numbers;
pub mod numpy;
mod options;
mod order;
pub mod pass;
pub mod pictures;
pub mod prophesee;
mod read_report;
mod reader;
mod recording;
mod remedies;
pub mod ros;
#[cfg(test)]
mod testing;
pub mod text;
mod unsupported_format;
pub mod write;

pub use columns::LayoutError;
pub use error::{RecordingError, RecordingErrorKind, Usable};
pub use files::{Checksum, Files};
pub use format::{FileFormat, Head, OpenResult, OpenTransfers, StreamSummary, Uses};
pub use formats::{FORMATS, format_of, options_for};
pub use options::{Column, Columns, Damage, FormatOption, OptionError, RecordingOptions, TimeUnit};
pub use read_report::{CounterWraps, ReadReport, RepairedTimes, StreamFaults, Truncation};
pub use reader::{Decode, EventReader, MAX_SENSOR_SIZE, Opened, RecordingInformation};
pub use recording::Recording;
pub use unsupported_format::UnsupportedFormat;
