//! Time of the joint solve for each event and iteration, on one core: a synthetic recording of 3 s whose
//! events lie on the edges of all circles, as the association hands them over.

use evcal_core::sensor::Sensor;
use std::ops::ControlFlow;
use std::time::Instant;

use evcal_core::camera::{Camera, ModelKind};
use evcal_geometry::board::Board;
use evcal_geometry::board::shape::{BoardShape, CircleArea};
use evcal_geometry::timed_pose::TimedPose;
use evcal_solve::solve::association::BIN;
use evcal_solve::solve::levenberg::{OF_CAMERA, Schedule, solve_with_progress};
use evcal_solve::solve::observation::{EventBin, EventObservation, SegmentObservations};
use evcal_solve::solve::rows::board_edge::BoardEdges;
use evcal_solve::solve::rows::event_bias::bias::Biases;
use evcal_solve::solve::rows::event_bias::{CLASS_COUNT, unknown};
use evcal_solve::solve::{BOARD_PARAMETERS, FreeParameters, HUBER, Problem, ResidualMeasure, State};
use evcal_solve::trajectory::fit::{TrajectoryShape, fit};
use evcal_solve::trajectory::{RotationSpline, Trajectory};
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const SENSOR: Sensor = Sensor::new(346, 260);
const DURATION: f64 = 3.0;
const EVENTS_IN_A_BIN: usize = 250;

fn main() {
    let camera =
        Camera::from_parameters(ModelKind::Radtan, &[331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03]);
    let board: Result<Board, _> = "acircles:9x4:55mm:r17.5mm".parse();
    let (Some(camera), Ok(board)) = (camera, board) else { return };
    for rotation in [RotationSpline::Quaternion, RotationSpline::So3] {
        let Some(trajectory) = trajectory(&board, rotation) else { return };
        let observations = observations(&camera, &board, &trajectory);
        let events = observations.events.len();
        let problem = Problem {
            sensor: SENSOR,
            points: (0..board.point_count()).map(|index| board.point(index).into()).collect(),
            edges: BoardEdges::of_board(&board),
            area: CircleArea::new(&board),
            mean_scale: 2e-3,
            point_sigma: 0.1,
            associated_latencies: [0.0; CLASS_COUNT],
            segments: vec![observations],
            stiffness: Vec::new(),
            free: FreeParameters {
                intrinsics: std::array::from_fn(|index| index < 9),
                board: [false; BOARD_PARAMETERS],
                biases: [Biases::from_fn(|_| true); CLASS_COUNT],
            },
            residual: ResidualMeasure::Pixel,
            huber: HUBER,
            iterations: 4,
        };
        let shape = BoardShape::nominal(&board);
        let state = State { camera, board: shape, bias: unknown(0.3), trajectories: vec![trajectory] };
        let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(1).build() else { return };
        let mut best = f64::INFINITY;
        for _ in 0..5 {
            let start = Instant::now();
            // No step is trusted, so that the cost is evaluated after each.
            let schedule = Schedule { trusted: 0.0, ..OF_CAMERA };
            let goes_on = &mut |_| ControlFlow::Continue(());
            let solved = pool.install(|| solve_with_progress(&problem, state.clone(), schedule, goes_on));
            let elapsed = start.elapsed().as_secs_f64();
            match solved {
                // One linearisation more than iterations: the first.
                Ok(solved) => best = best.min(elapsed / (events * (solved.report.iterations + 1)) as f64),
                Err(error) => eprintln!("{error}"),
            }
        }
        println!(
            "joint solve, {rotation} spline, {events} events: {:.0} ns an event and iteration, one core",
            best * 1e9
        );
    }
}

/// A swaying view of the board.
fn trajectory(board: &Board, rotation: RotationSpline) -> Option<Trajectory> {
    let middle = board.point(board.point_count() / 2);
    let poses: Vec<TimedPose> = (0..=600)
        .map(|index| {
            let t = DURATION * f64::from(index) / 600.0;
            let sway = |rate: f64, phase: f64| (rate * t + phase).sin();
            let turn = Rotation3::from_euler_angles(0.4 * sway(3.0, 0.0), 0.4 * sway(2.3, 1.0), 0.6 * sway(1.7, 2.0));
            let camera = Vector3::new(middle.x + 0.05 * sway(5.0, 0.5), middle.y + 0.05 * sway(4.1, 0.1), 0.0)
                - turn * Vector3::new(0.0, 0.0, 0.8 + 0.15 * sway(2.0, 0.7));
            let pose = Isometry3::from_parts(Translation3::from(camera), UnitQuaternion::from_rotation_matrix(&turn));
            TimedPose { t, pose }
        })
        .collect();
    let shape = TrajectoryShape { degree: 3, rotation, knot_spacing: 0.0175 };
    fit(0, &poses, 0.0, DURATION, &shape).ok()
}

fn observations(camera: &Camera<f64>, board: &Board, trajectory: &Trajectory) -> SegmentObservations {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut observations = SegmentObservations::default();
    for index in 0..(DURATION / BIN) as usize {
        let t = (index as f64 + 0.5) * BIN;
        let Some(pose) = trajectory.pose(t) else { continue };
        let first = observations.events.len();
        for event in 0..EVENTS_IN_A_BIN {
            let circle = random.random_range(0..board.point_count());
            let angle = random.random_range(0.0..std::f64::consts::TAU);
            let rim = board.point(circle) + board.dot_radius() * Vector2::new(angle.cos(), angle.sin());
            let Some(pixel) = camera.project(&pose.inverse_transform_point(&rim.push(0.0).into()).coords) else {
                continue;
            };
            let inside = |value: f64, size: u16| value >= 0.0 && value <= f64::from(size - 1);
            if !inside(pixel.x, SENSOR.width) || !inside(pixel.y, SENSOR.height) {
                continue;
            }
            observations.events.push(EventObservation {
                dt: 0.0,
                x: pixel.x.round() as u16,
                y: pixel.y.round() as u16,
                edge: circle as u16,
                class: (event * CLASS_COUNT / EVENTS_IN_A_BIN) as u8,
                speed_range: 2,
            });
        }
        observations.bins.push(EventBin { t, first, end: observations.events.len() });
    }
    observations
}
