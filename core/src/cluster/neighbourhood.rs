//! The ε-neighbourhood on the pixel grid, row by row.

use super::ClusterSettings;
use super::bitmap::{Bitmap, MARGIN};

/// Half-widths of the rows of a disc of pixels: row ±dy reaches from -half_width(dy) to +half_width(dy).
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbourhood {
    half_widths: [u8; MARGIN + 1],
    radius: u8,
}

impl Neighbourhood {
    /// The disc of radius ε, clamped to 1…6.99 px. A NaN counts as 1.
    pub(super) fn new(settings: &ClusterSettings) -> Self {
        let largest = MARGIN as f32 + 0.99;
        let epsilon = if settings.epsilon >= 1.0 { settings.epsilon.min(largest) } else { 1.0 };
        let epsilon_squared = epsilon * epsilon;
        let mut half_widths = [0; MARGIN + 1];
        let mut radius = 0;
        for (dy, half_width) in (0_u8..).zip(half_widths.iter_mut()) {
            for dx in 0..=MARGIN as u8 {
                let distance_squared = u16::from(dx) * u16::from(dx) + u16::from(dy) * u16::from(dy);
                if f32::from(distance_squared) <= epsilon_squared {
                    *half_width = dx;
                    radius = dy;
                }
            }
        }
        Self { half_widths, radius }
    }

    /// Rows that the disc reaches up or down.
    pub(super) const fn radius(&self) -> usize {
        self.radius as usize
    }

    /// Half-width of the disc `dy` rows from its centre.
    #[inline(always)]
    pub(super) fn half_width(&self, dy: usize) -> usize {
        self.half_widths.get(dy).map_or(0, |&half_width| usize::from(half_width))
    }

    /// The pixels of `bitmap` in the row `dy` rows from `bit`, lowest bit first, from the leftmost of the disc.
    #[inline(always)]
    fn row<const ROW_BYTES: usize, const ROWS: usize>(
        &self,
        bitmap: &Bitmap<ROW_BYTES, ROWS>,
        row_bit: usize,
        dy: usize,
    ) -> u32 {
        let half_width = self.half_width(dy);
        bitmap.at(row_bit.wrapping_sub(half_width)) & ((2 << (2 * half_width)) - 1)
    }

    /// Number of pixels within the disc about `bit`, or a smaller number that is at least `enough`.
    #[inline(always)]
    pub(super) fn count<const ROW_BYTES: usize, const ROWS: usize>(
        &self,
        bitmap: &Bitmap<ROW_BYTES, ROWS>,
        bit: usize,
        enough: u32,
    ) -> u32 {
        let mut count = self.row(bitmap, bit, 0).count_ones();
        let mut below = bit;
        let mut above = bit;
        for dy in 1..=self.radius() {
            if count >= enough {
                break;
            }
            below = below.wrapping_add(Bitmap::<ROW_BYTES, ROWS>::ROW_BITS);
            above = above.wrapping_sub(Bitmap::<ROW_BYTES, ROWS>::ROW_BITS);
            count += self.row(bitmap, below, dy).count_ones() + self.row(bitmap, above, dy).count_ones();
        }
        count
    }

    /// The first pixel within the disc about `bit` in reading order, as its bit.
    #[inline(always)]
    pub(super) fn first<const ROW_BYTES: usize, const ROWS: usize>(
        &self,
        bitmap: &Bitmap<ROW_BYTES, ROWS>,
        bit: usize,
    ) -> Option<usize> {
        let radius = self.radius();
        let mut row_bit = bit.wrapping_sub(radius * Bitmap::<ROW_BYTES, ROWS>::ROW_BITS);
        for row in 0..=2 * radius {
            let dy = row.abs_diff(radius);
            let pixels = self.row(bitmap, row_bit, dy);
            if pixels != 0 {
                return Some(row_bit.wrapping_sub(self.half_width(dy)).wrapping_add(pixels.trailing_zeros() as usize));
            }
            row_bit = row_bit.wrapping_add(Bitmap::<ROW_BYTES, ROWS>::ROW_BITS);
        }
        None
    }
}
