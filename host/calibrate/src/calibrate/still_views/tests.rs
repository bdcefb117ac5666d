//! Blinking boards, drawn by tracing rays from parts of pixels to the board.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::event::{Event, Polarity};
use evcal_geometry::board::squares::Shade;
use evcal_geometry::board::{Board, SquareBoard};
use evcal_geometry::lens::projection_difference::projection_difference;
use event_recordings::{Recording, RecordingOptions};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::calibrate::calibrate as calibrate_all;
use crate::picture_calibration::calibration::PictureFailure;
use evcal_solve::initial::model_choice::ModelRequest;

const SENSOR: Sensor = Sensor::new(240, 180);
/// Number of parts of a pixel along each side.
const PARTS: usize = 4;
/// Distance at which all of the board is in view (m).
const FAR: f64 = 0.33;
/// Distance at which a part of the board is in view (m).
const NEAR: f64 = 0.24;
/// Duration of a view (µs).
const VIEW: i64 = 500_000;
/// Duration of the motion to the next view (µs).
const WAY: i64 = 150_000;
/// Time between two changes of the light (µs).
const CHANGE: i64 = 40_000;

fn truth() -> Camera<f64> {
    Camera::from_parameters(ModelKind::Radtan4, &[190.0, 190.5, 118.0, 91.0, -0.3, 0.1, 0.001, -0.0005]).unwrap()
}

/// Poses of the board in front of the camera, `T_camera_world`.
fn poses(board: &Board, count: usize, distance: f64, random: &mut ChaCha8Rng) -> Vec<Isometry3<f64>> {
    let middle = board.middle();
    let mut any = |range: f64| range * (2.0 * random.random::<f64>() - 1.0);
    let pose = |_| {
        let rotation = UnitQuaternion::from_euler_angles(any(0.6), any(0.6), any(0.3));
        let position = Vector3::new(any(0.11), any(0.08), distance + any(0.05));
        Isometry3::from_parts(Translation3::from(position - rotation * middle.push(0.0)), rotation)
    };
    (0..count).map(pose).collect()
}

/// Returns `true` if the print is dark at a position on the board.
fn is_dark(board: &Board, place: Vector2<f64>) -> bool {
    match board {
        Board::Circles(circles) => {
            (0..board.point_count()).any(|index| (board.point(index) - place).norm() < circles.radius)
        }
        Board::Squares(SquareBoard::Checkerboard(board)) => {
            let (column, row) = ((place.x / board.square).floor() as i64, (place.y / board.square).floor() as i64);
            let inside = (-1..i64::from(board.columns)).contains(&column) && (-1..i64::from(board.rows)).contains(&row);
            inside && ((column + row).rem_euclid(2) == 0) == (board.first == Shade::Dark)
        }
        Board::Squares(_) => false,
    }
}

/// Returns the share of a pixel that is paper.
fn paper(board: &Board, pose: &Isometry3<f64>, pixel: Vector2<f64>) -> f64 {
    let camera = truth();
    let (low, high) = board.extent();
    let to_board = pose.inverse();
    let is_paper = |part: usize| {
        let [x, y] = [part % PARTS, part / PARTS].map(|part| (part as f64 + 0.5) / PARTS as f64 - 0.5);
        let Some(bearing) = camera.unproject(&(pixel + Vector2::new(x, y))) else { return false };
        let (origin, ray) = (to_board * Point3::origin(), to_board * bearing);
        let place = (origin.coords - ray * (origin.z / ray.z)).xy();
        let margin = 0.04;
        let on_sheet = place >= low.add_scalar(-margin) && place <= high.add_scalar(margin);
        on_sheet && !is_dark(board, place)
    };
    (0..PARTS * PARTS).filter(|part| is_paper(*part)).count() as f64 / (PARTS * PARTS) as f64
}

/// Returns the events of a screen that blinks between black and the board, in front of a camera at rest at one pose after the other, with
/// noise.
fn events(board: &Board, poses: &[Isometry3<f64>], random: &mut ChaCha8Rng) -> Vec<Event> {
    let mut events = Vec::new();
    for (view, pose) in poses.iter().enumerate() {
        let begin = view as i64 * (VIEW + WAY);
        for (x, y) in (0..SENSOR.width).flat_map(|x| (0..SENSOR.height).map(move |y| (x, y))) {
            let share = paper(board, pose, Vector2::new(f64::from(x), f64::from(y)));
            // The screen has a fiftieth of its brightness where it is dark; thresholds differ.
            let contrast = (share + 0.02).ln() - 0.02_f64.ln();
            for change in 0..VIEW / CHANGE {
                let polarity = if change % 2 == 0 { Polarity::On } else { Polarity::Off };
                for _ in 0..(contrast / random.random_range(0.8..1.2)) as usize {
                    events.push(Event { t: begin + change * CHANGE + random.random_range(0..3000), x, y, polarity });
                }
            }
        }
        // On the way to the next pose there are events everywhere.
        for _ in 0..20_000 {
            let t = begin + VIEW + random.random_range(0..WAY);
            let (x, y) = (random.random_range(0..SENSOR.width), random.random_range(0..SENSOR.height));
            events.push(Event { t, x, y, polarity: Polarity::On });
        }
    }
    events.sort_by_key(|event| event.t);
    events
}

fn blinking(board: &Board, seen_board: &Board, views: usize, seed: u64) -> Result<Calibrated, CalibrateError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let poses = poses(board, views, FAR, &mut random);
    calibrate_seen_board(events(board, &poses, &mut random), seen_board, PictureUse::default())
}

fn calibrate_seen_board(events: Vec<Event>, board: &Board, pictures: PictureUse) -> Result<Calibrated, CalibrateError> {
    let options = RecordingOptions { sensor: Some(SENSOR), ..RecordingOptions::default() };
    let inputs = [Recording::from_events("views", events, options).into()];
    let task = Task { model: ModelRequest::Given(ModelKind::Radtan4), pictures, ..Task::new(&inputs, board) };
    calibrate_all(&task, |_| ControlFlow::Continue(()))
}

#[test]
fn errors_from_a_blinking_board_are_within_the_reported_uncertainty() {
    for (board, seed) in [("checkerboard:5x8:25mm", 3), ("circles:5x8:25mm:r8mm", 4)] {
        let board: Board = board.parse().unwrap();
        let calibrated = blinking(&board, &board, 16, seed).unwrap();
        let report = calibrated.picture_report().unwrap();
        assert_eq!((report.source, report.detection.frames), (PictureSource::StillViews, 16), "{board}");
        assert!(report.used >= 14, "{board}: {} views used", report.used);
        let difference = projection_difference(&truth(), calibrated.camera(), SENSOR).unwrap();
        let stated = calibrated.quality.projection.rms_95;
        assert!(difference.rms < stated && stated < 0.3, "{board}: {} of {stated} px", difference.rms);
        assert!(calibrated.residuals().rms < 0.1, "{board}: {}", calibrated.residuals().rms);
    }
}

/// Dots that the border of the image cuts, or that are near it, do not prevent the detection of the board.
#[test]
fn errors_from_a_board_cut_by_the_border_are_within_the_reported_uncertainty() {
    let board: Board = "acircles:9x4:20mm:r6mm".parse().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let poses = poses(&board, 12, NEAR, &mut random);
    let is_outside = |pose: &&Isometry3<f64>| {
        let pixel = |index| truth().project(&(**pose * Point3::from(board.point(index).push(0.0))).coords);
        let visible = |place: Vector2<f64>| place >= Vector2::zeros() && place < Vector2::new(239.0, 179.0);
        (0..board.point_count()).any(|index| !pixel(index).is_some_and(visible))
    };
    assert!(poses.iter().filter(is_outside).count() > 3);
    let events = events(&board, &poses, &mut random);
    let calibrated = calibrate_seen_board(events.clone(), &board, PictureUse::default()).unwrap();
    let report = calibrated.picture_report().unwrap();
    assert!(report.detection.with_board >= 11, "{} views", report.detection.with_board);
    let difference = projection_difference(&truth(), calibrated.camera(), SENSOR).unwrap();
    let stated = calibrated.quality.projection.rms_95;
    assert!(difference.rms < stated && stated < 0.3, "{} of {stated} px", difference.rms);
    let with_frames = calibrate_seen_board(events, &board, PictureUse::Joint).err().unwrap();
    assert!(matches!(with_frames, CalibrateError::BlinkingWithFrames { views } if views >= 11), "{with_frames}");
}

#[test]
fn too_few_views_and_a_wrong_board_are_reported() {
    let board: Board = "checkerboard:5x8:25mm".parse().unwrap();
    let few = blinking(&board, &board, 3, 5).err().unwrap();
    let CalibrateError::Views(few) = few else { panic!("{few}") };
    assert!(matches!(few.reason, PictureFailure::TooFewViews { found: 3, read: 3, required: 6, .. }), "{few}");
    let another = blinking(&board, &"aprilgrid:4x4:30mm:0.3".parse().unwrap(), 3, 6).err().unwrap();
    assert!(
        another.to_string().contains("blinks in front of a camera at rest, but no board was found in 3 views"),
        "{another}"
    );
}

/// Without a view, the error must not be that a board blinks but is in none of 0 views.
#[test]
fn events_with_one_timestamp_are_not_a_view() {
    let event = |index: u16| Event { t: 7, x: index % 240, y: index / 240, polarity: Polarity::On };
    let options = RecordingOptions { sensor: Some(SENSOR), ..RecordingOptions::default() };
    let inputs = [Recording::from_events("moment", (0..20_000).map(event).collect(), options).into()];
    let board = "checkerboard:5x8:25mm".parse().unwrap();
    let error = calibrate_all(&Task::new(&inputs, &board), |_| ControlFlow::Continue(())).err().unwrap();
    assert!(!error.to_string().contains("blinks"), "{error}");
}
