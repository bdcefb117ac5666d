//! The layout of a printed circle grid, in lattice units.

/// Arrangement of the circles of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Every other row is shifted by half the distance of neighbours in a row
    /// (OpenCV's `CALIB_CB_ASYMMETRIC_GRID`).
    Asymmetric,
    /// A square lattice.
    Symmetric,
}

/// A circle grid of `rows` × `columns` circles, counted row by row from its first circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// Arrangement of the circles.
    pub layout: Layout,
    /// Number of rows, at least 2.
    pub rows: u8,
    /// Number of circles in a row, at least 2.
    pub columns: u8,
}

impl Pattern {
    /// Returns the number of circles on the board.
    pub const fn circle_count(&self) -> usize {
        self.rows as usize * self.columns as usize
    }

    /// Returns the lattice position (x, y) of circle `index`, in units of the board's spacing.
    ///
    /// Circle j of row i is at `(2 j + i mod 2, i)` on an asymmetric board (as in OpenCV, the spacing is half the
    /// distance of neighbours in a row), and at `(j, i)` on a symmetric one.
    pub const fn lattice_position(&self, index: usize) -> (i32, i32) {
        let columns = if self.columns == 0 { 1 } else { self.columns as usize };
        let row = (index / columns) as i32;
        let column = (index % columns) as i32;
        match self.layout {
            Layout::Asymmetric => (2 * column + row % 2, row),
            Layout::Symmetric => (column, row),
        }
    }

    /// Returns the index of the circle at lattice position (x, y), if there is one.
    pub const fn index_at(&self, x: i32, y: i32) -> Option<usize> {
        if x < 0 || y < 0 || y >= self.rows as i32 {
            return None;
        }
        let column = match self.layout {
            Layout::Asymmetric => {
                if (x - y % 2) % 2 != 0 || x < y % 2 {
                    return None;
                }
                (x - y % 2) / 2
            }
            Layout::Symmetric => x,
        };
        if column >= self.columns as i32 {
            return None;
        }
        Some(y as usize * self.columns as usize + column as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn index_and_position_are_inverse() {
        for layout in [Layout::Asymmetric, Layout::Symmetric] {
            let pattern = Pattern { layout, rows: 9, columns: 4 };
            for index in 0..pattern.circle_count() {
                let (x, y) = pattern.lattice_position(index);
                assert_eq!(pattern.index_at(x, y), Some(index));
            }
            assert_eq!(pattern.index_at(-1, 0), None);
            assert_eq!(pattern.index_at(0, 9), None);
        }
    }

    #[test]
    fn gaps_of_an_asymmetric_board_contain_no_circle() {
        let pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };
        assert_eq!(pattern.index_at(1, 0), None);
        assert_eq!(pattern.index_at(0, 1), None);
        assert_eq!(pattern.index_at(1, 1), Some(4));
        assert_eq!(pattern.index_at(8, 0), None);
    }
}
