//! Prophesee EVT 2.1 (<https://docs.prophesee.ai/stable/data/encoding_formats/evt21.html>).
//!
//! Words of 64 bits. The upper half is a word of EVT 2.0; where that is an event, the lower half says which of the
//! pixels from its column on have one: bit n stands for the pixel n columns further to the right.
//!
//! Older cameras send the halves the other way round (`endianness=legacy` in the header of a file): rotate such words by
//! 32 bits.

use super::evt::{EvtCounts, EvtRecord, EvtRecords};
use super::evt2::Evt2Decoder;

/// Words to events and triggers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt21Decoder {
    upper: Evt2Decoder,
}

impl Evt21Decoder {
    /// At the beginning of a stream, or anywhere in it.
    pub const fn new() -> Self {
        Self { upper: Evt2Decoder::new() }
    }

    /// Takes the next word; hands out its events or its trigger.
    #[inline]
    pub fn push(&mut self, word: u64) -> EvtRecords {
        match self.upper.push((word >> 32) as u32) {
            Some(EvtRecord::Event(event)) => EvtRecords::events(event, word as u32),
            Some(EvtRecord::Trigger(trigger)) => EvtRecords::trigger(trigger),
            None => EvtRecords::none(),
        }
    }

    /// What was met so far.
    pub const fn counts(&self) -> &EvtCounts {
        self.upper.counts()
    }
}
