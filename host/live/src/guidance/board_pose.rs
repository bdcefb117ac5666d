//! Poses of the board in front of the camera, and candidates for the guidance.

use std::f64::consts::FRAC_PI_2;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use evcal_geometry::board::{Board, SquareBoard};
use evcal_geometry::numerics::random::normal;
use evcal_solve::initial::information::{Information, view_information};

/// Apparent sizes of the board: ratio of its longer side to the sensor's shorter side.
const SIZES: [f64; 5] = [0.47, 0.62, 0.8, 1.0, 1.24];
/// Positions in the image in each direction, relative to the middle, as fractions of the sensor.
const OFFSETS: [f64; 5] = [-0.4, -0.2, 0.0, 0.2, 0.4];
/// Tilts about the camera's x and y axes in degrees.
const TILTS: [[f64; 2]; 13] = [
    [0.0, 0.0],
    [25.0, 0.0],
    [-25.0, 0.0],
    [0.0, 25.0],
    [0.0, -25.0],
    [43.0, 0.0],
    [-43.0, 0.0],
    [0.0, 43.0],
    [0.0, -43.0],
    [23.0, 23.0],
    [-23.0, 23.0],
    [23.0, -23.0],
    [-23.0, -23.0],
];
/// Rotations about the camera's axis.
const ROLLS: [f64; 2] = [0.0, FRAC_PI_2];
/// From twice this number of candidates on, only every third (fifth, …) is kept.
const MOST_CANDIDATES: usize = 180;
/// Standard deviations of a person's hands from the target pose, in radians and metres.
const HAND_TURN: f64 = 0.12;
const HAND_SHIFT: f64 = 0.025;
/// Number of poses over which a candidate is averaged.
const JITTERS: usize = 8;
/// Smallest semi-minor axis of a circle's image that the detector finds (px).
const SMALLEST_RADIUS: f64 = 1.6;
/// Smallest fraction of the board's circles in the image.
const SHARE_IN_IMAGE: f64 = 2.0 / 3.0;
/// A point this near to the end of the board's extent is in the first or last row or column (m).
const SAME_END: f64 = 1e-9;
/// Cosine of the largest angle between the board's normal and the line of sight.
const STEEPEST: f64 = 0.5;

/// A pose of the board, with parameters that a person understands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardPose {
    /// The board's middle in camera coordinates (m).
    pub position: Vector3<f64>,
    /// Tilt as a rotation vector about the camera's x and y axes (rad).
    pub tilt: Vector2<f64>,
    /// Rotation about the camera's axis before the tilt (rad).
    pub roll: f64,
}

impl BoardPose {
    /// Returns `T_camera_world` of the board.
    pub fn pose(&self, board: &Board) -> Isometry3<f64> {
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(self.tilt.x, self.tilt.y, 0.0));
        let rotation = tilt * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.roll);
        let middle = board.middle();
        let shift = self.position - rotation * Vector3::new(middle.x, middle.y, 0.0);
        Isometry3::from_parts(Translation3::from(shift), rotation)
    }
}

/// Returns the circles or corners (board plane, m) that a detector would find with the board at `pose`. Returns `None`
/// if a single window does not determine the position of the board: if the image cuts off the first or the last row or
/// column, the board could be shifted by a row ([`evcal_core::grid`]).
pub fn visible(
    camera: &Camera<f64>,
    board: &Board,
    sensor: Sensor,
    pose: &Isometry3<f64>,
) -> Option<Vec<Vector2<f64>>> {
    // Every tag identifies its position.
    let is_lattice = matches!(board, Board::Circles(_) | Board::Squares(SquareBoard::Checkerboard(_)));
    in_image(camera, board, sensor, pose).filter(|points| !is_lattice || reach_all_ends(points, board))
}

fn reach_all_ends(circles: &[Vector2<f64>], board: &Board) -> bool {
    let (low, high) = board.extent();
    let first = circles.iter().fold(high, |first, circle| first.inf(circle));
    let last = circles.iter().fold(low, |last, circle| last.sup(circle));
    (first - low).amax() < SAME_END && (high - last).amax() < SAME_END
}

/// Returns the circles or corners (board plane, m) that a detector would find with the board at `pose`, if earlier
/// windows determine its position; `None` if too few are in the image, or the board is too small or too steep.
pub fn in_image(
    camera: &Camera<f64>,
    board: &Board,
    sensor: Sensor,
    pose: &Isometry3<f64>,
) -> Option<Vec<Vector2<f64>>> {
    let focal = camera.parameters().first().copied()?;
    let normal = pose.rotation * Vector3::z();
    let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
    let mut circles = Vec::new();
    for index in 0..board.point_count() {
        let center = board.point(index);
        let seen = (pose * Point3::new(center.x, center.y, 0.0)).coords;
        let radius = focal * board.print_radius() / seen.z;
        let across = normal.dot(&seen) / seen.norm();
        if seen.z <= 0.0 || across < STEEPEST || across * radius < SMALLEST_RADIUS {
            return None;
        }
        let inside = |pixel: Vector2<f64>| {
            pixel.x > radius && pixel.x < width - 1.0 - radius && pixel.y > radius && pixel.y < height - 1.0 - radius
        };
        if camera.project(&seen).is_some_and(inside) {
            circles.push(center);
        }
    }
    (circles.len() as f64 >= SHARE_IN_IMAGE * board.point_count() as f64).then_some(circles)
}

/// A candidate pose with its information.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The pose.
    pub place: BoardPose,
    /// Information of one window there, averaged over the typical errors of a person's hands.
    pub information: Information,
}

/// Returns the information about `camera` of one window with the board near `place`: the mean over poses as reached by
/// a person's hands, zero for those in which the board would not be found.
pub fn expected_information(camera: &Camera<f64>, board: &Board, sensor: Sensor, place: &BoardPose) -> Information {
    // The same errors of the hands for every pose, so that poses can be compared.
    let mut hands = ChaCha8Rng::seed_from_u64(1);
    let mut sum = Information::zeros();
    for _ in 0..JITTERS {
        let mut shaken = || normal(&mut hands);
        let tilt = place.tilt + Vector2::new(shaken(), shaken()) * HAND_TURN;
        let roll = place.roll + shaken() * HAND_TURN;
        let position = place.position + Vector3::new(shaken(), shaken(), shaken()) * HAND_SHIFT;
        let pose = BoardPose { position, tilt, roll }.pose(board);
        let circles = visible(camera, board, sensor, &pose);
        if let Some(information) = circles.and_then(|circles| view_information(camera, &pose, circles.into_iter())) {
            sum += information;
        }
    }
    sum / JITTERS as f64
}

/// Returns poses at which `camera` would see the board: all over the image, near and far, tilted and rotated.
pub fn candidates(camera: &Camera<f64>, board: &Board, sensor: Sensor) -> Vec<Candidate> {
    let Some(focal) = camera.parameters().first().copied() else { return Vec::new() };
    let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
    let mut places = Vec::new();
    for size in SIZES {
        let depth = focal * board.longer_side() / (size * width.min(height));
        for (y, x) in OFFSETS.iter().flat_map(|y| OFFSETS.map(|x| (y, x))) {
            for (tilt, roll) in TILTS.iter().flat_map(|tilt| ROLLS.map(|roll| (tilt, roll))) {
                let position = Vector3::new(x * width / focal, y * height / focal, 1.0) * depth;
                let tilt = Vector2::new(tilt[0].to_radians(), tilt[1].to_radians());
                let place = BoardPose { position, tilt, roll };
                if visible(camera, board, sensor, &place.pose(board)).is_some() {
                    places.push(place);
                }
            }
        }
    }
    // With an odd step, both rotations occur among the candidates.
    let step = (places.len() / MOST_CANDIDATES) | 1;
    places
        .into_iter()
        .step_by(step)
        .map(|place| Candidate { place, information: expected_information(camera, board, sensor, &place) })
        .collect()
}
