//! Encodes messages to frames.

use crate::frame::{Frame, HEADER, MAX_CONTENT, seal};
use crate::message::Message;

/// Numbers messages and puts them into frames.
#[derive(Clone, Debug, Default)]
pub struct Encoder {
    sequence: u16,
}

impl Encoder {
    /// Creates an encoder; the first message gets number 0.
    pub const fn new() -> Self {
        Self { sequence: 0 }
    }

    /// Returns the next frame.
    ///
    /// If the frame is then not sent because the output is full, the receiver counts it as lost, because the next frame
    /// has a higher number.
    pub fn encode(&mut self, message: &Message) -> Frame {
        let mut content = [0; MAX_CONTENT - 4];
        let [low, high] = self.sequence.to_le_bytes();
        self.sequence = self.sequence.wrapping_add(1);
        let Some((header, body)) = content.split_first_chunk_mut::<HEADER>() else { return Frame::new() };
        *header = [low, high, message.kind()];
        // No message is too long, as tests show; if one were, the receiver would count it as lost.
        let length = message.write_body(body).map(|length| length.saturating_add(HEADER));
        length.and_then(|length| content.get(..length)).and_then(seal).unwrap_or_default()
    }
}
