//! Assembly of words from bytes.

/// Assembles 32-bit little-endian words from single bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Words {
    word: u32,
    bytes: u8,
}

impl Words {
    /// Creates an assembler at the beginning of a word.
    pub const fn new() -> Self {
        Self { word: 0, bytes: 0 }
    }

    /// Adds the next byte; returns the word if this byte completes it.
    #[inline]
    pub const fn push(&mut self, byte: u8) -> Option<u32> {
        self.word = (self.word >> 8) | ((byte as u32) << 24);
        self.bytes = (self.bytes + 1) & 3;
        if self.bytes == 0 { Some(self.word) } else { None }
    }

    /// Returns the number of bytes of an incomplete word: 0 to 3.
    pub const fn pending(&self) -> u8 {
        self.bytes
    }
}
