//! Rotations of a board after which it looks the same, which a camera alone cannot distinguish.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::Board;

/// A rotation of the board onto itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Symmetry {
    /// Maps positions on the board to positions where it looks the same (m).
    pub pose: Isometry3<f64>,
    /// For each point, the index of the point at whose position it arrives.
    pub points: Vec<u16>,
}

/// Returns all rotations of `board` about its normal onto itself, the identity first.
pub fn symmetries(board: &Board) -> Vec<Symmetry> {
    let quarters = match board {
        Board::Circles(_) => &[0, 1, 2, 3],
        Board::Squares(squares) => squares.quarters(),
    };
    quarters.iter().filter_map(|&quarters| symmetry(board, quarters)).collect()
}

/// Returns the rotation by this multiple of 90°, if the board looks the same after it.
fn symmetry(board: &Board, quarters: u8) -> Option<Symmetry> {
    let (low, high) = board.extent();
    let middle = Vector3::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y), 0.0);
    let angle = f64::from(quarters) * std::f64::consts::FRAC_PI_2;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
    let pose = Isometry3::from_parts(Translation3::from(middle - turn * middle), turn);
    let points: Vec<_> = (0..board.point_count()).map(|index| board.point(index)).collect();
    let place = |point: &Vector2<f64>| {
        let turned = (pose * Point3::new(point.x, point.y, 0.0)).xy().coords;
        let other = points.iter().position(|other| (other - turned).norm() < 1e-6 * board.print_radius())?;
        u16::try_from(other).ok()
    };
    let points = points.iter().map(place).collect::<Option<_>>()?;
    Some(Symmetry { pose, points })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(board: &str) -> Vec<Symmetry> {
        symmetries(&board.parse().unwrap())
    }

    #[test]
    fn boards_with_an_odd_number_of_shifted_rows_have_no_symmetry() {
        for board in ["acircles:9x4:55mm:r17.5mm", "acircles:11x4:20mm:r5mm"] {
            let [none] = found(board).try_into().unwrap();
            assert_eq!(none.pose, Isometry3::identity());
            assert!(none.points.iter().enumerate().all(|(index, other)| index == usize::from(*other)));
        }
    }

    #[test]
    fn other_boards_are_symmetric_by_180_degrees_and_square_ones_by_90() {
        assert_eq!(found("acircles:10x4:55mm:r17.5mm").len(), 2);
        assert_eq!(found("circles:5x4:50mm:r15mm").len(), 2);
        assert_eq!(found("circles:5x5:50mm:r15mm").len(), 4);
    }

    #[test]
    fn circles_arrive_where_the_rotation_puts_them() {
        let board: Board = "circles:5x5:50mm:r15mm".parse().unwrap();
        for Symmetry { pose, points } in symmetries(&board) {
            for (index, other) in points.iter().enumerate() {
                let (from, to) = (board.point(index), board.point(usize::from(*other)));
                assert!((pose * Point3::new(from.x, from.y, 0.0) - Point3::new(to.x, to.y, 0.0)).norm() < 1e-12);
            }
        }
    }
}
