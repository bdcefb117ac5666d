//! The ε-neighbourhood on the pixel grid, row by row.

use super::ClusterSettings;
use super::bitmap::{Bitmap, MARGIN, ones};

/// Pixels in the widest row of a disc.
const WIDEST: usize = 2 * MARGIN + 1;

/// Half-widths of the rows of a disc of pixels: row ±dy reaches from -half_width(dy) to +half_width(dy).
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbourhood {
    rows: [DiscRow; MARGIN + 1],
    radius: usize,
}

/// Masks of 16 pixels: core pixels, and pixels without neighbours.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PixelNeighbours {
    pub(super) core: u32,
    pub(super) alone: u32,
}

/// A row of the disc.
#[derive(Clone, Copy, Debug, Default)]
struct DiscRow {
    half_width: usize,
    /// As many one bits as the row has pixels.
    mask: u32,
}

impl Neighbourhood {
    /// Returns the disc of radius ε, clamped to 1…4.99 px. A NaN counts as 1.
    pub(super) fn new(settings: &ClusterSettings) -> Self {
        let epsilon =
            if settings.epsilon >= 1.0 { settings.epsilon.min(ClusterSettings::LARGEST_EPSILON) } else { 1.0 };
        let epsilon_squared = epsilon * epsilon;
        let mut rows = [DiscRow::default(); MARGIN + 1];
        let mut radius = 0;
        for (dy, row) in rows.iter_mut().enumerate() {
            let squares = (0..=MARGIN).map(|dx| (dx, (dx * dx + dy * dy) as f32));
            if let Some((half_width, _)) = squares.take_while(|&(_, square)| square <= epsilon_squared).last() {
                *row = DiscRow { half_width, mask: (2 << (2 * half_width)) - 1 };
                radius = dy;
            }
        }
        Self { rows, radius }
    }

    /// Returns the number of rows that the disc reaches up or down.
    pub(super) const fn radius(&self) -> usize {
        self.radius
    }

    /// Returns the half-width of the disc `dy` rows from its centre.
    #[inline(always)]
    pub(super) fn half_width(&self, dy: usize) -> usize {
        self.rows.get(dy).map_or(0, |row| row.half_width)
    }

    /// Returns the pixels of `bitmap` in the row `dy` rows from `bit`, lowest bit first, starting at the leftmost of
    /// the disc.
    #[inline(always)]
    fn row<const ROW_BYTES: usize, const ROWS: usize>(
        &self,
        bitmap: &Bitmap<ROW_BYTES, ROWS>,
        row_bit: usize,
        dy: usize,
    ) -> u32 {
        let row = self.rows.get(dy).copied().unwrap_or_default();
        bitmap.at(row_bit.wrapping_sub(row.half_width)) & row.mask
    }

    /// Determines which of `pixels`, up to 16 starting at `bit`, have at least `enough` pixels of `bitmap` in their
    /// neighbourhood, and which have no neighbour but themselves.
    pub(super) fn judge<const ROW_BYTES: usize, const ROWS: usize>(
        &self,
        bitmap: &Bitmap<ROW_BYTES, ROWS>,
        bit: usize,
        pixels: u32,
        enough: u32,
    ) -> PixelNeighbours {
        let mut neighbours = PixelNeighbours::default();
        if pixels == 0 {
            return neighbours;
        }
        let row_bits = Bitmap::<ROW_BYTES, ROWS>::ROW_BITS;
        let [middle, next, ..] = self.rows;
        let next_bit = bit.wrapping_sub(next.half_width);
        let at = bitmap.at(bit.wrapping_sub(middle.half_width));
        let above = bitmap.at(next_bit.wrapping_sub(row_bits));
        let below = bitmap.at(next_bit.wrapping_add(row_bits));
        for index in ones(pixels) {
            // Three rows of at most 2 MARGIN + 1 pixels fit into a word, so one bit count covers all three.
            let near = at >> index & middle.mask
                | (above >> index & next.mask) << WIDEST
                | (below >> index & next.mask) << (2 * WIDEST);
            let mut count = near.count_ones();
            if count < enough {
                count += self.count_far(bitmap, bit + index, enough - count);
            }
            if count >= enough {
                neighbours.core |= 1 << index;
            } else if count == 1 {
                neighbours.alone |= 1 << index;
            }
        }
        neighbours
    }

    /// Returns the number of pixels within the disc about `bit` without its three middle rows, or a smaller number that
    /// is at least `enough`.
    fn count_far<const ROW_BYTES: usize, const ROWS: usize>(
        &self,
        bitmap: &Bitmap<ROW_BYTES, ROWS>,
        bit: usize,
        enough: u32,
    ) -> u32 {
        let row_bits = Bitmap::<ROW_BYTES, ROWS>::ROW_BITS;
        let (mut above, mut below) = (bit.wrapping_sub(row_bits), bit.wrapping_add(row_bits));
        let mut count = 0;
        for row in self.rows.iter().take(self.radius + 1).skip(2) {
            above = above.wrapping_sub(row_bits);
            below = below.wrapping_add(row_bits);
            let pixels = (bitmap.at(above.wrapping_sub(row.half_width)) & row.mask)
                | (bitmap.at(below.wrapping_sub(row.half_width)) & row.mask) << WIDEST;
            count += pixels.count_ones();
            if count >= enough {
                break;
            }
        }
        count
    }

    /// Returns the bit of the first pixel, in reading order, within the disc about `bit`.
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
