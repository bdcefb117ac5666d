//! The gradient equals the slope of the cost, by the mount, by the lens of the second camera and by the first camera's
//! trajectory.

use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::{DVector, Isometry3, Point3, Vector3};

use super::*;
use crate::second_camera::carried::POSE;
use crate::second_camera::mount::{COUNT, LINE_DELAY, MOST, Mount, OFFSET, RATE, ROTATION, TRANSLATION};
use crate::second_camera::start::tests::{first_pose, fitted_to};
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_geometry::board::shape::{BoardShape, CircleArea};
use evcal_solve::solve::levenberg::moved;
use evcal_solve::solve::observation::{EventBin, EventObservation, SegmentObservations};
use evcal_solve::solve::observation_range::observation_ranges;
use evcal_solve::solve::rows::board_edge::BoardEdges;
use evcal_solve::solve::rows::event_bias::bias::{Bias, Biases};
use evcal_solve::solve::rows::event_bias::{CLASS_COUNT, unknown};
use evcal_solve::solve::{BOARD_PARAMETERS, FreeParameters, ITERATIONS, ResidualMeasure, State, bias_index};
use evcal_solve::trajectory::Trajectory;

const CENTERS: [[f64; 2]; 2] = [[0.11, 0.165], [0.165, 0.11]];
const RADIUS: f64 = 0.0175;
const AREA: CircleArea = CircleArea { middle: [0.19, 0.22], half: [0.19, 0.22] };
/// Time bins, 10 ms apart.
const BINS: usize = 9;
const FLAT: BoardShape = BoardShape { print_ratio: 1.0, bend: [0.0; 2], radius: RADIUS };

fn camera() -> Camera<f64> {
    let parameters = [331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03];
    Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap()
}

fn mount() -> Mount {
    let second_first = Isometry3::new(Vector3::new(-0.05, 0.004, 0.007), Vector3::new(0.03, 0.05, -0.04));
    Mount { second_first, offset: 3.25, rate: 1e-3, middle: 3.2, line_delay: None }
}

/// The first camera, during the times of all bins.
fn trajectory() -> Trajectory {
    fitted_to(|t| first_pose(t, 1.0), 0.0..0.1)
}

/// Events of the second camera near the rims of two dots.
fn observations(trajectory: &Trajectory) -> SegmentObservations {
    let mut observations = SegmentObservations::default();
    for bin in 0..BINS {
        let time = 0.01 * (bin as f64 + 1.0);
        let Mount { second_first, offset, rate, middle, .. } = mount();
        let t = (time + offset - rate * middle) / (1.0 - rate);
        let pose = trajectory.pose(time).unwrap() * second_first.inverse();
        let first = observations.events.len();
        for event in 0..50 {
            let (circle, angle) = (event % 2, 0.35 * event as f64 + bin as f64);
            let [x, y] = CENTERS[circle];
            let rim = Point3::new(x + RADIUS * angle.cos(), y + RADIUS * angle.sin(), 0.0);
            let pixel = camera().project(&pose.inverse_transform_point(&rim).coords).unwrap();
            observations.events.push(EventObservation {
                dt: 0.0,
                x: pixel.x.round() as u16,
                y: pixel.y.round() as u16,
                edge: circle as u16,
                class: [0, 2][event / 25],
                speed_range: 1,
            });
        }
        observations.bins.push(EventBin { t, first, end: observations.events.len() });
    }
    observations
}

/// The border of the system: the mount, then the second camera.
fn columns(of_mount: usize, free: &[usize]) -> Columns {
    let mut mask = [false; evcal_solve::solve::GLOBAL_COUNT];
    free.iter().for_each(|&global| mask[global] = true);
    Columns::after(of_mount, &mask)
}

fn pieces(problem: &Problem, estimate: &Estimate, columns: &Columns) -> Vec<Equations> {
    let bearings = BearingTable::new(&estimate.second.camera, problem.sensor);
    let of_range = |range: &ObservationRange| second_pieces(problem, estimate, &bearings, columns, range).unwrap();
    observation_ranges(&problem.segments).iter().flat_map(of_range).collect()
}

fn problem(segment: SegmentObservations) -> Problem {
    Problem {
        sensor: Sensor::new(346, 260),
        points: CENTERS.to_vec(),
        edges: BoardEdges::Rims(CENTERS.to_vec()),
        area: AREA,
        mean_scale: 1.0,
        point_sigma: 1.0,
        associated_latencies: [0.0; CLASS_COUNT],
        segments: vec![segment],
        stiffness: Vec::new(),
        free: FreeParameters {
            intrinsics: [true; MAX_PARAMETERS],
            board: [false; BOARD_PARAMETERS],
            biases: [Biases::default(); CLASS_COUNT],
        },
        residual: ResidualMeasure::Pixel,
        huber: 1e6,
        iterations: ITERATIONS,
    }
}

#[test]
fn the_gradient_is_the_slope_of_the_cost() {
    let trajectory = trajectory();
    let points = trajectory.control_point_count();
    let problem = problem(observations(&trajectory));
    let free = [0, 2, 3, 4, bias_index(0, Bias::Offset), bias_index(2, Bias::Latency)];
    let mut bias = unknown(0.3);
    bias.iter_mut().for_each(|class| class.biases[Bias::Offset] = -0.3);
    let first = State { camera: camera(), board: FLAT, bias, trajectories: vec![trajectory] };
    let second = State { trajectories: Vec::new(), ..first.clone() };
    let estimate = Estimate { first, second, mount: mount() };
    let columns = columns(COUNT, &free);
    let found = pieces(&problem, &estimate, &columns);
    let [piece] = found.as_slice() else { panic!("one piece") };
    assert_eq!((piece.loss.count, piece.segment, piece.columns.clone()), (50 * BINS, 0, 0..COUNT + free.len()));

    let cost = |globals: &[f64], step: &[f64]| {
        let of_lens = columns.globals(globals);
        let none = [0.0; evcal_solve::solve::GLOBAL_COUNT];
        let moved_estimate = Estimate {
            first: moved(&estimate.first, &[step.to_vec()], &none, &[]).unwrap(),
            second: moved(&estimate.second, &[], &of_lens, &[]).unwrap(),
            mount: estimate.mount.moved(globals),
        };
        pieces(&problem, &moved_estimate, &columns).iter().map(|one| one.loss.cost).sum::<f64>()
    };
    let slope = |index: usize, size: f64, of_points: bool| {
        let at = |sign: f64| {
            let (mut globals, mut step) = (vec![0.0; COUNT + free.len()], vec![0.0; POSE * points]);
            let place = if of_points { &mut step } else { &mut globals };
            place[index] = sign * size;
            cost(&globals, &step)
        };
        (at(1.0) - at(-1.0)) / (2.0 * size)
    };
    // Deviation of the cost from a parabola: second order in the distance from the edge.
    let assert_close = |found: f64, wanted: f64, scale: f64, what: &str| {
        assert!((found - wanted).abs() < 0.02 * (wanted.abs() + scale), "{what}: {found} against {wanted}");
    };
    let of_mount = [(ROTATION, 1e-5), (TRANSLATION, 1e-5)].into_iter();
    let of_mount = of_mount.flat_map(|(first, size)| (first..first + 3).map(move |index| (index, size)));
    let of_clock = [(OFFSET, 1e-5), (RATE, 1e-4)];
    let of_lens =
        [0.01, 0.01, 0.01, 1e-4, 1e-3, 1e-6].into_iter().enumerate().map(|(index, size)| (COUNT + index, size));
    for (index, size) in of_mount.chain(of_clock).chain(of_lens) {
        assert_close(piece.corner.gradient[index], slope(index, size, false), 0.05 / size, &format!("global {index}"));
    }
    let gradient = |piece: &Equations| DVector::from_column_slice(piece.band.gradient.as_flattened());
    for (row, found) in gradient(piece).iter().enumerate() {
        let index = POSE * piece.band.first + row;
        assert_close(*found, slope(index, 1e-5, true), 5e3, &format!("control point {index}"));
    }

    // The border, from the gradients of a changed mount: all of it is one quadratic function.
    let step = 1e-6;
    for column in ROTATION..COUNT {
        let mut globals = [0.0; COUNT];
        globals[column] = step;
        let moved = Estimate { mount: estimate.mount.moved(&globals), ..estimate.clone() };
        let after = &pieces(&problem, &moved, &columns)[0];
        let change = (gradient(after) - gradient(piece)) / step;
        let border = piece.band.border.to_matrix(piece.band.count());
        let expected = border.column(column);
        assert!((&change - expected).norm() < 0.05 * expected.norm(), "column {column}: {change} {expected}");
        let change = (&after.corner.gradient - &piece.corner.gradient) / step;
        let mut corner = piece.corner.matrix.clone();
        corner.fill_upper_triangle_with_lower_triangle();
        let expected = corner.column(column);
        assert!((&change - expected).norm() < 0.05 * expected.norm(), "column {column}: {change} {expected}");
    }
}

/// Circles of frames, slightly displaced from their predicted positions, at the times of their rows.
#[test]
fn the_gradient_is_the_slope_of_the_cost_of_circles_in_frames_too() {
    let trajectory = trajectory();
    let mount = Mount { line_delay: Some(2e-5), ..mount() };
    let mut observations = SegmentObservations::default();
    for frame in 0..BINS {
        let time = 0.01 * (frame as f64 + 1.0);
        let t = (time + mount.offset - mount.rate * mount.middle) / (1.0 - mount.rate);
        let pose = trajectory.pose(time).unwrap() * mount.second_first.inverse();
        for (circle, [x, y]) in CENTERS.into_iter().enumerate() {
            let pixel = camera().project(&pose.inverse_transform_point(&Point3::new(x, y, 0.0)).coords).unwrap();
            let off = nalgebra::Vector2::new(0.7 * (frame as f64).sin(), 0.5 * (1.3 * frame as f64).cos());
            observations.points.push(PointObservation { t, pixel: pixel + off, circle });
        }
    }
    let problem = problem(observations);
    let free = [0, 2, 4];
    let first = State { camera: camera(), board: FLAT, bias: unknown(0.3), trajectories: vec![trajectory] };
    let second = State { trajectories: Vec::new(), ..first.clone() };
    let estimate = Estimate { first, second, mount };
    let columns = columns(MOST, &free);
    let found = pieces(&problem, &estimate, &columns);
    let [piece] = found.as_slice() else { panic!("one piece") };
    assert_eq!((piece.loss.count, piece.columns.clone()), (CENTERS.len() * BINS, 0..MOST + free.len()));
    let cost = |index: usize, size: f64| {
        let mut globals = vec![0.0; MOST + free.len()];
        globals[index] = size;
        let of_lens = columns.globals(&globals);
        let moved_estimate = Estimate {
            second: moved(&estimate.second, &[], &of_lens, &[]).unwrap(),
            mount: estimate.mount.moved(&globals),
            ..estimate.clone()
        };
        pieces(&problem, &moved_estimate, &columns).iter().map(|one| one.loss.cost).sum::<f64>()
    };
    let sizes = [1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-4, 1e-7, 0.01, 0.01, 1e-4];
    for (index, size) in sizes.into_iter().enumerate() {
        let wanted = (cost(index, size) - cost(index, -size)) / (2.0 * size);
        // The information of a parameter is the change of its slope; products are summed in single precision.
        let scale = 1e-4 * piece.corner.matrix[(index, index)] * size;
        let found = piece.corner.gradient[index];
        assert!((found - wanted).abs() < 1e-3 * wanted.abs() + scale, "global {index}: {found} against {wanted}");
        let bend = (cost(index, size) + cost(index, -size) - 2.0 * cost(index, 0.0)) / (size * size);
        let found = piece.corner.matrix[(index, index)];
        assert!((found - bend).abs() < 0.1 * bend.abs(), "global {index}: {found} against {bend}");
    }
    assert!(piece.corner.matrix[(LINE_DELAY, LINE_DELAY)] > 0.0);
}
