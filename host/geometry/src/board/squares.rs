//! Printed boards of squares: checkerboards, grids of tags, ChArUco boards.
//!
//! Lengths are in metres. On the upright print x runs to the right and y downwards; z = 0 on the board. Kalibr's y and
//! z, upwards and out of the board, have the opposite sign.

mod codes;
pub mod edges;
pub mod family;
pub mod kalibr;
pub mod raster;
mod text;

use evcal_core::pattern::{Layout, Pattern};
use nalgebra::Vector2;

use self::family::Dictionary;
use self::raster::{Raster, Rectangle};
use super::tag::Tag;
pub use text::{SquareBoardError, SquareBoardProblem, names_squares};

/// A printed board of squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SquareBoard {
    /// Dark and light squares in turn.
    Checkerboard(Checkerboard),
    /// Tags in rows and columns.
    Tags(TagGrid),
    /// A checkerboard with tags in its light squares.
    Charuco(Charuco),
}

/// Shade of a part of the print.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shade {
    /// Black as printed.
    Dark,
    /// White as paper.
    Light,
}

/// A checkerboard. Its origin is the first inner corner, at the top left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checkerboard {
    /// Rows of inner corners; there is one more row of squares.
    pub rows: u8,
    /// Columns of inner corners; there is one more column of squares.
    pub columns: u8,
    /// Side of a square in metres.
    pub square: f64,
    /// Shade of the square at the top left. If one of `rows` and `columns` is odd and the other even, both shades
    /// describe the same board, rotated by 180°.
    pub first: Shade,
}

/// Numbering of the tags of a grid, along each row first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TagOrder {
    /// From the bottom row up, as in Kalibr. The origin is the outer corner of the bottom left tag, so y is negative.
    /// AprilTags are upright as printed by their authors.
    Upwards,
    /// From the top row down, as in OpenCV's `GridBoard`. The origin is the outer corner of the top left tag. AprilTags
    /// are rotated by 180° from upright, as drawn by OpenCV.
    Downwards,
}

/// Tags in rows and columns: Kalibr's AprilGrid, OpenCV's `GridBoard` and the like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TagGrid {
    /// Rows of tags.
    pub rows: u8,
    /// Columns of tags.
    pub columns: u8,
    /// Side of a tag with its dark border, in metres.
    pub tag: f64,
    /// Gap between neighbouring tags as a fraction of `tag`.
    pub spacing: f64,
    /// `true` if dark squares fill the crossings of the gaps, including the outer corners.
    pub corner_squares: bool,
    /// The tags.
    pub dictionary: Dictionary,
    /// Width of the tags' dark border in modules.
    pub border: u8,
    /// Id of the first tag.
    pub first_id: u16,
    /// Numbering of the tags.
    pub order: TagOrder,
    /// Number of quarter turns, clockwise on the print, by which each tag is rotated from the orientation that is usual for
    /// `order`.
    pub turn: u8,
}

/// Position of the tags on a ChArUco board with an even number of rows. With an odd number both layouts are equal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CharucoLayout {
    /// The square at the top left is dark, as in OpenCV from 4.6 on.
    Current,
    /// The square at the top left contains the first tag, as in OpenCV before 4.6 (opencv_contrib #3291).
    Legacy,
}

/// A ChArUco board. Its origin is the top left corner of the top left square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Charuco {
    /// Rows of squares. (OpenCV gives the columns first.)
    pub rows: u8,
    /// Columns of squares.
    pub columns: u8,
    /// Side of a square in metres.
    pub square: f64,
    /// Side of a tag with its dark border of one module, in metres.
    pub marker: f64,
    /// The tags.
    pub dictionary: Dictionary,
    /// Position of the tags.
    pub layout: CharucoLayout,
}

impl SquareBoard {
    /// Returns the points that a calibration uses, in metres on the board. Checkerboard: the inner corners row by row.
    /// Grid of tags: the tags' corners, row by row over the grid of 2 × rows by 2 × columns corners, as in Kalibr.
    /// ChArUco: the inner corners of the checkerboard in the order of OpenCV's ids.
    pub fn points(&self) -> Vec<Vector2<f64>> {
        (0..self.point_count()).map(|index| self.point(index)).collect()
    }

    /// Returns the tags in the order of their ids; a checkerboard has no tags.
    pub fn tags(&self) -> Vec<Tag> {
        match self {
            Self::Checkerboard(_) => Vec::new(),
            Self::Tags(grid) => grid.tags(),
            Self::Charuco(board) => board.tags(),
        }
    }

    /// Returns all dark and light parts of the board.
    pub fn raster(&self) -> Raster {
        let mut dark = match self {
            Self::Checkerboard(board) => {
                squares(board.rows + 1, board.columns + 1, board.first, [-board.square; 2], board.square)
            }
            Self::Tags(grid) => grid.corner_squares(),
            Self::Charuco(board) => squares(board.rows, board.columns, board.first(), [0.0; 2], board.square),
        };
        dark.extend(self.tags().iter().flat_map(dark_modules));
        Raster::of_dark(&dark)
    }

    /// Returns the rectangle that the board covers: all squares, or all tags with the corner squares.
    pub fn bounds(&self) -> Rectangle {
        let sides = |columns: u8, rows: u8, side: f64| [f64::from(columns) * side, f64::from(rows) * side];
        match self {
            Self::Checkerboard(board) => {
                Rectangle { low: [-board.square; 2], high: sides(board.columns, board.rows, board.square) }
            }
            Self::Tags(grid) => {
                let outside = if grid.corner_squares { grid.spacing * grid.tag } else { 0.0 };
                let high =
                    [grid.columns, grid.rows].map(|count| f64::from(count) * grid.period() - grid.spacing * grid.tag);
                Rectangle::between(grid.on_board([-outside; 2]), grid.on_board(high.map(|high| high + outside)))
            }
            Self::Charuco(board) => Rectangle { low: [0.0; 2], high: sides(board.columns, board.rows, board.square) },
        }
    }

    /// Returns the rotations about the normal, in multiples of 90°, after which the board looks the same.
    pub fn quarters(&self) -> &'static [u8] {
        match self {
            Self::Checkerboard(board) if (board.rows + board.columns) % 2 == 1 => &[0],
            Self::Checkerboard(board) if board.rows == board.columns && board.rows.is_multiple_of(2) => &[0, 1, 2, 3],
            Self::Checkerboard(_) => &[0, 2],
            _ => &[0],
        }
    }

    /// Returns the lattice on which the points lie, row by row in the order of their indices.
    pub fn lattice(&self) -> Pattern {
        let (rows, columns) = match self {
            Self::Checkerboard(board) => (board.rows, board.columns),
            Self::Tags(grid) => (2 * grid.rows, 2 * grid.columns),
            Self::Charuco(board) => (board.rows.saturating_sub(1), board.columns.saturating_sub(1)),
        };
        Pattern { layout: Layout::Symmetric, rows, columns }
    }

    /// Returns the number of points.
    pub fn point_count(&self) -> usize {
        self.lattice().circle_count()
    }

    /// Returns point `index` of [`points`](Self::points), in metres.
    pub fn point(&self, index: usize) -> Vector2<f64> {
        let columns = usize::from(self.lattice().columns).max(1);
        let [column, row] = [index % columns, index / columns].map(|index| index as u8);
        match self {
            Self::Checkerboard(board) => Vector2::new(f64::from(column), f64::from(row)) * board.square,
            Self::Tags(grid) => grid.on_board([grid.edge(column), grid.edge(row)]).into(),
            Self::Charuco(board) => Vector2::new(f64::from(column + 1), f64::from(row + 1)) * board.square,
        }
    }

    /// Returns the same board in another size: `length` is the side of a square in metres, or of a tag on a grid of tags.
    pub fn with_length(self, length: f64) -> Self {
        match self {
            Self::Checkerboard(board) => Self::Checkerboard(Checkerboard { square: length, ..board }),
            Self::Tags(grid) => Self::Tags(TagGrid { tag: length, ..grid }),
            Self::Charuco(board) => {
                Self::Charuco(Charuco { square: length, marker: board.marker / board.square * length, ..board })
            }
        }
    }

    /// Returns the side of a square of a checkerboard or of a module of a tag, whichever is smaller, in metres.
    pub fn module(&self) -> f64 {
        let modules =
            |dictionary: Dictionary, border: u8| (dictionary.family.inner_side() + 2 * usize::from(border)) as f64;
        match self {
            Self::Checkerboard(board) => board.square,
            Self::Tags(grid) => grid.tag / modules(grid.dictionary, grid.border),
            Self::Charuco(board) => board.marker / modules(board.dictionary, 1),
        }
    }
}

/// Returns the dark squares of a checkerboard with this many rows and columns of squares, whose first square begins at
/// `origin`.
fn squares(rows: u8, columns: u8, first: Shade, origin: [f64; 2], side: f64) -> Vec<Rectangle> {
    let parity = u8::from(first == Shade::Light);
    let at = |column: u8, row: u8| [origin[0] + f64::from(column) * side, origin[1] + f64::from(row) * side];
    (0..rows)
        .flat_map(|row| {
            (0..columns).filter(move |column| (column + row) % 2 == parity).map(move |column| (column, row))
        })
        .map(|(column, row)| Rectangle::between(at(column, row), at(column + 1, row + 1)))
        .collect()
}

/// Returns the dark modules of a tag.
fn dark_modules(tag: &Tag) -> Vec<Rectangle> {
    let [top_left, top_right, _, bottom_left] = tag.corners;
    let share = |module: usize| module as f64 / tag.side as f64;
    let at = |column: usize, row: usize| {
        std::array::from_fn(|axis| {
            top_left[axis]
                + share(column) * (top_right[axis] - top_left[axis])
                + share(row) * (bottom_left[axis] - top_left[axis])
        })
    };
    let dark = tag.light.iter().enumerate().filter(|(_, light)| !**light);
    dark.map(|(module, _)| {
        let (column, row) = (module % tag.side, module / tag.side);
        Rectangle::between(at(column, row), at(column + 1, row + 1))
    })
    .collect()
}

/// Returns the top left, top right, bottom right and bottom left corner of an upright tag whose lowest coordinates are
/// `low`.
fn upright(low: [f64; 2], side: f64) -> [[f64; 2]; 4] {
    let [x, y] = low;
    [[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
}

/// Returns the same corners, beginning with the corner that is the top left one of the tag's family as drawn by OpenCV.
fn as_opencv_draws(dictionary: Dictionary, [a, b, c, d]: [[f64; 2]; 4]) -> [[f64; 2]; 4] {
    match dictionary.family.is_april() {
        true => [c, d, a, b],
        false => [a, b, c, d],
    }
}

impl TagGrid {
    /// Returns the distance between the same edges of neighbouring tags, in metres.
    pub fn period(&self) -> f64 {
        (1.0 + self.spacing) * self.tag
    }

    /// Returns the coordinate of edge `index` of the tags along either axis; each tag has two edges.
    fn edge(&self, index: u8) -> f64 {
        f64::from(index / 2) * self.period() + f64::from(index % 2) * self.tag
    }

    /// Returns the position on the board at these distances from its origin along the rows and from row to row, in
    /// metres.
    fn on_board(&self, [along, across]: [f64; 2]) -> [f64; 2] {
        match self.order {
            TagOrder::Upwards => [along, -across],
            TagOrder::Downwards => [along, across],
        }
    }

    fn tags(&self) -> Vec<Tag> {
        let places = (0..self.rows).flat_map(|row| (0..self.columns).map(move |column| (column, row)));
        let tag = |((column, row), id): ((u8, u8), u16)| {
            let top = match self.order {
                TagOrder::Upwards => 2 * row + 1,
                TagOrder::Downwards => 2 * row,
            };
            let upright = upright(self.on_board([self.edge(2 * column), self.edge(top)]), self.tag);
            let mut corners = match self.order {
                TagOrder::Upwards => upright,
                TagOrder::Downwards => as_opencv_draws(self.dictionary, upright),
            };
            corners.rotate_left(usize::from(self.turn % 4));
            Some(Tag {
                id,
                corners,
                side: self.dictionary.family.inner_side() + 2 * usize::from(self.border),
                light: self.dictionary.family.light(id, self.border)?,
            })
        };
        places.zip(self.first_id..).filter_map(tag).collect()
    }

    /// Returns the squares in the crossings of the gaps, if the grid has them.
    fn corner_squares(&self) -> Vec<Rectangle> {
        let gap = self.spacing * self.tag;
        let at = |index: u8| f64::from(index) * self.period();
        let corners = (0..=self.rows).flat_map(|row| (0..=self.columns).map(move |column| (column, row)));
        let squares = corners.map(|(column, row)| {
            let high = [at(column), at(row)];
            Rectangle::between(self.on_board(high.map(|high| high - gap)), self.on_board(high))
        });
        squares.take(if self.corner_squares { usize::MAX } else { 0 }).collect()
    }
}

impl Charuco {
    /// Returns the shade of the square at the top left.
    fn first(&self) -> Shade {
        match self.layout {
            CharucoLayout::Legacy if self.rows.is_multiple_of(2) => Shade::Light,
            _ => Shade::Dark,
        }
    }

    /// Returns the number of tags.
    fn tag_count(&self) -> usize {
        let squares = usize::from(self.rows) * usize::from(self.columns);
        match self.first() {
            Shade::Dark => squares / 2,
            Shade::Light => squares.div_ceil(2),
        }
    }

    fn tags(&self) -> Vec<Tag> {
        let light = match self.first() {
            Shade::Dark => Shade::Light,
            Shade::Light => Shade::Dark,
        };
        let margin = 0.5 * (self.square - self.marker);
        let places = squares(self.rows, self.columns, light, [margin; 2], self.square);
        let tag = |(place, id): (Rectangle, u16)| {
            Some(Tag {
                id,
                corners: as_opencv_draws(self.dictionary, upright(place.low, self.marker)),
                side: self.dictionary.family.inner_side() + 2,
                light: self.dictionary.family.light(id, 1)?,
            })
        };
        places.into_iter().zip(0..).filter_map(tag).collect()
    }
}

#[cfg(test)]
mod tests;
