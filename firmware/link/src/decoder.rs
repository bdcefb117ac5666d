//! Decodes bytes to messages.

use heapless::Vec;

use crate::frame::{MAX_CONTENT, MAX_FRAME, open};
use crate::message::Message;

/// Counts of a receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderCounts {
    /// Messages returned.
    pub frames: u32,
    /// Damaged frames: data between two zeros with a wrong CRC, too long or truncated.
    pub damaged: u32,
    /// Damaged frames before the first good one, because the receiver joined in the middle of the stream.
    pub damaged_at_start: u32,
    /// Numbers missing in the sequence, of frames that were damaged, lost in transmission or never sent.
    pub lost: u32,
    /// Good frames of an unknown kind, from a newer sender.
    pub unknown: u32,
    /// Good frames with an invalid body, caused by an error of the sender.
    pub malformed: u32,
    /// Number of restarts of the sender.
    pub restarts: u32,
}

/// Finds the messages in a stream of bytes that may be damaged, truncated, or joined at any byte.
#[derive(Clone, Debug)]
pub struct Decoder {
    /// Bytes since the last zero.
    coded: Vec<u8, MAX_FRAME>,
    too_long: bool,
    /// Number of the next frame; `None` before the first frame.
    expected: Option<u16>,
    counts: DecoderCounts,
}

/// A larger number of missing frames indicates that the sender was restarted.
const MOST_LOST: u16 = 0x8000;

impl Decoder {
    /// Creates a decoder for the beginning of a stream, or any position in it.
    pub const fn new() -> Self {
        Self { coded: Vec::new(), too_long: false, expected: None, counts: COUNTS }
    }

    /// Decodes the next byte; returns a message if the byte completes one.
    pub fn push(&mut self, byte: u8) -> Option<Message> {
        if byte != 0 {
            self.too_long |= self.coded.push(byte).is_err();
            return None;
        }
        if self.coded.is_empty() {
            return None;
        }
        let message = self.finish();
        self.coded.clear();
        self.too_long = false;
        message
    }

    /// Returns the number of bytes of an incomplete frame, 0 between frames.
    pub fn pending(&self) -> usize {
        self.coded.len()
    }

    /// Returns the counts so far.
    pub const fn counts(&self) -> &DecoderCounts {
        &self.counts
    }

    fn finish(&mut self) -> Option<Message> {
        let mut room: Vec<u8, MAX_CONTENT> = Vec::new();
        let content = if self.too_long { None } else { open(&self.coded, &mut room) };
        let Some(content) = content else {
            let damaged = match self.expected {
                Some(_) => &mut self.counts.damaged,
                None => &mut self.counts.damaged_at_start,
            };
            *damaged = damaged.saturating_add(1);
            return None;
        };
        let message = Message::read_body(content.kind, content.body);
        let first = matches!(&message, Ok(Some(Message::Hello(hello))) if hello.first);
        self.follow(content.sequence, first);
        let (count, message) = match message {
            Ok(Some(message)) => (&mut self.counts.frames, Some(message)),
            Ok(None) => (&mut self.counts.unknown, None),
            Err(_) => (&mut self.counts.malformed, None),
        };
        *count = count.saturating_add(1);
        message
    }

    /// Compares a sequence number with the expected one.
    fn follow(&mut self, sequence: u16, first: bool) {
        if let Some(expected) = self.expected {
            let missing = sequence.wrapping_sub(expected);
            if first || missing >= MOST_LOST {
                self.counts.restarts = self.counts.restarts.saturating_add(1);
            } else {
                self.counts.lost = self.counts.lost.saturating_add(u32::from(missing));
            }
        }
        self.expected = Some(sequence.wrapping_add(1));
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

const COUNTS: DecoderCounts =
    DecoderCounts { frames: 0, damaged: 0, damaged_at_start: 0, lost: 0, unknown: 0, malformed: 0, restarts: 0 };
