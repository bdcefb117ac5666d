use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Vector3};

use evcal_geometry::board::squares::raster::{Raster, Rectangle};

use super::*;
use crate::rays::Rays;
use crate::tests::{board, kannala_brandt, radtan};

const POINT_SPREAD: f64 = 0.6;

/// Returns a camera pose at `distance` metres from the middle of the board, tilted and rolled in degrees.
fn pose(board: &Board, distance: f64, tilt: f64, roll: f64) -> Isometry3<f64> {
    let turn = nalgebra::UnitQuaternion::from_euler_angles(tilt.to_radians(), 0.3 * tilt.to_radians(), 0.0)
        * nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, roll.to_radians());
    let position = board.middle().push(0.0) - turn * Vector3::new(0.0, 0.0, distance);
    Isometry3::from_parts(position.into(), turn)
}

/// A print defined by the board's own list of circles or cells.
enum TrueScene {
    Circles { centers: Vec<Vector2<f64>>, margin: f64 },
    Squares { raster: Raster, bounds: Rectangle, margin: f64, further: f64 },
}

impl TrueScene {
    fn new(board: &Board, printed: &BoardShape) -> Self {
        let factor = SceneSettings::default().margin;
        match board {
            Board::Circles(board) => Self::Circles {
                centers: (0..board.circle_count()).map(|index| board.circle_center(index)).collect(),
                margin: factor * board.spacing,
            },
            Board::Squares(squares) => Self::Squares {
                raster: squares.raster(),
                bounds: squares.bounds(),
                margin: factor
                    * match squares {
                        SquareBoard::Tags(grid) => grid.period() - grid.tag,
                        SquareBoard::Checkerboard(board) => board.square,
                        SquareBoard::Charuco(board) => board.square,
                    },
                further: printed.radius - board.print_radius(),
            },
        }
    }

    /// Returns `true` if a point of the sheet is dark.
    fn is_dark(&self, point: &Vector2<f64>, printed: &BoardShape) -> bool {
        match self {
            Self::Circles { centers, .. } => centers.iter().any(|center| (center - point).norm() < printed.radius),
            Self::Squares { raster, further, .. } => {
                let mut around = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]
                    .into_iter()
                    .map(|(x, y)| raster.is_dark_at([point.x + x * further, point.y + y * further]));
                if *further < 0.0 { around.all(|dark| dark) } else { around.any(|dark| dark) }
            }
        }
    }

    /// Returns `true` if a point is on the sheet.
    fn is_sheet(&self, point: &Vector2<f64>) -> bool {
        let (low, high, margin) = match self {
            Self::Circles { centers, margin } => {
                let last = centers.iter().fold(Vector2::zeros(), |last: Vector2<f64>, center| last.sup(center));
                (Vector2::zeros(), last, margin)
            }
            Self::Squares { bounds, margin, .. } => (bounds.low.into(), bounds.high.into(), margin),
        };
        (0..2).all(|axis| point[axis] > low[axis] - margin && point[axis] < high[axis] + margin)
    }
}

/// Returns the unblurred scene at one point of the image, computed from the pose. The ray is followed to a bent board
/// step by step.
fn sharp(
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
    board: &Board,
    scene: &TrueScene,
    printed: &BoardShape,
    pixel: Vector2<f64>,
) -> f64 {
    let settings = SceneSettings::default();
    let direction = pose.rotation * camera.unproject(&pixel).unwrap();
    let origin = pose.translation.vector;
    let (low, high) = board.extent();
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let mut point = (origin - direction * (origin.z / direction.z)).xy();
    for _ in 0..if printed.bend == [0.0; 2] { 0 } else { 8 } {
        let place = (point - middle).component_div(&half);
        let height = printed.bend[0] * (1.0 - place.x * place.x) + printed.bend[1] * (1.0 - place.y * place.y);
        point = (origin + direction * ((height - origin.z) / direction.z)).xy();
    }
    let root = printed.print_ratio.sqrt();
    let point = middle + (point - middle).component_div(&Vector2::new(root, 1.0 / root));
    if scene.is_dark(&point, printed) {
        return settings.black;
    }
    if scene.is_sheet(&point) { settings.white } else { settings.background }
}

/// Returns the largest errors of the rendered radiance, as a fraction of the contrast, over pixels of a view at the
/// print and over pixels at the sheet's edge, compared with an integral of the point-spread function over 300 × 300
/// points.
fn greatest_errors(
    board: &Board,
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
    step: usize,
    printed: Option<BoardShape>,
) -> [f64; 2] {
    const SIDE: i32 = 300;
    let scene = Scene::new(*board, SceneSettings { printed, ..SceneSettings::default() }, POINT_SPREAD);
    let printed = printed.unwrap_or(BoardShape::nominal(board));
    let truth = TrueScene::new(board, &printed);
    let rays = Rays::new(camera, Sensor::new(346, 260));
    let view = View::new(pose);
    let offset = |index: i32| (f64::from(index) + 0.5) / f64::from(SIDE) * 10.0 - 5.0;
    let background = scene.settings().background;
    let mut worst = [0.0f64; 2];
    let mut compared = 0;
    for pixel in (0..346 * 260).step_by(step) {
        let (x, y) = ((pixel % 346) as u16, (pixel / 346) as u16);
        let sample = scene.sample(&view, rays.get(x, y).unwrap());
        if sample.edge.abs() > 2.0 {
            continue;
        }
        let (mut sum, mut weights, mut at_sheet) = (0.0, 0.0, 0);
        for (u, v) in (0..SIDE).flat_map(|v| (0..SIDE).map(move |u| (offset(u), offset(v)))) {
            let weight = (-0.5 * (u * u + v * v)).exp();
            let place = Vector2::new(f64::from(x), f64::from(y)) + Vector2::new(u, v) * POINT_SPREAD;
            let radiance = sharp(camera, pose, board, &truth, &printed, place);
            at_sheet |= usize::from(radiance == background);
            sum += weight * radiance;
            weights += weight;
        }
        compared += 1;
        worst[at_sheet] = worst[at_sheet].max((sample.radiance - sum / weights).abs() / 0.92);
    }
    assert!(compared > 30, "{compared}");
    worst
}

#[test]
fn radiance_is_the_integral_of_the_point_spread() {
    // Circles of at least 5 px radius; then of at least 3 px.
    for (camera, distance, tilt, step, tolerances) in [
        (radtan(), 0.7, 0.0, 197, [0.001, 0.001]),
        (radtan(), 0.8, 40.0, 197, [0.002, 0.002]),
        (kannala_brandt(), 0.4, 30.0, 197, [0.002, 0.003]),
        (radtan(), 1.8, 35.0, 61, [0.002, 0.002]),
    ] {
        let worst = greatest_errors(&board(), &camera, &pose(&board(), distance, tilt, 25.0), step, None);
        println!("distance {distance} m, tilt {tilt} deg: circles {:.5}, sheet {:.5}", worst[0], worst[1]);
        assert!(worst.iter().zip(tolerances).all(|(worst, most)| *worst < most), "{worst:?} at {distance} m");
    }
}

#[test]
fn a_board_that_differs_from_nominal_is_rendered_as_printed() {
    let nominal = BoardShape::nominal(&board());
    for (printed, distance, tilt) in [
        (BoardShape { bend: [0.012, -0.006], ..nominal }, 0.7, 35.0),
        (BoardShape { print_ratio: 1.04, radius: 0.0165, ..nominal }, 0.8, 20.0),
    ] {
        let pose = pose(&board(), distance, tilt, 25.0);
        let worst = greatest_errors(&board(), &radtan(), &pose, 197, Some(printed));
        println!("{printed:?}: circles {:.5}, sheet {:.5}", worst[0], worst[1]);
        assert!(worst.iter().all(|worst| *worst < 0.003), "{worst:?} of {printed:?}");
    }
}

/// Squares of 18 to 30 px, and modules of 2.5 to 3.5 px.
#[test]
fn radiance_of_squares_is_the_integral_of_the_point_spread() {
    for (text, camera, distance, tilt, roll, step) in [
        ("checkerboard:5x7:60mm", radtan(), 0.7, 0.0, 8.0, 197),
        ("checkerboard:5x7:60mm", radtan(), 0.8, 40.0, 25.0, 197),
        ("aprilgrid:6x6:88mm:0.3", radtan(), 1.0, 30.0, 40.0, 997),
        ("apriltags:3x4:88mm:0.3", kannala_brandt(), 0.6, 45.0, 70.0, 199),
        ("charuco:5x7:100mm:75mm:DICT_5X5_100", radtan(), 1.2, -35.0, 10.0, 397),
    ] {
        let board: Board = text.parse().unwrap();
        let worst = greatest_errors(&board, &camera, &pose(&board, distance, tilt, roll), step, None);
        println!("{text} at {distance} m, tilt {tilt} deg: squares {:.5}, sheet {:.5}", worst[0], worst[1]);
        assert!(worst.iter().all(|worst| *worst < 0.003), "{worst:?} of {text}");
    }
}

#[test]
fn squares_that_differ_from_nominal_are_rendered_as_printed() {
    let board: Board = "aprilgrid:6x6:88mm:0.3".parse().unwrap();
    let nominal = BoardShape::nominal(&board);
    for printed in [
        BoardShape { print_ratio: 1.03, bend: [0.03, -0.01], radius: nominal.radius + 0.0006 },
        BoardShape { radius: nominal.radius - 0.0006, ..nominal },
    ] {
        let worst = greatest_errors(&board, &radtan(), &pose(&board, 0.9, 30.0, 25.0), 997, Some(printed));
        println!("{printed:?}: squares {:.5}, sheet {:.5}", worst[0], worst[1]);
        assert!(worst.iter().all(|worst| *worst < 0.003), "{worst:?} of {printed:?}");
    }
}

#[test]
fn the_jacobian_is_the_derivative_of_the_point() {
    let camera = radtan();
    let pose = pose(&board(), 0.7, 40.0, 25.0);
    let view = View::new(&pose);
    let rays = Rays::new(&camera, Sensor::new(346, 260));
    let point = |x: f64, y: f64| {
        let direction = pose.rotation * camera.unproject(&Vector2::new(x, y)).unwrap();
        let origin = pose.translation.vector;
        (origin - direction * (origin.z / direction.z)).xy()
    };
    for (x, y) in [(0u16, 0u16), (345, 259), (170, 130), (20, 240)] {
        let (u, v) = (f64::from(x), f64::from(y));
        let ray = rays.get(x, y).unwrap();
        let gaze = view.gaze(ray).unwrap();
        assert!((gaze.point - point(u, v)).norm() < 1e-12);
        let jacobian = view.jacobian(ray, &gaze);
        let by_x = (point(u + 0.01, v) - point(u - 0.01, v)) / 0.02;
        let by_y = (point(u, v + 0.01) - point(u, v - 0.01)) / 0.02;
        assert!((jacobian.column(0) - by_x).norm() < 1e-6 * by_x.norm());
        assert!((jacobian.column(1) - by_y).norm() < 1e-6 * by_y.norm());
        let stretch = jacobian.svd(false, false).singular_values.max();
        assert!(gaze.metres_per_pixel(ray) >= stretch && gaze.metres_per_pixel(ray) < 1.6 * stretch);
    }
}

#[test]
fn a_pixel_that_faces_away_from_the_board_sees_the_background() {
    let scene = Scene::new(board(), SceneSettings::default(), POINT_SPREAD);
    let rays = Rays::new(&radtan(), Sensor::new(346, 260));
    let away = pose(&board(), 0.7, 0.0, 0.0) * nalgebra::UnitQuaternion::from_euler_angles(0.0, 3.0, 0.0);
    let sample = scene.sample(&View::new(&away), rays.get(170, 130).unwrap());
    assert_eq!(sample, Sample { radiance: scene.settings().background, edge: f64::NEG_INFINITY });
}
