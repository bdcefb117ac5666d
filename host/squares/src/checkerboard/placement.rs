//! Position of a lattice of corners on a checkerboard that is cut by the border of the picture.
//!
//! At an end of the board, the outer squares have corners on the line of the lattice that follows the last inner
//! corners. One quadrant of such a corner differs from the other three, which shows that the line is an end of the
//! board. If one end is visible along each direction, or both ends with the right number of corners between them, the
//! position is certain.

use evcal_geometry::board::homography::homography;
use nalgebra::Vector2;

use crate::saddles::{Saddle, SaddleTest};

/// The position of a lattice point is predicted from corners at most this many steps away, if there are enough of them.
const NEIGHBOURHOOD: i32 = 3;
const LEAST_NEIGHBOURS: usize = 6;
/// A line is an end of the board if at least this number, and this fraction, of its visible lattice points are corners
/// of outer squares.
const LEAST_OUTER: usize = 3;
const LEAST_OUTER_PART: f64 = 0.6;

/// A corner at its lattice point; the rotation from u to v has the same sense as from x to y.
#[derive(Clone, Copy)]
pub(super) struct LatticeCorner {
    pub u: i32,
    pub v: i32,
    pub saddle: Saddle,
}

/// A direction of the lattice with the ends of the board.
struct Direction {
    /// Smallest and largest coordinate of a corner.
    first: i32,
    last: i32,
    /// `true` if the line before the first, or after the last, is an end of the board.
    begins: bool,
    ends: bool,
}

impl Direction {
    /// Returns the same direction, reversed.
    fn reversed(&self) -> Self {
        Self { first: -self.last, last: -self.first, begins: self.ends, ends: self.begins }
    }

    /// Returns the coordinate of the board's first line, if the board has `count` of them.
    fn origin(&self, count: i32) -> Option<i32> {
        let visible = self.last - self.first + 1;
        match (self.begins, self.ends) {
            (false, false) => None,
            _ if visible == count => Some(self.first),
            _ if visible > count => None,
            (true, false) => Some(self.first),
            (false, true) => Some(self.last - count + 1),
            (true, true) => None,
        }
    }
}

/// Position of a lattice on the board, according to the visible ends.
pub(super) enum Placement {
    /// The corners by index, up to a rotation by 180°.
    Certain(Vec<(usize, Saddle)>),
    /// All four ends are visible, and the board has other numbers of corners.
    OtherSize { rows: usize, columns: usize },
    /// Too few ends are visible.
    Uncertain,
}

/// Determines the position of a lattice on a board of `rows` × `columns` corners.
pub(super) fn place_by_ends(corners: &[LatticeCorner], rows: u8, columns: u8, test: &SaddleTest) -> Placement {
    let Some([u, v]) = directions(corners, test) else { return Placement::Uncertain };
    let (rows, columns) = (i32::from(rows), i32::from(columns));
    let counts = [&u, &v].map(|direction| direction.last - direction.first + 1);
    let all_ends = [&u, &v].iter().all(|direction| direction.begins && direction.ends);
    if all_ends && counts != [rows, columns] && counts != [columns, rows] {
        let [a, b] = counts.map(|count| count.unsigned_abs() as usize);
        return Placement::OtherSize { rows: a.min(b), columns: a.max(b) };
    }
    placed(corners, &u, &v, rows, columns).map_or(Placement::Uncertain, Placement::Certain)
}

/// Returns the two directions of a lattice with the ends of the board.
fn directions(corners: &[LatticeCorner], test: &SaddleTest) -> Option<[Direction; 2]> {
    let mut strengths: Vec<f32> = corners.iter().map(|corner| corner.saddle.strength).collect();
    strengths.sort_by(f32::total_cmp);
    let contrast = *strengths.get(strengths.len() / 2)?;
    let is_end = |places: Vec<[i32; 2]>| {
        let pixels =
            places.into_iter().filter_map(|place| predicted(corners, place)).filter(|pixel| test.covers(*pixel));
        let outer: Vec<bool> = pixels.map(|pixel| test.is_outer_corner(pixel, contrast)).collect();
        let count = outer.iter().filter(|outer| **outer).count();
        count >= LEAST_OUTER && count as f64 >= LEAST_OUTER_PART * outer.len() as f64
    };
    let u = corners.iter().map(|corner| corner.u);
    let v = corners.iter().map(|corner| corner.v);
    let (first_u, last_u, first_v, last_v) = (u.clone().min()?, u.max()?, v.clone().min()?, v.max()?);
    let beyond_u = |line: i32| (first_v..=last_v).map(|v| [line, v]).collect();
    let beyond_v = |line: i32| (first_u..=last_u).map(|u| [u, line]).collect();
    let u = Direction {
        first: first_u,
        last: last_u,
        begins: is_end(beyond_u(first_u - 1)),
        ends: is_end(beyond_u(last_u + 1)),
    };
    let v = Direction {
        first: first_v,
        last: last_v,
        begins: is_end(beyond_v(first_v - 1)),
        ends: is_end(beyond_v(last_v + 1)),
    };
    Some([u, v])
}

/// Returns the corners by index, if the ends of the board determine its position.
fn placed(
    corners: &[LatticeCorner],
    u: &Direction,
    v: &Direction,
    rows: i32,
    columns: i32,
) -> Option<Vec<(usize, Saddle)>> {
    let upright = u.origin(columns).zip(v.origin(rows));
    // After a rotation by 90° v runs along the rows and u against the columns.
    let turned = v.origin(columns).zip(u.reversed().origin(rows));
    let place = |corner: &LatticeCorner| match (upright, turned) {
        (Some((x, y)), None) => Some([corner.u - x, corner.v - y]),
        (None, Some((x, y))) => Some([corner.v - x, -corner.u - y]),
        _ => None,
    };
    let indexed = corners.iter().map(|corner| {
        let [x, y] = place(corner)?;
        let inside = (0..columns).contains(&x) && (0..rows).contains(&y);
        inside.then_some(((y * columns + x) as usize, corner.saddle))
    });
    let mut indexed = indexed.collect::<Option<Vec<(usize, Saddle)>>>()?;
    indexed.sort_by_key(|corner| corner.0);
    Some(indexed)
}

/// Predicts the pixel of a lattice point from the corners around it.
fn predicted(corners: &[LatticeCorner], [u, v]: [i32; 2]) -> Option<[f32; 2]> {
    let near = |corner: &&LatticeCorner| (corner.u - u).abs().max((corner.v - v).abs()) <= NEIGHBOURHOOD;
    let near: Vec<&LatticeCorner> = corners.iter().filter(near).collect();
    if near.len() < LEAST_NEIGHBOURS {
        return None;
    }
    let plane: Vec<Vector2<f64>> = near.iter().map(|corner| Vector2::new(corner.u.into(), corner.v.into())).collect();
    let image: Vec<Vector2<f64>> = near.iter().map(|corner| Vector2::from(corner.saddle.pixel).cast()).collect();
    let image = homography(&plane, &image)? * Vector2::new(f64::from(u), f64::from(v)).push(1.0);
    Some([(image.x / image.z) as f32, (image.y / image.z) as f32])
}
