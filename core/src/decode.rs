//! What a sensor sends, decoded word by word: for a microcontroller that has a sensor or a link at its pins.
//!
//! [`Words`] makes words of 32 bits from bytes that come in any cut (little-endian, as by default on the wire).
//!
//! | decoder | format |
//! |---|---|
//! | [`Evt2Decoder`] | Prophesee EVT 2.0: GenX320, IMX636 and others, words of 32 bits |
//! | [`Evt21Decoder`] | Prophesee EVT 2.1: the same in groups of 32 pixels, words of 64 bits |
//! | [`Evt3Decoder`] | Prophesee EVT 3.0: IMX636 and others, words of 16 bits |
//! | [`PackedDecoder`] | evcal's packed records: any other sensor, files of tests, words of 32 bits |
//!
//! Time in all is cut to a few bits and wraps; the decoders extend it to 64 bits. A clock that is set
//! back is followed: times go on from where they were, and it is counted.
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
mod packed;
#[cfg(test)]
mod tests;
mod words;

pub use evt::{EvtCounts, EvtRecord, EvtRecords, Trigger};
pub use evt2::{Evt2Decoder, Evt2Encoder, Evt2Words};
pub use evt3::Evt3Decoder;
pub use evt21::Evt21Decoder;
pub use packed::{PackedCounts, PackedDecoder, PackedEncoder, PackedWords};
pub use words::Words;

use core::fmt;

/// An event that a format has no room for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DoesNotFit;

impl fmt::Display for DoesNotFit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("the pixel lies outside of what the format can hold")
    }
}

impl core::error::Error for DoesNotFit {}
