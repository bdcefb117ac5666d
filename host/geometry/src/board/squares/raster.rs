//! A board as dark and light rectangles between lines.

/// Coordinates closer than this (m) are the same line, because one length computed in two ways differs by rounding.
const SAME_LINE: f64 = 1e-9;

/// A rectangle on the board with sides along its axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Lowest x and y in metres.
    pub low: [f64; 2],
    /// Highest x and y in metres.
    pub high: [f64; 2],
}

impl Rectangle {
    /// Returns the rectangle with these two opposite corners.
    pub fn between(one: [f64; 2], other: [f64; 2]) -> Self {
        let pick = |choose: fn(f64, f64) -> f64| std::array::from_fn(|axis| choose(one[axis], other[axis]));
        Self { low: pick(f64::min), high: pick(f64::max) }
    }
}

/// Dark and light cells between lines along x and y; everything outside is light.
#[derive(Clone, Debug, PartialEq)]
pub struct Raster {
    x: Vec<f64>,
    y: Vec<f64>,
    dark: Vec<bool>,
}

impl Raster {
    /// Creates the raster of a board whose dark parts are `rectangles`.
    pub fn of_dark(rectangles: &[Rectangle]) -> Self {
        let lines = |axis: usize| {
            let mut all: Vec<f64> =
                rectangles.iter().flat_map(|rectangle| [rectangle.low[axis], rectangle.high[axis]]).collect();
            all.sort_by(f64::total_cmp);
            all.dedup_by(|next, line| *next - *line < SAME_LINE);
            all
        };
        let (x, y) = (lines(0), lines(1));
        let columns = x.len().saturating_sub(1);
        let mut dark = vec![false; columns * y.len().saturating_sub(1)];
        let place = |lines: &[f64], value: f64| lines.partition_point(|line| *line < value - SAME_LINE);
        for Rectangle { low, high } in rectangles {
            let covered = place(&x, low[0])..place(&x, high[0]);
            for row in place(&y, low[1])..place(&y, high[1]) {
                let start = row * columns;
                if let Some(cells) = dark.get_mut(start + covered.start..start + covered.end) {
                    cells.fill(true);
                }
            }
        }
        Self { x, y, dark }
    }

    /// Returns the board with its dark parts widened by `further` (m) over all of their edges, or narrowed if it is
    /// negative.
    pub fn widened(&self, further: f64) -> Self {
        if further == 0.0 {
            return self.clone();
        }
        let moved = |lines: &[f64]| {
            let mut all: Vec<f64> = lines.iter().flat_map(|line| [line - further, line + further]).collect();
            all.sort_by(f64::total_cmp);
            all.dedup_by(|next, line| *next - *line < SAME_LINE);
            all
        };
        // For each new cell, the range of the old cells within `further` of its middle. These indices are one higher
        // than the raster's, because index 0 is the outside below the first line.
        let near = |moved: &[f64], lines: &[f64]| -> Vec<std::ops::RangeInclusive<usize>> {
            let cell = |place: f64| lines.partition_point(|line| *line <= place);
            let middle = |ends: &[f64]| 0.5 * (ends[0] + ends[1]);
            moved
                .windows(2)
                .map(|ends| cell(middle(ends) - further.abs())..=cell(middle(ends) + further.abs()))
                .collect()
        };
        let (x, y) = (moved(&self.x), moved(&self.y));
        let (columns, rows) = (near(&x, &self.x), near(&y, &self.y));
        let is_dark = |column: usize, row: usize| match (column.checked_sub(1), row.checked_sub(1)) {
            (Some(column), Some(row)) => self.is_dark(column, row),
            _ => false,
        };
        let shade = |columns: &std::ops::RangeInclusive<usize>, rows: &std::ops::RangeInclusive<usize>| {
            let mut cells = rows.clone().flat_map(|row| columns.clone().map(move |column| is_dark(column, row)));
            if further > 0.0 { cells.any(|dark| dark) } else { cells.all(|dark| dark) }
        };
        let dark = rows.iter().flat_map(|rows| columns.iter().map(move |columns| shade(columns, rows))).collect();
        Self { x, y, dark }
    }

    /// Returns the lines x = constant in metres, increasing.
    pub fn x_lines(&self) -> &[f64] {
        &self.x
    }

    /// Returns the lines y = constant in metres, increasing.
    pub fn y_lines(&self) -> &[f64] {
        &self.y
    }

    /// Returns the number of cells along x.
    pub fn columns(&self) -> usize {
        self.x.len().saturating_sub(1)
    }

    /// Returns the number of cells along y.
    pub fn rows(&self) -> usize {
        self.y.len().saturating_sub(1)
    }

    /// Returns `true` if the cell between lines `column` and `column + 1` of x and `row` and `row + 1` of y is dark.
    /// Cells outside are light.
    pub fn is_dark(&self, column: usize, row: usize) -> bool {
        column < self.columns() && self.dark.get(row * self.columns() + column).is_some_and(|dark| *dark)
    }

    /// Returns `true` if the board is dark at `point` (metres on the board).
    pub fn is_dark_at(&self, point: [f64; 2]) -> bool {
        let cell = |lines: &[f64], value: f64| lines.partition_point(|line| *line <= value).checked_sub(1);
        match (cell(&self.x, point[0]), cell(&self.y, point[1])) {
            (Some(column), Some(row)) => self.is_dark(column, row),
            _ => false,
        }
    }

    /// Returns the dark cells joined to rectangles that do not overlap.
    pub fn dark_rectangles(&self) -> Vec<Rectangle> {
        let mut done: Vec<Rectangle> = Vec::new();
        let mut open: Vec<Rectangle> = Vec::new();
        for (row, y) in self.y.windows(2).enumerate() {
            let mut current: Vec<Rectangle> = Vec::new();
            for (_, x) in self.x.windows(2).enumerate().filter(|(column, _)| self.is_dark(*column, row)) {
                match current.last_mut().filter(|last| last.high[0] == x[0]) {
                    Some(last) => last.high[0] = x[1],
                    None => current.push(Rectangle { low: [x[0], y[0]], high: [x[1], y[1]] }),
                }
            }
            // A rectangle of the previous row with the same sides continues.
            let mut ended = open.into_iter().peekable();
            for rectangle in &mut current {
                while let Some(above) = ended.next_if(|above| above.low[0] <= rectangle.low[0]) {
                    match above.low[0] == rectangle.low[0] && above.high[0] == rectangle.high[0] {
                        true => rectangle.low[1] = above.low[1],
                        false => done.push(above),
                    }
                }
            }
            done.extend(ended);
            open = current;
        }
        done.extend(open);
        done
    }
}
