//! The ε-neighbourhood on the pixel grid, row by row.

use super::ClusterSettings;
use super::bitmap::{Bitmap, MARGIN};

/// Pixels in the widest row of a disc.
const WIDEST: usize = 2 * MARGIN + 1;

/// Half-widths of the rows of a disc of pixels: row ±dy reaches from -half_width(dy) to +half_width(dy).
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbourhood {
    half_widths: [u8; MARGIN + 1],
    radius: u8,
}

impl Neighbourhood {
    /// The disc of radius ε, clamped to 1…4.99 px. A NaN counts as 1.
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
        let row_bits = Bitmap::<ROW_BYTES, ROWS>::ROW_BITS;
        let row = |row_bit, dy| self.row(bitmap, row_bit, dy);
        let (mut above, mut below) = (bit.wrapping_sub(row_bits), bit.wrapping_add(row_bits));
        // Three rows of at most 2 MARGIN + 1 pixels fit into a word: one count for all.
        let mut count = (row(bit, 0) | row(above, 1) << WIDEST | row(below, 1) << (2 * WIDEST)).count_ones();
        for dy in 2..=self.radius() {
            if count >= enough {
                break;
            }
            above = above.wrapping_sub(row_bits);
            below = below.wrapping_add(row_bits);
            count += (row(above, dy) | row(below, dy) << WIDEST).count_ones();
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
