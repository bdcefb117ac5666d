//! Prophesee EVT 4.0 (OpenEB 5.1).
//!
//! Words of 32 bits with the fields of EVT 2.0 and other types (bits 31–28):
//!
//! | type | word | bits |
//! |---|---|---|
//! | 0x9 | trigger | 27–22 time low, 12–8 channel, 0 value |
//! | 0xA, 0xB | event, OFF or ON | 27–22 time low, 21–11 column, 10–0 row |
//! | 0xC, 0xD | the same, followed by a word with a mask: bit n is set if the pixel n columns to the right has an event | |
//! | 0xE | time high | 27–0 microseconds / 64 |
//! | 0x6, 0x7 | other, continued | vendor specific |
//! | 0xF | padding | |

use super::DoesNotFit;
use super::evt::{EvtCounts, EvtRecord, EvtRecords};
use super::evt2::{Evt2Decoder, Evt2Encoder, Evt2Words};
use crate::event::Event;

const CONTENT: u32 = (1 << 28) - 1;

/// Decodes words to events and triggers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt4Decoder {
    same: Evt2Decoder,
    /// The first word of a vector, whose mask follows.
    vector: Option<u32>,
}

impl Evt4Decoder {
    /// Creates a decoder for the beginning of a stream, or any position in it.
    pub const fn new() -> Self {
        Self { same: Evt2Decoder::new(), vector: None }
    }

    /// Decodes the next word; returns its events or its trigger.
    #[inline]
    pub fn push(&mut self, word: u32) -> EvtRecords {
        if let Some(event) = self.vector.take() {
            return self.records(event, word);
        }
        let content = word & CONTENT;
        match word >> 28 {
            0x9 => self.records(0xa << 28 | content, 1),
            0xa => self.records(content, 1),
            0xb => self.records(1 << 28 | content, 1),
            kind @ (0xc | 0xd) => {
                self.vector = Some((kind & 1) << 28 | content);
                EvtRecords::none()
            }
            0xe => self.records(0x8 << 28 | content, 0),
            0x6 | 0x7 => self.records(0xe << 28, 0),
            0xf => EvtRecords::none(),
            // A type that EVT 2.0 does not define either.
            _ => self.records(0x2 << 28, 0),
        }
    }

    /// Returns the counts so far.
    pub const fn counts(&self) -> &EvtCounts {
        self.same.counts()
    }

    /// Decodes a word of EVT 2.0; the events of a vector have this mask.
    fn records(&mut self, word: u32, mask: u32) -> EvtRecords {
        match self.same.push(word) {
            Some(EvtRecord::Event(event)) => EvtRecords::events(event, mask),
            Some(EvtRecord::Trigger(trigger)) => EvtRecords::trigger(trigger),
            None => EvtRecords::none(),
        }
    }
}

/// Encodes events to words; writes a time high only when it changes. Vectors are not used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evt4Encoder {
    same: Evt2Encoder,
}

impl Evt4Encoder {
    /// Creates an encoder for the beginning of a stream.
    pub const fn new() -> Self {
        Self { same: Evt2Encoder::new() }
    }

    /// Returns the words of the next event, as [`Evt2Encoder::encode`] does.
    ///
    /// # Errors
    /// Returns an error if the column or row is beyond 2047.
    pub fn encode(&mut self, event: Event) -> Result<Evt2Words, DoesNotFit> {
        let mut words = self.same.encode(event)?;
        words.iter_mut().for_each(|word| *word = converted(*word));
        Ok(words)
    }

    /// Returns the time high of `time_us`, if it differs from the last one.
    pub fn time(&mut self, time_us: i64) -> Option<u32> {
        self.same.time(time_us).map(converted)
    }
}

/// Returns the word of EVT 4.0 for an event or time high of EVT 2.0.
const fn converted(word: u32) -> u32 {
    let kind = if word >> 28 == 0x8 { 0xe } else { 0xa | word >> 28 };
    kind << 28 | word & CONTENT
}
