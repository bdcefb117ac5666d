//! Bytes to words.

/// Puts 32-bit little-endian words together from bytes that come one by one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Words {
    word: u32,
    bytes: u8,
}

impl Words {
    /// At the beginning of a word.
    pub const fn new() -> Self {
        Self { word: 0, bytes: 0 }
    }

    /// Takes the next byte; a word if it was its fourth.
    #[inline]
    pub const fn push(&mut self, byte: u8) -> Option<u32> {
        self.word = (self.word >> 8) | ((byte as u32) << 24);
        self.bytes = (self.bytes + 1) & 3;
        if self.bytes == 0 { Some(self.word) } else { None }
    }

    /// Bytes of a word whose end has not come yet: 0 to 3.
    pub const fn pending(&self) -> u8 {
        self.bytes
    }
}
