//! The residual of one event and its derivatives.
//!
//! The residual is the distance in pixels from the event's pixel m to the projected edge, minus the distance at which its class
//! is expected. One Newton step from m leads to a point m' on the edge. The board distance f ([`board_ray`](super::board_ray)),
//! its gradient and all derivatives are taken there: r = n'·(m − m') + f(m') / s(m') − expected distance, with n' the unit
//! normal. Derivatives taken at m would omit the dependence of the scale itself on the parameters, which is as large as
//! the derivatives by the least determined combinations of parameters. For the paper's plane residual, r is f(m)
//! divided by a constant scale.
//!
//! ∂r/∂k = −n' · ∂m'/∂k, ∂r/∂radius = −1/s, ∂r/∂offset = −1, ∂r/∂latency = −v, ∂r/∂bend = −v², ∂r/∂curvature = −1/ρ,
//! ∂r/∂(corner latency) = −v q², ∂r/∂(curvature latency) = −v/ρ, ∂r/∂memory = −a. v = dr/dt is the normal speed, ρ the
//! radius of the dot or the width of the strip in pixels, q the distance from the middle of the sensor (1 at its
//! corners) and a the edge's acceleration (see [`crate::solve::rows::event_bias`]).

use evcal_core::camera::MAX_PARAMETERS;

use crate::solve::rows::event_bias::EdgePassage;
use crate::solve::rows::event_bias::bias::Bias;

use super::board_edge::BoardEdge;
use super::board_ray::EdgeDistance;
use super::pose_bin::PoseBin;
use crate::solve::BOARD_PARAMETERS;

/// Length of a row: pose (rotation 3, translation 3) and residual, intrinsics, board and biases of the class; each of
/// these four parts begins at a multiple of four. Single precision is enough because rows are summed over many events.
pub const ROW: usize = 32;
/// Index of the residual in a row.
pub const ROW_RESIDUAL: usize = 6;
/// Index of the first intrinsic in a row.
pub const ROW_INTRINSICS: usize = 8;
/// Index of the first coefficient of the camera model in a row, after fx, fy, cx and cy.
pub const ROW_COEFFICIENTS: usize = ROW_INTRINSICS + 4;
/// Index of the first parameter of the board in a row.
pub const ROW_BOARD: usize = 20;
/// Index of the first bias of the class in a row.
pub const ROW_BIASES: usize = 24;
/// Returns the index of a bias of the class in a row.
pub const fn row_bias(bias: Bias) -> usize {
    ROW_BIASES + bias.index()
}
const _: () = assert!(ROW_INTRINSICS + MAX_PARAMETERS <= ROW_BOARD && ROW_BOARD + BOARD_PARAMETERS <= ROW_BIASES);
const _: () = assert!(ROW_BIASES + Bias::COUNT <= ROW);

impl EdgeDistance {
    /// Returns the distance in metres at `step` pixels from here, to first order.
    #[inline(always)]
    pub fn beyond(&self, step: [f64; 2]) -> f64 {
        self.by_pixel[0] * step[0] + self.by_pixel[1] * step[1] + self.metres
    }
}

impl EdgePassage {
    /// Returns the motion of the `edge` at `distance` as it passes a pixel whose squared distance from the middle of
    /// the sensor is `corner_share`.
    #[inline(always)]
    pub fn new(pose: &PoseBin, distance: &EdgeDistance, corner_share: f64, edge: impl BoardEdge) -> Self {
        Self {
            normal_speed: distance.normal_speed(pose),
            narrowness: edge.narrowness(distance.scale),
            corner_share,
            acceleration: edge.acceleration(distance.sliding, distance.scale),
        }
    }
}

/// Returns Newton's step from the edge to the pixel, in pixels.
#[inline(always)]
pub fn step_to_edge(at_event: &EdgeDistance) -> [f64; 2] {
    let step = at_event.metres / (at_event.scale * at_event.scale);
    [step * at_event.by_pixel[0], step * at_event.by_pixel[1]]
}

#[cfg(test)]
mod tests {
    use evcal_core::sensor::Sensor;
    use evcal_core::spline::MAX_ORDER;

    use super::*;
    use crate::solve::rows::bearing_table::BearingTable;
    use crate::solve::rows::board_edge::{BoardEdges, Line, Rim};
    use crate::solve::rows::board_ray::{BoardRay, is_in_front};
    use crate::solve::rows::board_surface::{BoardGround, BoardSurface, FlatBoard};
    use crate::solve::rows::edge_batch::{BatchEvent, EdgeBatch};
    use crate::solve::rows::event_bias::bias::Biases;
    use crate::solve::rows::event_bias::{CLASS_COUNT, unknown};
    use crate::solve::rows::row_batch::RowBatch;
    use crate::solve::{FreeParameters, ITERATIONS, Problem, ResidualMeasure};
    use evcal_core::camera::{Camera, ModelKind};
    use evcal_geometry::board::shape::{BoardShape, CircleArea, Surface};
    use nalgebra::{Matrix3, Rotation3, Vector3};

    /// An event and its ray. A batch computes these data for many events at once.
    pub struct EventRay<S: BoardSurface> {
        /// Column and row.
        pub pixel: [f64; 2],
        /// Its time after the centre of the bin (s).
        pub dt: f64,
        /// Its ray.
        pub ray: BoardRay<S>,
        /// Derivative of its bearing by column and row.
        pub by_pixel: [[f64; 3]; 2],
    }

    /// An event's distance from the projected edge.
    #[derive(Clone, Copy)]
    pub struct EventEdge {
        /// Signed distance in pixels, positive on the light side.
        pub pixels: f64,
        /// The board distance at the position where derivatives are taken.
        pub distance: EdgeDistance,
        /// Motion of the edge as it passes the pixel.
        pub passage: EdgePassage,
    }

    impl EventEdge {
        /// Finds the `edge` of the print for an event; `None` if it is not in view there.
        pub fn of_event<S: BoardSurface>(
            bearings: &BearingTable,
            pose: &PoseBin,
            event: &EventRay<S>,
            edge: impl BoardEdge,
        ) -> Option<Self> {
            let EventRay { pixel, dt, ray, by_pixel } = event;
            let step = step_to_edge(&ray.edge_distance(pose, by_pixel, edge));
            let at = [pixel[0] - step[0], pixel[1] - step[1]];
            let (bearing, by_pixel) = bearings.place(at[0], at[1])?.bearing();
            let ray = BoardRay::new(ray.surface(), pose, *dt, &bearing);
            let distance = ray.edge_distance(pose, &by_pixel, edge);
            let pixels = distance.beyond(step) / distance.scale;
            let passage = EdgePassage::new(pose, &distance, bearings.plane().corner_share(at), edge);
            (is_in_front(ray.depth()) && pixels.is_finite()).then_some(Self { pixels, distance, passage })
        }
    }

    /// Returns a rotating and moving camera with this pose (`T_world_camera`) and one control point.
    fn moving_at(rotation: Rotation3<f64>, translation: Vector3<f64>) -> PoseBin {
        let matrix = rotation.matrix();
        PoseBin {
            rotation: std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)])),
            translation: translation.into(),
            angular_velocity: [0.7, -1.1, 2.0],
            linear_velocity: [0.3, -0.2, 0.4],
            first: 0,
            order: 1,
            rotation_jacobians: [Matrix3::identity(); MAX_ORDER],
            weights: [1.0; MAX_ORDER],
        }
    }

    const CENTER: [f64; 2] = [0.11, 0.165];
    const RADIUS: f64 = 0.0175;
    const LINE: f64 = CENTER[1] - 0.2 * RADIUS;
    const OFFSET: f64 = -0.4;
    const STEP: f64 = 1e-6;
    const AREA: CircleArea = CircleArea { middle: [0.19, 0.22], half: [0.19, 0.22] };
    const FLAT: BoardShape = BoardShape { print_ratio: 1.0, bend: [0.0; 2], radius: RADIUS };
    const SHAPED: BoardShape = BoardShape { print_ratio: 1.02, bend: [0.012, -0.008], radius: 0.0172 };

    fn flat() -> FlatBoard {
        match BoardGround::new(&AREA, &FLAT) {
            BoardGround::Flat(surface) => surface,
            BoardGround::Shaped(_) => panic!("not flat"),
        }
    }

    fn camera(parameters: &[f64]) -> Camera<f64> {
        Camera::from_parameters(ModelKind::Radtan, parameters).unwrap()
    }

    const PARAMETERS: [f64; 9] = [331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03];

    fn reference_pose() -> (Rotation3<f64>, Vector3<f64>) {
        (Rotation3::from_euler_angles(0.25, -0.3, 0.8), Vector3::new(0.2, 0.4, -0.7))
    }

    /// Projects a point of the circle's rim.
    fn rim(camera: &Camera<f64>, shape: &BoardShape) -> nalgebra::Vector2<f64> {
        seen(camera, shape, [CENTER[0] + shape.radius * 0.6, CENTER[1] + shape.radius * 0.8])
    }

    /// Projects a `place` on the print.
    fn seen(camera: &Camera<f64>, shape: &BoardShape, place: [f64; 2]) -> nalgebra::Vector2<f64> {
        let (rotation, translation) = reference_pose();
        let place = Vector3::from(Surface::new(&AREA, shape).place(place));
        camera.project(&(rotation.inverse() * (place - translation))).unwrap()
    }

    fn circle() -> BoardEdges {
        BoardEdges::Rims(vec![CENTER])
    }

    /// A line whose light side is at higher y.
    fn line() -> BoardEdges {
        BoardEdges::Lines(vec![Line { normal: [0.0, 1.0], offset: LINE, dark_width: 0.025, radius: 0.0 }])
    }

    fn problem(edges: BoardEdges) -> Problem {
        Problem {
            sensor: Sensor::new(346, 260),
            points: vec![CENTER],
            edges,
            area: AREA,
            mean_scale: 1.0,
            point_sigma: 1.0,
            associated_latencies: [0.0; CLASS_COUNT],
            segments: Vec::new(),
            stiffness: Vec::new(),
            free: FreeParameters {
                intrinsics: [false; MAX_PARAMETERS],
                board: [false; BOARD_PARAMETERS],
                biases: [Biases::default(); CLASS_COUNT],
            },
            residual: ResidualMeasure::Pixel,
            huber: 1e6,
            iterations: ITERATIONS,
        }
    }

    /// Returns the residual of the event at `pixel`, and its row.
    fn residual(
        edges: &BoardEdges,
        camera: &Camera<f64>,
        pose: &PoseBin,
        dt: f64,
        pixel: [f64; 2],
        shape: &BoardShape,
    ) -> (f64, [f64; ROW]) {
        let problem = problem(edges.clone());
        let table = BearingTable::new(camera, problem.sensor);
        let mut batch = EdgeBatch::default();
        batch.find(&problem, shape, &table, pose, std::iter::once(BatchEvent { pixel, dt, edge: 0 }));
        let mut bias = unknown(1.0)[0];
        bias.biases[Bias::Offset] = OFFSET;
        let mut rows = RowBatch::default();
        rows.set_class(0, &bias, 1.0);
        rows.weigh(batch.edges(), problem.huber, None, 1);
        assert_eq!(rows.collect(batch.cells(), std::iter::once(0)).count, 1);
        (rows.residual(0), rows.rows().0[0])
    }

    /// Compares the row of an event at the `offset` (pixels) from an edge, the rim of the circle or the line, on a board
    /// of this `shape`, with central differences.
    fn assert_derivatives(edges: &BoardEdges, shape: BoardShape, offset: [f64; 2], tolerance: f64) {
        let assert_close = |analytic: f64, numeric: f64, what: &str| {
            let close = (analytic - numeric).abs() < tolerance * (1.0 + numeric.abs());
            assert!(close, "{what}: {analytic} against {numeric}");
        };
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = moving_at(rotation, translation);
        let place = match edges {
            BoardEdges::Rims(_) => rim(&reference, &shape),
            BoardEdges::Lines(_) => seen(&reference, &shape, [CENTER[0] + 0.6 * shape.radius, LINE + shape.radius]),
        };
        let pixel = [place.x + offset[0], place.y + offset[1]];
        let residual = |camera: &Camera<f64>, pose: &PoseBin, dt: f64, pixel: [f64; 2], shape: &BoardShape| {
            residual(edges, camera, pose, dt, pixel, shape)
        };
        let (_, row) = residual(&reference, &bin, 0.0, pixel, &shape);
        let difference = |plus: f64, minus: f64| (plus - minus) / (2.0 * STEP);
        for axis in 0..3 {
            let mut delta = Vector3::zeros();
            delta[axis] = STEP;
            let turned = |delta: Vector3<f64>| moving_at(rotation * Rotation3::new(delta), translation);
            let at = |delta: Vector3<f64>| residual(&reference, &turned(delta), 0.0, pixel, &shape).0;
            assert_close(row[axis], difference(at(delta), at(-delta)), "rotation");
            let at = |delta: Vector3<f64>| {
                residual(&reference, &moving_at(rotation, translation + delta), 0.0, pixel, &shape).0
            };
            assert_close(row[3 + axis], difference(at(delta), at(-delta)), "translation");
        }
        for parameter in 0..PARAMETERS.len() {
            let at = |delta: f64| {
                let mut moved = PARAMETERS;
                moved[parameter] += delta;
                residual(&camera(&moved), &bin, 0.0, pixel, &shape).0
            };
            // Wide enough for the table's single precision.
            let step = 1e3 * STEP;
            assert_close(row[ROW_INTRINSICS + parameter], (at(step) - at(-step)) / (2.0 * step), "intrinsics");
        }
        // A greater latency means an earlier pose.
        let at = |dt: f64| residual(&reference, &bin, dt, pixel, &shape).0;
        assert_close(row[row_bias(Bias::Latency)], difference(at(-STEP), at(STEP)), "latency");
        assert_close(row[row_bias(Bias::Offset)], -1.0, "offset");
        assert_close(row[ROW_RESIDUAL], residual(&reference, &bin, 0.0, pixel, &shape).0, "residual");
        // The ratio moves by tenths of the step: if its derivative is small, the remainder of second order is not.
        let units = [0.1, 1.0, 1.0, 1.0];
        let changes: [fn(&mut BoardShape, f64); BOARD_PARAMETERS] = [
            |shape, step| shape.print_ratio += 0.1 * step,
            |shape, step| shape.bend[0] += step,
            |shape, step| shape.bend[1] += step,
            |shape, step| shape.radius += step,
        ];
        for (parameter, change) in changes.into_iter().enumerate() {
            let at = |step: f64| {
                let mut shape = shape;
                change(&mut shape, step);
                residual(&reference, &bin, 0.0, pixel, &shape).0
            };
            let analytic = units[parameter] * row[ROW_BOARD + parameter];
            assert_close(analytic, difference(at(STEP), at(-STEP)), "board");
        }
    }

    #[test]
    fn derivatives_agree_with_central_differences_on_the_edge() {
        for shape in [FLAT, SHAPED] {
            assert_derivatives(&circle(), shape, [0.0, 0.0], 5e-4);
            assert_derivatives(&line(), shape, [0.0, 0.0], 5e-4);
        }
    }

    #[test]
    fn derivatives_nearly_agree_with_the_edge_one_newton_step_away() {
        // The remainder after one step towards a curved edge is of second order in the distance.
        for shape in [FLAT, SHAPED] {
            for edges in [circle(), line()] {
                assert_derivatives(&edges, shape, [0.4, 0.3], 2e-3);
                assert_derivatives(&edges, shape, [-0.7, 0.2], 2e-3);
            }
        }
    }

    #[test]
    fn a_batch_finds_the_edges_of_its_events_one_by_one() {
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let (bin, rim, problem) = (moving_at(rotation, translation), rim(&reference, &FLAT), problem(circle()));
        let surface = flat();
        let table = BearingTable::new(&reference, problem.sensor);
        let pixel = |index: u32| [rim.x + f64::from(index % 5) * 0.7 - 1.4, rim.y + f64::from(index % 7) * 0.5 - 1.5];
        let dt = |index: u32| f64::from(index) * 1e-5;
        let events = (0..27).map(|index| BatchEvent { pixel: pixel(index), dt: dt(index), edge: 0 });
        let mut batch = EdgeBatch::default();
        batch.find(&problem, &FLAT, &table, &bin, events);
        for index in 0..27 {
            let [x, y] = pixel(index);
            let (bearing, by_pixel) = table.place(x, y).unwrap().bearing();
            let ray = BoardRay::new(&surface, &bin, dt(index), &bearing);
            let event = EventRay { pixel: [x, y], dt: dt(index), ray, by_pixel };
            let edge = EventEdge::of_event(&table, &bin, &event, Rim { center: CENTER, radius: RADIUS }).unwrap();
            let lane = index as usize;
            assert!(batch.cells()[lane].is_some());
            let (edges, passage) = (batch.edges(), batch.edges().passage(lane));
            assert!((edges.pixels[lane] - edge.pixels).abs() < 1e-4, "{} {}", edges.pixels[lane], edge.pixels);
            assert_close(edges.scale[lane] / edge.distance.scale, 1.0, "scale");
            assert_close(passage.normal_speed / edge.passage.normal_speed, 1.0, "speed");
            assert_close(passage.acceleration / edge.passage.acceleration, 1.0, "acceleration");
        }
    }

    fn assert_close(analytic: f64, numeric: f64, what: &str) {
        assert!((analytic - numeric).abs() < 1e-5 * (1.0 + numeric.abs()), "{what}: {analytic} against {numeric}");
    }

    #[test]
    fn scale_is_the_board_distance_of_one_pixel_across_the_edge() {
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = moving_at(rotation, translation);
        let metres = |x: f64, y: f64| {
            let bearing = reference.unproject(&nalgebra::Vector2::new(x, y)).unwrap();
            (BoardRay::new(&flat(), &bin, 0.0, &bearing.into()).point() - nalgebra::Vector2::from(CENTER)).norm()
                - RADIUS
        };
        let (x, y) = (rim(&reference, &FLAT).x.round(), rim(&reference, &FLAT).y.round());
        let slope_x = (metres(x + 1e-4, y) - metres(x - 1e-4, y)) / 2e-4;
        let slope_y = (metres(x, y + 1e-4) - metres(x, y - 1e-4)) / 2e-4;
        let table = BearingTable::new(&reference, Sensor::new(346, 260));
        let (bearing, by_pixel) = table.place(x, y).unwrap().bearing();
        let distance = BoardRay::new(&flat(), &bin, 0.0, &bearing).edge_distance(
            &bin,
            &by_pixel,
            Rim { center: CENTER, radius: RADIUS },
        );
        assert_close(distance.scale / slope_x.hypot(slope_y), 1.0, "scale");
        assert_close(distance.metres, metres(x, y), "metres");
    }

    #[test]
    fn a_shaped_board_with_zero_shape_equals_the_flat_one() {
        let (rotation, translation) = reference_pose();
        let (bin, reference) = (moving_at(rotation, translation), camera(&PARAMETERS));
        let nearly = BoardShape { print_ratio: 1.0 + 1e-13, ..FLAT };
        let rim = rim(&reference, &FLAT);
        let [flat, shaped] =
            [FLAT, nearly].map(|shape| residual(&circle(), &reference, &bin, 1e-4, [rim.x, rim.y], &shape));
        for (flat, shaped) in flat.1.into_iter().zip(shaped.1) {
            assert!((flat - shaped).abs() < 1e-6 * (1.0 + flat.abs()), "{flat} {shaped}");
        }
    }

    #[test]
    fn board_velocity_is_the_motion_of_the_ray_on_the_board() {
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = moving_at(rotation, translation);
        let bearing: [f64; 3] = reference.unproject(&nalgebra::Vector2::new(100.0, 50.0)).unwrap().into();
        let at = |dt: f64| BoardRay::new(&flat(), &bin, dt, &bearing);
        let numeric = (at(STEP).point() - at(-STEP).point()) / (2.0 * STEP);
        let analytic = nalgebra::Vector2::from(at(0.0).velocity(&bin));
        assert!((numeric - analytic).norm() < 1e-6 * analytic.norm());
    }
}
