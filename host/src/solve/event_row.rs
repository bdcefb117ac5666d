//! The residual of one event and its derivatives.
//!
//! The residual is the distance in pixels from the event's pixel m to the projected edge, minus the
//! distance at which its class is expected. One Newton step from m gives a point m' on the edge;
//! there the board distance f ([`board_ray`](super::board_ray)), its gradient and all derivatives are
//! taken: r = n'·(m − m') + f(m') / s(m') − expected distance, with n' the unit normal. Derivatives
//! taken at m instead would leave out how the scale itself answers to the parameters, which is of the
//! same order as the weakest combinations of parameters. For the paper's plane residual, r = f(m)
//! over a constant scale.
//!
//! ∂r/∂k = −n' · ∂m'/∂k, ∂r/∂offset = −1, ∂r/∂latency = −v, ∂r/∂bend = −v², ∂r/∂curvature = −1/ρ,
//! ∂r/∂(corner latency) = −v s², ∂r/∂(curvature latency) = −v/ρ, ∂r/∂memory = −a, with the normal speed
//! v = dr/dt, the dot's radius ρ in pixels, the distance s from the middle of the sensor and the edge's
//! acceleration a (see [`crate::solve::event_bias`]).

use evcal_core::camera::{MAX_COEFFICIENTS, MAX_PARAMETERS};

use crate::solve::event_bias::bias::Bias;
use crate::solve::event_bias::{ClassBias, EdgePassage};

use super::ResidualMeasure;
use super::bearing_table::{BearingTable, Place};
use super::board_ray::{BoardRay, EdgeDistance, is_in_front};
use super::pose_bin::PoseBin;

/// Length of a row: pose (rotation 3, translation 3), intrinsics, biases of the class, residual, and
/// padding to a multiple of the vector width.
pub const ROW: usize = 32;
/// Where the intrinsics begin in a row.
pub const ROW_INTRINSICS: usize = 6;
/// Where the coefficients of the camera model begin in a row, after fx, fy, cx and cy.
const ROW_COEFFICIENTS: usize = ROW_INTRINSICS + 4;
/// Where the biases of the class begin in a row.
const ROW_BIASES: usize = ROW_INTRINSICS + MAX_PARAMETERS;
/// Where a bias of the class stands in a row.
pub const fn row_bias(bias: Bias) -> usize {
    ROW_BIASES + bias.index()
}
/// Where the residual stands in a row.
pub const ROW_RESIDUAL: usize = ROW_BIASES + Bias::COUNT;

/// An event's distance from the projected edge.
#[derive(Clone, Copy)]
pub struct EventEdge<'a> {
    /// Signed distance in pixels, positive outside the circle.
    pub pixels: f64,
    /// The board distance where derivatives are taken.
    pub distance: EdgeDistance,
    /// Where derivatives are taken.
    pub place: Place<'a>,
    /// Normal speed of the edge in pixels per second, positive where pixels leave the dot.
    pub normal_speed: f64,
    /// One over the radius of the dot in pixels.
    pub inverse_radius: f64,
    /// Second derivative of the distance by time at a fixed pixel, as far as it comes from the dot being
    /// round (px/s²).
    pub acceleration: f64,
}

impl<'a> EventEdge<'a> {
    /// The edge of the circle at `center` (metres) for the event at `pixel`, `dt` seconds after the
    /// centre of the bin, whose ray is `ray` and whose bearing changes `by_pixel`; `None` when the edge is
    /// not in view there.
    pub fn of_event(
        bearings: &'a BearingTable,
        pose: &PoseBin,
        (pixel, dt): ([f64; 2], f64),
        (ray, by_pixel): (&BoardRay, &[[f64; 3]; 2]),
        center: [f64; 2],
        radius: f64,
    ) -> Option<Self> {
        let step = step_to_edge(&ray.edge_distance(pose, by_pixel, center, radius));
        let place = bearings.place(pixel[0] - step[0], pixel[1] - step[1])?;
        let (bearing, by_pixel) = place.bearing();
        let ray = BoardRay::new(pose, dt, &bearing);
        let at_edge = ray.edge_distance(pose, &by_pixel, center, radius);
        let edge = Self::new(pose, at_edge, place, step, radius, ResidualMeasure::Pixel, 1.0);
        (is_in_front(ray.depth()) && edge.pixels.is_finite()).then_some(edge)
    }

    /// From the board distance at the edge, `step` pixels from the event.
    #[inline(always)]
    pub fn new(
        pose: &PoseBin,
        at_edge: EdgeDistance,
        place: Place<'a>,
        step: [f64; 2],
        radius: f64,
        residual: ResidualMeasure,
        mean_scale: f64,
    ) -> Self {
        let along = at_edge.by_pixel[0] * step[0] + at_edge.by_pixel[1] * step[1];
        let pixels = match residual {
            ResidualMeasure::Pixel => (along + at_edge.metres) / at_edge.scale,
            ResidualMeasure::Plane => at_edge.metres / mean_scale,
        };
        let normal_speed = at_edge.normal_speed(pose);
        Self {
            pixels,
            normal_speed,
            inverse_radius: at_edge.scale / radius,
            acceleration: at_edge.sliding * at_edge.sliding / (radius * at_edge.scale),
            distance: at_edge,
            place,
        }
    }

    /// What the expected distance depends on.
    #[inline(always)]
    pub fn passage(&self) -> EdgePassage {
        EdgePassage {
            normal_speed: self.normal_speed,
            inverse_radius: self.inverse_radius,
            corner_share: self.place.corner_share,
            acceleration: self.acceleration,
        }
    }

    /// Distance in pixels from where the class's events are expected.
    #[inline(always)]
    pub fn from_expected(&self, bias: &ClassBias) -> f64 {
        self.pixels - bias.distance(&self.passage())
    }

    /// Fills the row of the event: derivatives and `residual` (its distance from where its class is
    /// expected, in pixels), all times `weight`. `scale` is metres on the board for each unit of the
    /// residual.
    #[inline(always)]
    pub fn fill_row(&self, row: &mut [f64; ROW], residual: f64, weight: f64, scale: f64) {
        let factor = weight / scale;
        let distance = &self.distance;
        for axis in 0..3 {
            row[axis] = distance.by_rotation[axis] * factor;
            row[3 + axis] = distance.by_translation[axis] * factor;
        }
        let (linear, coefficients) = self.place.by_intrinsics(distance.by_pixel.map(|value| -value * factor));
        row[ROW_INTRINSICS..ROW_COEFFICIENTS].copy_from_slice(&linear);
        row[ROW_COEFFICIENTS..ROW_COEFFICIENTS + MAX_COEFFICIENTS].copy_from_slice(&coefficients);
        for (entry, derivative) in row[ROW_BIASES..].iter_mut().zip(self.passage().derivatives().as_array()) {
            *entry = -derivative * weight;
        }
        row[ROW_RESIDUAL] = residual * weight;
    }
}

/// Newton's step from the edge to the pixel, in pixels.
#[inline(always)]
pub fn step_to_edge(at_event: &EdgeDistance) -> [f64; 2] {
    let step = at_event.metres / (at_event.scale * at_event.scale);
    at_event.by_pixel.map(|by_pixel| step * by_pixel)
}

#[cfg(test)]
mod tests {
    use evcal_core::sensor::Sensor;

    use super::*;
    use evcal_core::camera::{Camera, ModelKind};
    use evcal_core::spline::MAX_ORDER;
    use nalgebra::{Matrix3, Rotation3, Vector3};

    const CENTER: [f64; 2] = [0.11, 0.165];
    const RADIUS: f64 = 0.0175;
    const OFFSET: f64 = -0.4;
    const STEP: f64 = 1e-6;

    fn camera(parameters: &[f64]) -> Camera<f64> {
        Camera::from_parameters(ModelKind::Radtan, parameters).unwrap()
    }

    const PARAMETERS: [f64; 9] = [331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03];

    fn pose(rotation: Rotation3<f64>, translation: Vector3<f64>) -> PoseBin {
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

    fn reference_pose() -> (Rotation3<f64>, Vector3<f64>) {
        (Rotation3::from_euler_angles(0.25, -0.3, 0.8), Vector3::new(0.2, 0.4, -0.7))
    }

    /// Where a point of the circle's rim is seen.
    fn rim(camera: &Camera<f64>) -> nalgebra::Vector2<f64> {
        let (rotation, translation) = reference_pose();
        let rim = Vector3::new(CENTER[0] + RADIUS * 0.6, CENTER[1] + RADIUS * 0.8, 0.0);
        camera.project(&(rotation.inverse() * (rim - translation))).unwrap()
    }

    fn residual(camera: &Camera<f64>, pose: &PoseBin, dt: f64, [x, y]: [f64; 2]) -> (f64, [f64; ROW]) {
        let table = BearingTable::new(camera, Sensor::new(346, 260));
        let (bearing, by_pixel) = table.place(x, y).unwrap().bearing();
        let ray = BoardRay::new(pose, dt, &bearing);
        let edge = EventEdge::of_event(&table, pose, ([x, y], dt), (&ray, &by_pixel), CENTER, RADIUS).unwrap();
        let residual = edge.pixels - OFFSET;
        let mut row = [0.0; ROW];
        edge.fill_row(&mut row, residual, 1.0, edge.distance.scale);
        (residual, row)
    }

    /// Compares the row of an event `beside` pixels from the rim with central differences.
    fn assert_derivatives(beside: [f64; 2], tolerance: f64) {
        let assert_close = |analytic: f64, numeric: f64, what: &str| {
            let close = (analytic - numeric).abs() < tolerance * (1.0 + numeric.abs());
            assert!(close, "{what}: {analytic} against {numeric}");
        };
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = pose(rotation, translation);
        let rim = rim(&reference);
        let pixel = [rim.x + beside[0], rim.y + beside[1]];
        let (_, row) = residual(&reference, &bin, 0.0, pixel);
        let difference = |plus: f64, minus: f64| (plus - minus) / (2.0 * STEP);
        for axis in 0..3 {
            let mut delta = Vector3::zeros();
            delta[axis] = STEP;
            let turned = |delta: Vector3<f64>| pose(rotation * Rotation3::new(delta), translation);
            let at = |delta: Vector3<f64>| residual(&reference, &turned(delta), 0.0, pixel).0;
            assert_close(row[axis], difference(at(delta), at(-delta)), "rotation");
            let at = |delta: Vector3<f64>| residual(&reference, &pose(rotation, translation + delta), 0.0, pixel).0;
            assert_close(row[3 + axis], difference(at(delta), at(-delta)), "translation");
        }
        for parameter in 0..PARAMETERS.len() {
            let at = |delta: f64| {
                let mut moved = PARAMETERS;
                moved[parameter] += delta;
                residual(&camera(&moved), &bin, 0.0, pixel).0
            };
            // Wide enough for the table's single precision.
            let step = 1e3 * STEP;
            assert_close(row[ROW_INTRINSICS + parameter], (at(step) - at(-step)) / (2.0 * step), "intrinsics");
        }
        // A later latency means an earlier pose.
        let at = |dt: f64| residual(&reference, &bin, dt, pixel).0;
        assert_close(row[row_bias(Bias::Latency)], difference(at(-STEP), at(STEP)), "latency");
        assert_close(row[row_bias(Bias::Offset)], -1.0, "offset");
        assert_close(row[ROW_RESIDUAL], residual(&reference, &bin, 0.0, pixel).0, "residual");
    }

    #[test]
    fn derivatives_agree_with_central_differences_on_the_edge() {
        assert_derivatives([0.0, 0.0], 5e-4);
    }

    #[test]
    fn derivatives_are_nearly_those_of_the_edge_one_newton_step_away() {
        // What is left after one step towards a curved edge is of second order in the distance.
        assert_derivatives([0.4, 0.3], 2e-3);
        assert_derivatives([-0.7, 0.2], 2e-3);
    }

    fn assert_close(analytic: f64, numeric: f64, what: &str) {
        assert!((analytic - numeric).abs() < 1e-5 * (1.0 + numeric.abs()), "{what}: {analytic} against {numeric}");
    }

    #[test]
    fn scale_is_the_board_distance_of_one_pixel_across_the_edge() {
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = pose(rotation, translation);
        let metres = |x: f64, y: f64| {
            let bearing = reference.unproject(&nalgebra::Vector2::new(x, y)).unwrap();
            (BoardRay::new(&bin, 0.0, &bearing.into()).point() - nalgebra::Vector2::from(CENTER)).norm() - RADIUS
        };
        let (x, y) = (rim(&reference).x.round(), rim(&reference).y.round());
        let slope_x = (metres(x + 1e-4, y) - metres(x - 1e-4, y)) / 2e-4;
        let slope_y = (metres(x, y + 1e-4) - metres(x, y - 1e-4)) / 2e-4;
        let table = BearingTable::new(&reference, Sensor::new(346, 260));
        let (bearing, by_pixel) = table.place(x, y).unwrap().bearing();
        let distance = BoardRay::new(&bin, 0.0, &bearing).edge_distance(&bin, &by_pixel, CENTER, RADIUS);
        assert_close(distance.scale / slope_x.hypot(slope_y), 1.0, "scale");
        assert_close(distance.metres, metres(x, y), "metres");
    }

    #[test]
    fn board_velocity_is_the_motion_of_the_ray_on_the_board() {
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = pose(rotation, translation);
        let bearing: [f64; 3] = reference.unproject(&nalgebra::Vector2::new(100.0, 50.0)).unwrap().into();
        let at = |dt: f64| BoardRay::new(&bin, dt, &bearing);
        let numeric = (at(STEP).point() - at(-STEP).point()) / (2.0 * STEP);
        let analytic = nalgebra::Vector2::from(at(0.0).velocity(&bin));
        assert!((numeric - analytic).norm() < 1e-6 * analytic.norm());
    }
}
