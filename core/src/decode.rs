//! What a sensor sends, decoded word by word: for a microcontroller that has a sensor or a link at its pins.
//!
//! Both formats are streams of 32-bit words. [`Words`] makes them from bytes that come in any cut
//! (little-endian, as by default on the wire).
//!
//! | decoder | format |
//! |---|---|
//! | [`Evt2Decoder`] | Prophesee EVT 2.0: GenX320, IMX636 and others |
//! | [`PackedDecoder`] | evcal's packed records: any other sensor, files of tests |
//!
//! Time in both is cut to a few bits and wraps; the decoders extend it to 64 bits. A clock that is set
//! back is followed: times go on from where they were, and it is counted.
//!
//! ```
//! use evcal_core::decode::{Evt2Decoder, Evt2Record, Words};
//! use evcal_core::event::{Event, Polarity};
//!
//! // Time high 16 (times 64 µs), then an ON event 5 µs later at (3, 7).
//! let bytes = [0x10, 0x00, 0x00, 0x80, 0x07, 0x18, 0x40, 0x11];
//! let (mut words, mut decoder) = (Words::new(), Evt2Decoder::new());
//! let records: Vec<Evt2Record> = bytes
//!     .iter()
//!     .filter_map(|&byte| words.push(byte))
//!     .filter_map(|word| decoder.push(word))
//!     .collect();
//! assert_eq!(records, [Evt2Record::Event(Event { t: 1029, x: 3, y: 7, polarity: Polarity::On })]);
//! ```

mod evt2;
mod packed;
#[cfg(test)]
mod tests;
mod words;

pub use evt2::{Evt2Counts, Evt2Decoder, Evt2Encoder, Evt2Record, Evt2Words, Trigger};
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
