//! Decoders for the data words of event sensors, for a microcontroller that is connected to a sensor or a serial link.
//!
//! [`Words`] assembles 32-bit words from a byte stream (little-endian, as by default on the wire).
//!
//! | decoder | format |
//! |---|---|
//! | [`Evt2Decoder`] | Prophesee EVT 2.0: GenX320, IMX636 and others, words of 32 bits |
//! | [`Evt21Decoder`] | Prophesee EVT 2.1: the same in groups of 32 pixels, words of 64 bits |
//! | [`Evt3Decoder`] | Prophesee EVT 3.0: IMX636 and others, words of 16 bits |
//! | [`Evt4Decoder`] | Prophesee EVT 4.0: words of 32 bits |
//! | [`PackedDecoder`] | evcal's packed records: any other sensor, and test files, words of 32 bits |
//!
//! All formats truncate time to a few bits, which wrap; the decoders extend it to 64 bits. If the sensor's clock is
//! reset, the reset is counted and times continue from the last time.
//!
//! ```
//! use evcal_core::decode::{Evt2Decoder, EvtRecord, Words};
//! use evcal_core::event::{Event, Polarity};
//!
//! // Time high 16 (times 64 µs), then an ON event 5 µs later at (3, 7).
//! let bytes = [0x10, 0x00, 0x00, 0x80, 0x07, 0x18, 0x40, 0x11];
//! let (mut words, mut decoder) = (Words::new(), Evt2Decoder::new());
//! let records: Vec<EvtRecord> = bytes
//!     .iter()
//!     .filter_map(|&byte| words.push(byte))
//!     .filter_map(|word| decoder.push(word))
//!     .collect();
//! assert_eq!(records, [EvtRecord::Event(Event { t: 1029, x: 3, y: 7, polarity: Polarity::On })]);
//! ```

mod evt;
mod evt2;
mod evt21;
mod evt3;
mod evt4;
mod packed;
#[cfg(test)]
mod tests;
mod words;

pub use evt::{EvtCounts, EvtRecord, EvtRecords, Trigger};
pub use evt2::{Evt2Decoder, Evt2Encoder, Evt2Words};
pub use evt3::Evt3Decoder;
pub use evt4::{Evt4Decoder, Evt4Encoder};
pub use evt21::Evt21Decoder;
pub use packed::{PackedCounts, PackedDecoder, PackedEncoder, PackedWords};
pub use words::Words;

use core::fmt;

/// Error: an event does not fit into the format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DoesNotFit;

impl fmt::Display for DoesNotFit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("the pixel lies outside the range of the format")
    }
}

impl core::error::Error for DoesNotFit {}
