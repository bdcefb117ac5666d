//! Prophesee EVT 2.1 (<https://docs.prophesee.ai/stable/data/encoding_formats/evt21.html>).
//!
//! Words of 64 bits. The upper half is a word of EVT 2.0. If that word is an event, the lower half is a mask of pixels:
//! bit n is set if the pixel n columns to the right of the event's column has an event.
//!
//! Older cameras send the halves in the opposite order (`endianness=legacy` in the header of a file): rotate such words
//! by 32 bits.

use super::evt::{EvtCounts, EvtRecord, EvtRecords};
use super::evt2::Evt2Decoder;

/// Decodes words to events and triggers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt21Decoder {
    upper: Evt2Decoder,
}

impl Evt21Decoder {
    /// Creates a decoder for the beginning of a stream, or any position in it.
    pub const fn new() -> Self {
        Self { upper: Evt2Decoder::new() }
    }

    /// Decodes the next word; returns its events or its trigger.
    #[inline]
    pub fn push(&mut self, word: u64) -> EvtRecords {
        match self.upper.push((word >> 32) as u32) {
            Some(EvtRecord::Event(event)) => EvtRecords::events(event, word as u32),
            Some(EvtRecord::Trigger(trigger)) => EvtRecords::trigger(trigger),
            None => EvtRecords::none(),
        }
    }

    /// Returns the counts so far.
    pub const fn counts(&self) -> &EvtCounts {
        self.upper.counts()
    }
}
