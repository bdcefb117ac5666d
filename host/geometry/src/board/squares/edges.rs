//! The straight edges between dark and light on a board of squares, and a search for the edge nearest to a point.

use nalgebra::Vector2;

use super::raster::Raster;

/// An axis of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Along the rows.
    X,
    /// From row to row.
    Y,
}

/// A side of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The side of lower coordinates.
    Low,
    /// The side of higher coordinates.
    High,
}

/// A straight piece of the border between dark and light; the widths of both sides are constant along it. Lengths in
/// metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// The axis that the edge is perpendicular to.
    pub across: Axis,
    /// Its coordinate on that axis.
    pub position: f64,
    /// Lowest and highest coordinate of the piece on the other axis.
    pub span: [f64; 2],
    /// Lowest and highest coordinate of the straight line that the piece belongs to, from one corner or crossing to the
    /// next.
    pub line: [f64; 2],
    /// The dark side.
    pub dark: Side,
    /// Width of the dark run of cells on the dark side, across the edge.
    pub dark_width: f64,
    /// Width of the light run of cells on the light side, across the edge; infinite outside the board.
    pub light_width: f64,
}

impl Edge {
    /// Returns points along the piece, close enough that a lens hardly bends it between two of them, in metres.
    pub(in crate::board) fn pieces(&self) -> Vec<Vector2<f64>> {
        const STEPS: usize = 8;
        let [start, end] = self.span;
        let point = |step: usize| {
            let along = start + (end - start) * step as f64 / STEPS as f64;
            match self.across {
                Axis::X => Vector2::new(self.position, along),
                Axis::Y => Vector2::new(along, self.position),
            }
        };
        (0..=STEPS).map(point).collect()
    }

    /// Returns the width of the narrower side in metres, which is the distance to the nearest parallel edge.
    pub fn width(&self) -> f64 {
        self.dark_width.min(self.light_width)
    }
}

/// All edges of a board, with a table that finds the edge nearest to a point at constant cost.
#[derive(Clone, Debug)]
pub struct SquareEdges {
    edges: Vec<Edge>,
    columns: Lines,
    rows: Lines,
    /// Row by row; the first and last column and row are outside the board.
    cells: Vec<Cell>,
    /// Corners and crossings that can be nearer to a point of a cell than its four edges.
    vertices: Vec<[f64; 2]>,
}

/// Marks the absence of an edge.
const NONE: u32 = u32::MAX;

/// The nearest edges on both sides of a cell along both axes.
#[derive(Clone, Copy, Debug)]
struct Cell {
    x: NearestEdges,
    y: NearestEdges,
    /// Range of its corners and crossings.
    first_vertex: u32,
    end_vertex: u32,
}

/// The nearest edges below and above a position along one axis.
#[derive(Clone, Copy, Debug)]
struct NearestEdges {
    low: u32,
    high: u32,
    /// Their coordinates; infinite if there is no edge.
    low_position: f64,
    high_position: f64,
    /// `true` if the cells between them are dark.
    is_dark: bool,
}

impl NearestEdges {
    const NOTHING: Self =
        Self { low: NONE, high: NONE, low_position: f64::NEG_INFINITY, high_position: f64::INFINITY, is_dark: false };

    /// Returns the edge whose light side is `light`, and its distance from `position` (m).
    #[inline(always)]
    fn lit(&self, light: Side, position: f64) -> Near {
        if self.is_dark == (light == Side::Low) {
            Near { edge: self.low, distance: position - self.low_position }
        } else {
            Near { edge: self.high, distance: self.high_position - position }
        }
    }

    /// Returns the distance from `position` to the nearer edge (m).
    #[inline(always)]
    fn distance(&self, position: f64) -> f64 {
        (position - self.low_position).min(self.high_position - position)
    }

    /// Returns the largest distance from a position in `range` to the nearer edge.
    fn reach(&self, range: [f64; 2]) -> f64 {
        let middle = 0.5 * (self.low_position + self.high_position);
        let [start, end] = range;
        let far = if middle.is_finite() {
            middle.clamp(start, end)
        } else if self.low == NONE {
            start
        } else {
            end
        };
        (far - self.low_position).min(self.high_position - far)
    }
}

#[derive(Clone, Copy, Debug)]
struct Near {
    edge: u32,
    distance: f64,
}

/// Lines along one axis, with a table of evenly spaced bins.
#[derive(Clone, Debug)]
pub struct Lines {
    lines: Vec<f64>,
    start: f64,
    bins_per_metre: f64,
    /// Number of lines that are certainly below a bin.
    below: Vec<u32>,
}

/// Largest number of bins of a table.
const MOST_BINS: f64 = 16384.0;

impl Lines {
    /// Creates the table of lines at these increasing coordinates, in metres.
    pub fn new(lines: &[f64]) -> Self {
        let start = lines.first().copied().unwrap_or(0.0);
        let length = lines.last().map_or(0.0, |last| last - start);
        let narrowest = lines.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
        let bins = (length / narrowest).ceil().clamp(1.0, MOST_BINS);
        let bins_per_metre = if length > 0.0 { bins / length } else { 0.0 };
        // Half a bin of margin, because rounding may put a position into a neighbouring bin.
        let below = |bin: u32| {
            let place = start + (f64::from(bin) - 0.5) / bins_per_metre;
            lines.partition_point(|line| *line < place) as u32
        };
        Self { lines: lines.to_vec(), start, bins_per_metre, below: (0..bins as u32).map(below).collect() }
    }

    /// Returns the coordinates in metres, increasing.
    #[inline(always)]
    pub fn positions(&self) -> &[f64] {
        &self.lines
    }

    /// Returns the number of lines at or below `place` (m).
    #[inline(always)]
    pub fn at_or_below(&self, place: f64) -> usize {
        let bin = (((place - self.start) * self.bins_per_metre) as usize).min(self.below.len().saturating_sub(1));
        let first = self.below.get(bin).map_or(0, |below| *below as usize);
        let is_below = |index: usize| self.lines.get(index).is_some_and(|line| *line <= place);
        // A bin and its margin contain at most two lines, unless `MOST_BINS` made the bins wider. Both lines are added
        // without branches, which would be mispredicted.
        let mut count = first + usize::from(is_below(first)) + usize::from(is_below(first + 1));
        while is_below(count) {
            count += 1;
        }
        count
    }

    /// Returns the lowest and highest coordinate of a cell; the first and the last cell are unbounded.
    fn range(&self, cell: usize) -> [f64; 2] {
        let line = |index: Option<usize>| index.and_then(|index| self.lines.get(index)).copied();
        [line(cell.checked_sub(1)).unwrap_or(f64::NEG_INFINITY), line(Some(cell)).unwrap_or(f64::INFINITY)]
    }

    /// Returns the indices of the lines strictly between two positions.
    fn between(&self, low: f64, high: f64) -> std::ops::Range<usize> {
        let start = self.lines.partition_point(|line| *line <= low);
        start..self.lines.partition_point(|line| *line < high).max(start)
    }
}

impl SquareEdges {
    /// Finds the edges of `raster`.
    pub fn new(raster: &Raster) -> Self {
        let mut edges = Vec::new();
        let x_edges = edges_across(raster, Axis::X, &mut edges);
        let y_edges = edges_across(raster, Axis::Y, &mut edges);
        let [columns, rows] = [raster.x_lines(), raster.y_lines()].map(Lines::new);
        let nearest_x = nearest_edges(&x_edges, &edges);
        let nearest_y = nearest_edges(&y_edges, &edges);
        let is_vertex = vertices(&x_edges, &edges);
        let mut found = Self { edges, columns, rows, cells: Vec::new(), vertices: Vec::new() };
        let (width, height) = (x_edges.lines, y_edges.lines);
        for row in 0..=height {
            for column in 0..=width {
                // Outside the board there are no crossing edges.
                let x = row.checked_sub(1).and_then(|band| nearest_x.get(band * (width + 1) + column));
                let y = column.checked_sub(1).and_then(|band| nearest_y.get(band * (height + 1) + row));
                let x = x.copied().unwrap_or(NearestEdges::NOTHING);
                let y = y.copied().unwrap_or(NearestEdges::NOTHING);
                let first_vertex = found.vertices.len() as u32;
                found.push_vertices([column, row], &x, &y, &is_vertex);
                let end_vertex = found.vertices.len() as u32;
                found.cells.push(Cell { x, y, first_vertex, end_vertex });
            }
        }
        found
    }

    /// Returns the edges: first the edges across x, line by line, then the edges across y.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// Returns the index of the edge nearest to `point` (metres on the board) whose light side is `light` (one side for
    /// edges across x, one for edges across y). Of the two edges that enclose a point along an axis, one is light on
    /// its low side and the other on its high side.
    ///
    /// Returns `None` in four cases:
    ///
    /// - the edge with the required light side along the other axis is less than `clearance` (m) farther away;
    /// - the foot of the perpendicular is less than `ends` (m, for edges across x and across y) from the end of the
    ///   straight line;
    /// - a corner is nearer than every edge;
    /// - the point is farther from the edge than the edge's narrower side is wide, for example off the board.
    #[inline]
    pub fn nearest(&self, point: [f64; 2], light: [Side; 2], clearance: f64, ends: [f64; 2]) -> Option<usize> {
        let [x, y] = point;
        let (column, row) = (self.columns.at_or_below(x), self.rows.at_or_below(y));
        let cell = self.cells.get(row * (self.columns.lines.len() + 1) + column)?;
        let (near_x, near_y) = (cell.x.lit(light[0], x), cell.y.lit(light[1], y));
        let is_x = near_x.distance <= near_y.distance;
        let index = if is_x { near_x.edge } else { near_y.edge } as usize;
        let (along, end) = if is_x { (y, ends[0]) } else { (x, ends[1]) };
        let (distance, other) = (near_x.distance.min(near_y.distance), near_x.distance.max(near_y.distance));
        let edge = self.edges.get(index)?;
        // Not `&&`, because its branches would be mispredicted.
        let is_clear = (other >= distance + clearance)
            & (along - edge.line[0] >= end)
            & (edge.line[1] - along >= end)
            & (distance <= edge.width());
        if !is_clear {
            return None;
        }
        let vertices = self.vertices.get(cell.first_vertex as usize..cell.end_vertex as usize)?;
        let nearest = cell.x.distance(x).min(cell.y.distance(y));
        let is_nearer = |[a, b]: &[f64; 2]| (a - x) * (a - x) + (b - y) * (b - y) < nearest * nearest;
        (!vertices.iter().any(is_nearer)).then_some(index)
    }

    /// Appends the vertices that can be nearer to a point of the cell than the edges `x` and `y` on its sides.
    fn push_vertices(&mut self, [column, row]: [usize; 2], x: &NearestEdges, y: &NearestEdges, is_vertex: &[bool]) {
        let [columns, rows] = [self.columns.range(column), self.rows.range(row)];
        let widths = [x.low, x.high, y.low, y.high].map(|edge| self.edges.get(edge as usize).map_or(0.0, Edge::width));
        let reach = x.reach(columns).min(y.reach(rows)).min(widths.into_iter().fold(0.0, f64::max));
        // A vertex on the line of one of these edges, or beyond it, is not nearer than the edge.
        let within = |range: [f64; 2], nearest: &NearestEdges| {
            [(range[0] - reach).max(nearest.low_position), (range[1] + reach).min(nearest.high_position)]
        };
        let ([x_low, x_high], [y_low, y_high]) = (within(columns, x), within(rows, y));
        let outside = |range: [f64; 2], place: f64| (range[0] - place).max(place - range[1]).max(0.0);
        for line_y in self.rows.between(y_low, y_high) {
            for line_x in self.columns.between(x_low, x_high) {
                let (Some(a), Some(b)) = (self.columns.lines.get(line_x), self.rows.lines.get(line_y)) else {
                    continue;
                };
                let is_near = outside(columns, *a).hypot(outside(rows, *b)) < reach;
                if is_near && is_vertex.get(line_y * self.columns.lines.len() + line_x) == Some(&true) {
                    self.vertices.push([*a, *b]);
                }
            }
        }
    }
}

/// The edges perpendicular to one axis, by position.
struct Across {
    /// Number of lines across the axis.
    lines: usize,
    /// Number of cells along the lines.
    bands: usize,
    /// Index of the edge on each line in each band, line by line, or [`NONE`].
    edges: Vec<u32>,
}

/// A change between dark and light.
#[derive(Clone, Copy, PartialEq)]
struct Change {
    dark: Side,
    dark_width: f64,
    light_width: f64,
}

/// Appends the edges perpendicular to `across`.
fn edges_across(raster: &Raster, across: Axis, edges: &mut Vec<Edge>) -> Across {
    let (lines, along) = match across {
        Axis::X => (raster.x_lines(), raster.y_lines()),
        Axis::Y => (raster.y_lines(), raster.x_lines()),
    };
    let bands = along.len().saturating_sub(1);
    let changes: Vec<Vec<Option<Change>>> = (0..bands).map(|band| changes(raster, across, band, lines)).collect();
    let mut places = Vec::with_capacity(lines.len() * bands);
    for (index, position) in lines.iter().enumerate() {
        // Index of the first edge of the straight line that ends at the current band.
        let mut first = edges.len();
        let mut before = None;
        for (band, ends) in along.windows(2).enumerate() {
            let change = changes.get(band).and_then(|changes| changes.get(index)).copied().flatten();
            places.push(match change {
                None => NONE,
                Some(Change { dark, dark_width, light_width }) => {
                    let span = [ends[0], ends[1]];
                    if before.map(|before: Change| before.dark) != Some(dark) {
                        first = edges.len();
                    }
                    let start = edges.get(first).map_or(span[0], |edge| edge.line[0]);
                    match edges.last_mut().filter(|_| before == change) {
                        Some(edge) => edge.span[1] = span[1],
                        None => edges.push(Edge {
                            across,
                            position: *position,
                            span,
                            line: [start, span[1]],
                            dark,
                            dark_width,
                            light_width,
                        }),
                    }
                    for edge in edges.iter_mut().skip(first) {
                        edge.line[1] = span[1];
                    }
                    edges.len() as u32 - 1
                }
            });
            before = change;
        }
    }
    Across { lines: lines.len(), bands, edges: places }
}

/// Returns the change at each of `lines` in one band of cells.
fn changes(raster: &Raster, across: Axis, band: usize, lines: &[f64]) -> Vec<Option<Change>> {
    let is_dark = |cell: Option<usize>| {
        cell.is_some_and(|cell| match across {
            Axis::X => raster.is_dark(cell, band),
            Axis::Y => raster.is_dark(band, cell),
        })
    };
    let places: Vec<(usize, f64)> = lines
        .iter()
        .copied()
        .enumerate()
        .filter(|(line, _)| is_dark(line.checked_sub(1)) != is_dark(Some(*line)))
        .collect();
    let mut all = vec![None; lines.len()];
    for (number, (line, position)) in places.iter().enumerate() {
        let low =
            number.checked_sub(1).and_then(|low| places.get(low)).map_or(f64::INFINITY, |(_, low)| position - low);
        let high = places.get(number + 1).map_or(f64::INFINITY, |(_, high)| high - position);
        let change = match is_dark(Some(*line)) {
            true => Change { dark: Side::High, dark_width: high, light_width: low },
            false => Change { dark: Side::Low, dark_width: low, light_width: high },
        };
        if let Some(place) = all.get_mut(*line) {
            *place = Some(change);
        }
    }
    all
}

/// Returns the nearest edges to each cell along the axis, band by band; the first and last cell of a band are outside
/// the board.
fn nearest_edges(across: &Across, edges: &[Edge]) -> Vec<NearestEdges> {
    let mut all = vec![NearestEdges::NOTHING; across.bands * (across.lines + 1)];
    let edge_at = |line: usize, band: usize| {
        let index = across.edges.get(line * across.bands + band).copied().unwrap_or(NONE);
        edges.get(index as usize).map(|edge| (index, edge.position))
    };
    for (band, cells) in all.chunks_mut(across.lines + 1).enumerate() {
        let mut last = (NONE, f64::NEG_INFINITY);
        for (line, cell) in cells.iter_mut().skip(1).enumerate() {
            last = edge_at(line, band).unwrap_or(last);
            (cell.low, cell.low_position) = last;
            cell.is_dark = edges.get(last.0 as usize).is_some_and(|edge| edge.dark == Side::High);
        }
        let mut next = (NONE, f64::INFINITY);
        for (line, cell) in cells.iter_mut().enumerate().take(across.lines).rev() {
            next = edge_at(line, band).unwrap_or(next);
            (cell.high, cell.high_position) = next;
        }
    }
    all
}

/// Returns `true` for each crossing of two lines, row by row, at which edges end.
fn vertices(x_edges: &Across, edges: &[Edge]) -> Vec<bool> {
    let edge_at = |line: usize, band: Option<usize>| {
        let index = band.filter(|band| *band < x_edges.bands).map(|band| line * x_edges.bands + band)?;
        edges.get(*x_edges.edges.get(index)? as usize).map(|edge| edge.dark)
    };
    let places = (0..=x_edges.bands).flat_map(|row| (0..x_edges.lines).map(move |line| (line, row)));
    places.map(|(line, row)| edge_at(line, row.checked_sub(1)) != edge_at(line, Some(row))).collect()
}

#[cfg(test)]
mod tests;
