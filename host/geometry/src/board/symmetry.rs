//! Rotations and reflections of a board after which it looks the same, which a camera alone cannot distinguish.

use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::Board;
use super::squares::SquareBoard;

/// A rotation of the board onto itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Symmetry {
    /// Maps positions on the board to positions where it looks the same (m).
    pub pose: Isometry3<f64>,
    /// For each point, the index of the point at whose position it arrives.
    pub points: Vec<u16>,
}

/// Largest distance of points that count as one, as a share of the board's longer side.
const RESOLUTION: f64 = 2e-4;

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

/// All that looks like the board itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Symmetries {
    /// Rotations about its normal, the identity first.
    pub rotations: Vec<Symmetry>,
    /// A reflection, if there is one; the others are its products with the rotations.
    pub reflection: Option<Reflection>,
}

impl Symmetries {
    /// Returns the symmetries of `board`.
    pub fn of(board: &Board) -> Self {
        Self { rotations: symmetries(board), reflection: reflection(board) }
    }
}

/// A reflection of the board onto itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflection {
    /// Its linear part, in the plane of the board.
    matrix: Matrix2<f64>,
    /// Centre of the board (m), which stays where it is.
    middle: Vector2<f64>,
}

impl Reflection {
    /// Returns the pose `T_board_camera` that a camera whose image is mirrored seems to have, if its true one is `pose`; up to a
    /// rotation of the camera about its line of sight.
    pub fn seen_in_a_mirror(&self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        let mut board = Matrix3::identity();
        board.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.matrix);
        let middle = Vector3::new(self.middle.x, self.middle.y, 0.0);
        let camera = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
        let rotation = board * pose.rotation.to_rotation_matrix().into_inner() * camera;
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let translation = middle + board * (pose.translation.vector - middle);
        Isometry3::from_parts(translation.into(), rotation)
    }
}

/// Returns a reflection of `board` onto itself, if there is one: then its image can be mirrored without looking wrong. Tags
/// show whether they are mirrored.
pub fn reflection(board: &Board) -> Option<Reflection> {
    if matches!(board, Board::Squares(SquareBoard::Tags(_) | SquareBoard::Charuco(_))) {
        return None;
    }
    let (low, high) = board.extent();
    let middle = 0.5 * (low + high);
    let points: Vec<_> = (0..board.point_count()).map(|index| board.point(index)).collect();
    let looks_the_same = |reflection: &Reflection| {
        points.iter().all(|point| {
            let place = middle + reflection.matrix * (point - middle);
            points.iter().any(|other| (other - place).norm() < RESOLUTION * board.longer_side())
        })
    };
    let matrices = [[-1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, -1.0], [0.0, 1.0, 1.0, 0.0], [0.0, -1.0, -1.0, 0.0]];
    let reflections = matrices.map(|[a, b, c, d]| Reflection { matrix: Matrix2::new(a, b, c, d), middle });
    reflections.into_iter().find(looks_the_same)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_that_are_their_own_mirror_image_are_known() {
        for (board, expected) in [
            ("acircles:9x4:55mm:r17.5mm", true),
            ("acircles:11x5:30mm:r8mm", true),
            ("acircles:6x4:55mm:r17.5mm", false),
            // As high as wide, and symmetric about its diagonal.
            ("acircles:8x4:55mm:r17.5mm", true),
            ("circles:5x7:40mm:r10mm", true),
            ("circles:6x6:40mm:r10mm", true),
            ("checkerboard:6x9:25mm", true),
            ("checkerboard:7x7:25mm", true),
            ("aprilgrid:6x6:35.2mm:0.3", false),
            ("charuco:5x7:30mm:22mm:DICT_5X5_100", false),
        ] {
            assert_eq!(reflection(&board.parse().unwrap()).is_some(), expected, "{board}");
        }
    }

    #[test]
    fn a_mirrored_image_shows_the_reflected_points_of_the_board() {
        let pose = Isometry3::new(Vector3::new(0.1, 0.2, -0.7), Vector3::new(0.2, -0.3, 0.4));
        for board in ["acircles:9x4:55mm:r17.5mm", "acircles:8x4:55mm:r17.5mm", "checkerboard:6x9:25mm"] {
            let board: Board = board.parse().unwrap();
            let mirrored = reflection(&board).unwrap().seen_in_a_mirror(&pose);
            assert!((mirrored.rotation.to_rotation_matrix().into_inner().determinant() - 1.0).abs() < 1e-9);
            let image = |pose: &Isometry3<f64>, sign: f64| {
                let point = |index| {
                    let seen = pose.inverse() * Point3::new(board.point(index).x, board.point(index).y, 0.0);
                    Vector2::new(sign * seen.x / seen.z, seen.y / seen.z)
                };
                (0..board.point_count()).map(point).collect::<Vec<_>>()
            };
            let (direct, flipped) = (image(&pose, -1.0), image(&mirrored, 1.0));
            assert!(direct.iter().all(|one| flipped.iter().any(|other| (one - other).norm() < 1e-9)));
        }
    }

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
