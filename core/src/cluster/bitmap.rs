//! One bit per pixel, with rows that can be read at any bit.

use crate::sensor::Sensor;

/// Empty columns at the right end of every row, so that a neighbourhood never reaches into the pixels of the next row.
/// Limits the half-width of a neighbourhood.
pub(super) const MARGIN: usize = 4;

/// Returns the bytes per row of a bitmap for a sensor `width` pixels wide.
///
/// The result is a multiple of four because rows are processed in words of 32 pixels.
pub const fn row_bytes(width: usize) -> usize {
    (width + MARGIN).div_ceil(32) * 4
}

/// Returns the rows of a bitmap for a sensor `height` pixels high: one empty row above and one below.
pub const fn row_count(height: usize) -> usize {
    height + 2
}

const fn saturating_u16(size: usize) -> u16 {
    if size > u16::MAX as usize { u16::MAX } else { size as u16 }
}

/// A bitmap of up to `ROW_BYTES * 8 - 4` columns and `ROWS - 2` rows.
///
/// A pixel is addressed by its *bit*: `ROW_BYTES * 8 * (y + 1) + x`.
#[derive(Debug)]
pub(super) struct Bitmap<const ROW_BYTES: usize, const ROWS: usize> {
    rows: [[u8; ROW_BYTES]; ROWS],
}

impl<const ROW_BYTES: usize, const ROWS: usize> Bitmap<ROW_BYTES, ROWS> {
    /// Distance in bits from a pixel to the pixel below it.
    pub(super) const ROW_BITS: usize = ROW_BYTES * 8;
    /// Largest supported sensor.
    pub(super) const CAPACITY: Sensor =
        Sensor::new(saturating_u16(Self::ROW_BITS.saturating_sub(MARGIN)), saturating_u16(ROWS.saturating_sub(2)));

    pub(super) const fn new() -> Self {
        Self { rows: [[0; ROW_BYTES]; ROWS] }
    }

    /// Returns the bit of pixel (x, y), which must lie within [`CAPACITY`](Self::CAPACITY).
    pub(super) const fn bit(x: usize, y: usize) -> usize {
        (y + 1) * Self::ROW_BITS + x
    }

    pub(super) fn set(&mut self, bit: usize) {
        if let Some(byte) = self.rows.as_flattened_mut().get_mut(bit / 8) {
            *byte |= 1 << (bit % 8);
        }
    }

    /// Returns the pixels from `bit` to the right, lowest bit first; at least 25 of them are valid.
    ///
    /// Pixels outside the bitmap are empty.
    #[inline(always)]
    pub(super) fn at(&self, bit: usize) -> u32 {
        let bytes = self.rows.as_flattened().get(bit / 8..).and_then(|bytes| bytes.first_chunk::<4>());
        match bytes {
            Some(bytes) => u32::from_le_bytes(*bytes) >> (bit % 8),
            None => 0,
        }
    }

    /// Returns the 32 pixels from `bit`, a multiple of 32.
    #[inline(always)]
    pub(super) fn word(&self, bit: usize) -> u32 {
        self.at(bit)
    }

    /// Replaces the 32 pixels from `bit`, a multiple of 32.
    #[inline(always)]
    pub(super) fn set_word(&mut self, bit: usize, word: u32) {
        let bytes = self.rows.as_flattened_mut().get_mut(bit / 8..).and_then(|bytes| bytes.first_chunk_mut::<4>());
        if let Some(bytes) = bytes {
            *bytes = word.to_le_bytes();
        }
    }
}

/// Record of the words of a bitmap that may contain pixels: one bit per group of words, one mask per row.
#[derive(Debug)]
pub(super) struct Touched<const ROW_BYTES: usize, const ROWS: usize> {
    rows: [u32; ROWS],
}

impl<const ROW_BYTES: usize, const ROWS: usize> Touched<ROW_BYTES, ROWS> {
    /// A group has 2^`GROUP_SHIFT` words, so that 32 groups cover a row.
    const GROUP_SHIFT: u32 = (ROW_BYTES / 4).div_ceil(32).next_power_of_two().ilog2();

    pub(super) const fn new() -> Self {
        Self { rows: [0; ROWS] }
    }

    pub(super) fn mark(&mut self, x: usize, y: usize) {
        if let Some(row) = self.rows.get_mut(y + 1) {
            *row |= 1 << ((x / 32) >> Self::GROUP_SHIFT & 31);
        }
    }

    pub(super) fn clear(&mut self) {
        self.rows = [0; ROWS];
    }

    /// Returns the rows above `height` with touched words, from the top.
    #[inline(always)]
    pub(super) fn rows(&self, height: u16) -> impl Iterator<Item = usize> + use<'_, ROW_BYTES, ROWS> {
        let rows = self.rows.get(1..=usize::from(height)).unwrap_or(&[]);
        rows.iter().enumerate().filter(|&(_, &groups)| groups != 0).map(|(y, _)| y)
    }

    /// Returns the bits at which the touched words of row `y` start, from left to right.
    #[inline(always)]
    pub(super) fn words(&self, y: usize) -> impl Iterator<Item = usize> + use<ROW_BYTES, ROWS> {
        let mut groups = self.rows.get(y + 1).copied().unwrap_or(0);
        let row_bit = (y + 1) * ROW_BYTES * 8;
        let words_per_group = 1 << Self::GROUP_SHIFT;
        let mut word = 0;
        core::iter::from_fn(move || {
            if word % words_per_group == 0 {
                if groups == 0 {
                    return None;
                }
                word = (groups.trailing_zeros() as usize) << Self::GROUP_SHIFT;
                groups &= groups - 1;
            }
            let bit = row_bit + word * 32;
            word += 1;
            Some(bit)
        })
    }
}

/// Returns the indices of the set bits of a word, from the lowest.
#[inline(always)]
pub(super) fn ones(mut word: u32) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        if word == 0 {
            return None;
        }
        let index = word.trailing_zeros() as usize;
        word &= word - 1;
        Some(index)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    type Small = Bitmap<{ row_bytes(60) }, { row_count(3) }>;

    #[test]
    fn capacity_covers_the_sensor_it_was_sized_for() {
        assert_eq!(Bitmap::<{ row_bytes(346) }, { row_count(260) }>::CAPACITY, Sensor::new(348, 260));
        let capacity = Bitmap::<{ row_bytes(320) }, { row_count(320) }>::CAPACITY;
        assert!(capacity.width >= 320 && capacity.height == 320);
    }

    #[test]
    fn bits_are_read_at_any_position_and_are_zero_outside() {
        let mut bitmap = Small::new();
        let width = usize::from(Small::CAPACITY.width);
        for x in 0..width {
            bitmap.set(Small::bit(x, 1));
            assert_eq!(bitmap.at(Small::bit(x, 1)) & 1, 1);
            assert_eq!(bitmap.at(Small::bit(0, 0)), 0);
            assert_eq!(bitmap.at(Small::bit(0, 2)), 0);
        }
        let beyond = Small::bit(width, 1);
        assert_eq!(bitmap.at(beyond) & ((1 << MARGIN) - 1), 0, "the margin stays empty");
        assert_eq!(bitmap.at(usize::MAX), 0);
        assert_eq!(bitmap.at(0_usize.wrapping_sub(Small::ROW_BITS)), 0);
    }

    #[test]
    fn touched_words_are_those_marked() {
        let mut touched = Touched::<{ row_bytes(1280) }, { row_count(4) }>::new();
        for x in [0, 31, 32, 700, 1279] {
            touched.mark(x, 2);
        }
        let words: Vec<usize> = touched.words(2).collect();
        let row_bit = 3 * row_bytes(1280) * 8;
        for x in [0, 32, 700, 1279] {
            assert!(words.contains(&(row_bit + x / 32 * 32)), "the word of column {x}");
        }
        assert!(words.is_sorted());
        assert_eq!(touched.words(1).count(), 0);
    }
}
