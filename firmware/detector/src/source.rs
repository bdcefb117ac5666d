//! Decodes the bytes of a sensor to events.

use evcal_core::decode::{Evt2Decoder, EvtRecord, PackedDecoder, Words};
use evcal_core::event::Event;

/// Decodes the stream of a sensor, byte by byte.
///
/// A device that receives whole words, or supports one format only, uses the decoders of [`evcal_core::decode`]
/// instead.
#[derive(Clone, Debug)]
pub struct Source {
    words: Words,
    decoder: Decoder,
}

#[derive(Clone, Debug)]
enum Decoder {
    Evt2(Evt2Decoder),
    Packed(PackedDecoder),
}

impl Source {
    /// Creates a source for Prophesee EVT 2.0.
    pub const fn evt2() -> Self {
        Self { words: Words::new(), decoder: Decoder::Evt2(Evt2Decoder::new()) }
    }

    /// Creates a source for packed 32-bit records.
    pub const fn packed() -> Self {
        Self { words: Words::new(), decoder: Decoder::Packed(PackedDecoder::new()) }
    }

    /// Decodes the next byte; returns an event if the byte completes one.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Event> {
        let word = self.words.push(byte)?;
        self.push_word(word)
    }

    /// Decodes the next word, for a device that receives whole words.
    #[inline]
    pub fn push_word(&mut self, word: u32) -> Option<Event> {
        match &mut self.decoder {
            Decoder::Evt2(decoder) => match decoder.push(word)? {
                EvtRecord::Event(event) => Some(event),
                _ => None,
            },
            Decoder::Packed(decoder) => decoder.push(word),
        }
    }

    /// Returns the number of event words so far that produced no event, for [`Pipeline::count_undecodable`].
    ///
    /// [`Pipeline::count_undecodable`]: crate::Pipeline::count_undecodable
    pub const fn undecodable(&self) -> u32 {
        match &self.decoder {
            Decoder::Evt2(decoder) => {
                let counts = decoder.counts();
                counts.without_time.saturating_add(counts.unknown)
            }
            Decoder::Packed(decoder) => decoder.counts().before_time,
        }
    }
}
