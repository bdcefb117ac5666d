//! The residual of one event and its derivatives.
//!
//! With the bearing b of the event's pixel, the pose (R, p) = `T_world_camera` at its time and its
//! circle's centre l on the board plane z = 0:
//!
//! d = R b, X = p − (p_z / d_z) d (the ray meets the board), n = (X − l) / ‖X − l‖,
//! f = ‖X − l‖ − radius, h = λ (n_x, n_y, −(n · d_xy) / d_z), λ = −p_z / d_z,
//! ∂f/∂ω = b × Rᵀh (rotation perturbed in the camera frame), ∂f/∂p = h / λ, ∂f/∂k = Rᵀh · ∂b/∂k,
//! ∂f/∂pixel = Rᵀh · ∂b/∂pixel, and s = ‖∂f/∂pixel‖ is the local scale in metres per pixel.
//!
//! The residual is the distance in pixels from the event's pixel m to the projected edge, minus the
//! offset of its class. One Newton step from m gives a point m' on the edge; there f, its gradient
//! and all derivatives are taken: r = n'·(m − m') + f(m') / s(m') − expected distance, with n' the unit normal.
//! Derivatives taken at m instead would leave out how the scale itself answers to the parameters,
//! which is of the same order as the weakest combinations of parameters. For the paper's plane
//! residual, r = f(m) over a constant scale.
//!
//! ∂r/∂offset = −1, ∂r/∂latency = −v, ∂r/∂bend = −v², ∂r/∂curvature = −1/ρ, with the normal speed
//! v = dr/dt and the dot's radius ρ in pixels (see [`crate::event_bias`]).

use evcal_core::camera::MAX_PARAMETERS;
use nalgebra::Vector2;

use crate::event_bias::{BIAS_COUNT, ClassBias};

use super::bearing_table::{BearingTable, PixelBearing};
use super::pose_bin::{MovedPose, PoseBin, cross, dot};

/// Where the ray of a pixel meets the board, relative to a circle.
#[derive(Clone, Copy, Debug)]
pub struct EdgeDistance {
    /// Signed distance from the circle's edge in metres on the board plane, positive outside.
    pub metres: f64,
    /// Metres on the board plane for each pixel across the edge.
    pub scale: f64,
    /// Derivative of `metres` by pixel x and y.
    by_pixel: [f64; 2],
    /// Derivative of `metres` by the bearing in the camera frame.
    by_bearing: [f64; 3],
    /// Derivative of `metres` by the camera centre in the world frame.
    by_translation: [f64; 3],
    /// Derivative of `metres` by a rotation perturbation in the camera frame.
    by_rotation: [f64; 3],
}

impl EdgeDistance {
    /// Signed distance from the edge in pixels, positive outside the circle.
    #[inline(always)]
    pub fn pixels(&self) -> f64 {
        self.metres / self.scale
    }

    /// How fast the distance grows at a fixed pixel, in pixels per second: the normal speed of the
    /// edge, positive where the pixel leaves the dot (it becomes brighter).
    #[inline(always)]
    pub fn normal_speed(&self, pose: &PoseBin) -> f64 {
        (dot(&self.by_rotation, &pose.angular_velocity) + dot(&self.by_translation, &pose.linear_velocity)) / self.scale
    }
}

/// Point where the ray of `bearing` meets the board plane, in metres; `None` when it does not meet
/// it in front of the camera.
#[inline(always)]
pub fn board_point(pose: &PoseBin, moved: &MovedPose, bearing: &[f64; 3]) -> Option<Vector2<f64>> {
    let direction = pose.to_world(&pose.bearing_at_center(moved, bearing));
    let depth = -moved.translation[2] / direction[2];
    // Also false for NaN and for rays parallel to the board.
    (depth > 0.0 && depth < 1e6)
        .then(|| Vector2::new(moved.translation[0] + depth * direction[0], moved.translation[1] + depth * direction[1]))
}

/// Distance of a pixel's ray from the edge of the circle with `center` and `radius` (metres).
#[inline(always)]
pub fn edge_distance(
    pose: &PoseBin,
    moved: &MovedPose,
    pixel: &PixelBearing,
    center: [f64; 2],
    radius: f64,
) -> Option<EdgeDistance> {
    bearing_distance(pose, moved, &pixel.bearing, &pixel.by_pixel, center, radius)
}

#[inline(always)]
fn bearing_distance(
    pose: &PoseBin,
    moved: &MovedPose,
    bearing: &[f64; 3],
    bearing_by_pixel: &[[f64; 3]; 2],
    center: [f64; 2],
    radius: f64,
) -> Option<EdgeDistance> {
    let bearing = pose.bearing_at_center(moved, bearing);
    let direction = pose.to_world(&bearing);
    let inverse = 1.0 / direction[2];
    let depth = -moved.translation[2] * inverse;
    let x = moved.translation[0] + depth * direction[0] - center[0];
    let y = moved.translation[1] + depth * direction[1] - center[1];
    let distance = (x * x + y * y).sqrt();
    if !(depth > 0.0 && distance > 1e-9) {
        return None;
    }
    let (normal_x, normal_y) = (x / distance, y / distance);
    let by_translation = [normal_x, normal_y, -(normal_x * direction[0] + normal_y * direction[1]) * inverse];
    let by_direction = by_translation.map(|value| depth * value);
    let by_bearing = pose.to_camera(&by_direction);
    let by_rotation = cross(&bearing, &by_bearing);
    let by_pixel = [dot(&by_bearing, &bearing_by_pixel[0]), dot(&by_bearing, &bearing_by_pixel[1])];
    let scale = (by_pixel[0] * by_pixel[0] + by_pixel[1] * by_pixel[1]).sqrt();
    Some(EdgeDistance { metres: distance - radius, scale, by_pixel, by_bearing, by_translation, by_rotation })
}

/// Length of a row: pose (rotation 3, translation 3), intrinsics, biases of the class, residual, and
/// padding to a multiple of the vector width.
pub const ROW: usize = 24;
/// Where the intrinsics begin in a row.
pub const ROW_INTRINSICS: usize = 6;
/// Where the biases of the class begin in a row.
pub const ROW_OFFSET: usize = ROW_INTRINSICS + MAX_PARAMETERS;
/// Where the residual stands in a row.
pub const ROW_RESIDUAL: usize = ROW_OFFSET + BIAS_COUNT;

/// An event's distance from the projected edge.
#[derive(Clone, Copy)]
pub struct EdgeResidual<'a> {
    /// Signed distance in pixels, positive outside the circle.
    pub pixels: f64,
    /// The board distance where derivatives are taken.
    pub distance: EdgeDistance,
    /// The bearing table's entry where derivatives are taken.
    pub bearing: &'a PixelBearing,
    /// Normal speed of the edge in pixels per second, positive where pixels leave the dot.
    pub normal_speed: f64,
    /// One over the radius of the dot in pixels.
    pub inverse_radius: f64,
}

impl EdgeResidual<'_> {
    /// Distance in pixels from where the class's events are expected.
    #[inline(always)]
    pub fn from_expected(&self, bias: &ClassBias) -> f64 {
        self.pixels - bias.distance(self.normal_speed, self.inverse_radius)
    }
}

/// Distance in pixels of pixel (`x`, `y`) from the projected edge of a circle; `None` when the edge
/// is not in view there.
#[inline(always)]
pub fn pixel_residual<'a>(
    pose: &PoseBin,
    moved: &MovedPose,
    bearings: &'a BearingTable,
    (x, y): (u16, u16),
    center: [f64; 2],
    radius: f64,
) -> Option<EdgeResidual<'a>> {
    let at_event = edge_distance(pose, moved, bearings.get(x, y)?, center, radius)?;
    let step = at_event.metres / (at_event.scale * at_event.scale);
    let (step_x, step_y) = (step * at_event.by_pixel[0], step * at_event.by_pixel[1]);
    let (edge_x, edge_y) = (f64::from(x) - step_x, f64::from(y) - step_y);
    // Bearings between pixels follow from the nearest pixel; NaN and negative values end as 0.
    let (near_x, near_y) = (edge_x.round(), edge_y.round());
    if !(near_x >= 0.0 && near_y >= 0.0) {
        return None;
    }
    let nearest = bearings.get(near_x as u16, near_y as u16)?;
    let (rest_x, rest_y) = (edge_x - near_x, edge_y - near_y);
    let bearing = std::array::from_fn(|axis| {
        nearest.bearing[axis] + rest_x * nearest.by_pixel[0][axis] + rest_y * nearest.by_pixel[1][axis]
    });
    let at_edge = bearing_distance(pose, moved, &bearing, &nearest.by_pixel, center, radius)?;
    let along = (at_edge.by_pixel[0] * step_x + at_edge.by_pixel[1] * step_y) / at_edge.scale;
    Some(EdgeResidual {
        pixels: along + at_edge.metres / at_edge.scale,
        normal_speed: at_edge.normal_speed(pose),
        inverse_radius: at_edge.scale / radius,
        distance: at_edge,
        bearing: nearest,
    })
}

/// Distance on the board plane of the pixel's ray from the edge, in units of `mean_scale`: the
/// paper's residual.
#[inline(always)]
pub fn plane_residual<'a>(
    pose: &PoseBin,
    moved: &MovedPose,
    bearings: &'a BearingTable,
    (x, y): (u16, u16),
    center: [f64; 2],
    radius: f64,
    mean_scale: f64,
) -> Option<EdgeResidual<'a>> {
    let bearing = bearings.get(x, y)?;
    let distance = edge_distance(pose, moved, bearing, center, radius)?;
    let distance = EdgeDistance { scale: mean_scale, ..distance };
    Some(EdgeResidual {
        pixels: distance.metres / mean_scale,
        normal_speed: distance.normal_speed(pose),
        inverse_radius: mean_scale / radius,
        distance,
        bearing,
    })
}

/// Fills the row of one event: derivatives and `residual` (its distance from where its class is
/// expected, in pixels), all times `weight`.
#[inline(always)]
pub fn fill_row(row: &mut [f64; ROW], edge: &EdgeResidual, residual: f64, weight: f64) {
    let factor = weight / edge.distance.scale;
    let distance = &edge.distance;
    for axis in 0..3 {
        row[axis] = distance.by_rotation[axis] * factor;
        row[3 + axis] = distance.by_translation[axis] * factor;
    }
    let scaled = distance.by_bearing.map(|value| value * factor);
    for parameter in 0..MAX_PARAMETERS {
        row[ROW_INTRINSICS + parameter] = scaled[0] * edge.bearing.by_parameter[0][parameter]
            + scaled[1] * edge.bearing.by_parameter[1][parameter]
            + scaled[2] * edge.bearing.by_parameter[2][parameter];
    }
    row[ROW_OFFSET] = -weight;
    row[ROW_OFFSET + 1] = -edge.normal_speed * weight;
    row[ROW_OFFSET + 2] = -edge.normal_speed * edge.normal_speed * weight;
    row[ROW_OFFSET + 3] = -edge.inverse_radius * weight;
    row[ROW_RESIDUAL] = residual * weight;
}

/// Velocity in m/s with which the point where a fixed pixel's ray meets the board moves over it.
#[inline(always)]
pub fn board_velocity(pose: &PoseBin, moved: &MovedPose, bearing: &[f64; 3]) -> Vector2<f64> {
    let bearing = pose.bearing_at_center(moved, bearing);
    let direction = pose.to_world(&bearing);
    let turning = pose.to_world(&cross(&pose.angular_velocity, &bearing));
    let depth = -moved.translation[2] / direction[2];
    let depth_rate = -(pose.linear_velocity[2] + depth * turning[2]) / direction[2];
    Vector2::new(
        pose.linear_velocity[0] + depth_rate * direction[0] + depth * turning[0],
        pose.linear_velocity[1] + depth_rate * direction[1] + depth * turning[1],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::bearing_table::BearingTable;
    use evcal_core::camera::{Camera, ModelKind};
    use evcal_core::spline::MAX_ORDER;
    use nalgebra::{Matrix3, Rotation3, Vector3};

    const CENTER: [f64; 2] = [0.11, 0.165];
    const RADIUS: f64 = 0.0175;
    const OFFSET: f64 = -0.4;
    const STEP: f64 = 1e-6;
    const MEAN_SCALE: f64 = 2e-3;

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

    /// The pixel near the edge of the circle at which all derivatives are taken.
    fn pixel(camera: &Camera<f64>) -> (u16, u16) {
        let (rotation, translation) = reference_pose();
        let rim = Vector3::new(CENTER[0] + RADIUS * 0.6, CENTER[1] + RADIUS * 0.8, 0.0);
        let projected = camera.project(&(rotation.inverse() * (rim - translation))).unwrap();
        (projected.x.round() as u16, projected.y.round() as u16)
    }

    fn residual(camera: &Camera<f64>, pose: &PoseBin, dt: f64) -> (f64, [f64; ROW]) {
        let table = BearingTable::new(camera, (346, 260));
        let at = pixel(&self::camera(&PARAMETERS));
        // The plane residual has no table between pixels, so that its derivatives are exact; the pixel
        // residual takes the same ones at the edge.
        let edge = plane_residual(pose, &pose.moved(dt), &table, at, CENTER, RADIUS, MEAN_SCALE).unwrap();
        let residual = edge.pixels - OFFSET;
        let mut row = [0.0; ROW];
        fill_row(&mut row, &edge, residual, 1.0);
        (residual, row)
    }

    fn assert_close(analytic: f64, numeric: f64, what: &str) {
        assert!((analytic - numeric).abs() < 1e-5 * (1.0 + numeric.abs()), "{what}: {analytic} against {numeric}");
    }

    #[test]
    fn derivatives_agree_with_central_differences() {
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = pose(rotation, translation);
        let (_, row) = residual(&reference, &bin, 0.0);
        let difference = |plus: f64, minus: f64| (plus - minus) / (2.0 * STEP);
        for axis in 0..3 {
            let mut delta = Vector3::zeros();
            delta[axis] = STEP;
            let at =
                |delta: Vector3<f64>| residual(&reference, &pose(rotation * Rotation3::new(delta), translation), 0.0).0;
            assert_close(row[axis], difference(at(delta), at(-delta)), "rotation");
            let at = |delta: Vector3<f64>| residual(&reference, &pose(rotation, translation + delta), 0.0).0;
            assert_close(row[3 + axis], difference(at(delta), at(-delta)), "translation");
        }
        for parameter in 0..PARAMETERS.len() {
            let at = |delta: f64| {
                let mut moved = PARAMETERS;
                moved[parameter] += delta;
                residual(&camera(&moved), &bin, 0.0).0
            };
            assert_close(row[ROW_INTRINSICS + parameter], difference(at(STEP), at(-STEP)), "intrinsics");
        }
        // A later latency means an earlier pose.
        let at = |dt: f64| residual(&reference, &bin, dt).0;
        assert_close(row[ROW_OFFSET + 1], difference(at(-STEP), at(STEP)), "latency");
        assert_close(row[ROW_OFFSET], -1.0, "offset");
        assert_close(row[ROW_RESIDUAL], residual(&reference, &bin, 0.0).0, "residual");
    }

    #[test]
    fn scale_is_the_board_distance_of_one_pixel_across_the_edge() {
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = pose(rotation, translation);
        let (x, y) = pixel(&reference);
        let metres = |x: f64, y: f64| {
            let bearing = reference.unproject(&nalgebra::Vector2::new(x, y)).unwrap();
            let point = board_point(&bin, &bin.moved(0.0), &bearing.into()).unwrap();
            (point - nalgebra::Vector2::from(CENTER)).norm() - RADIUS
        };
        let (x, y) = (f64::from(x), f64::from(y));
        let slope_x = (metres(x + 1e-4, y) - metres(x - 1e-4, y)) / 2e-4;
        let slope_y = (metres(x, y + 1e-4) - metres(x, y - 1e-4)) / 2e-4;
        let table = BearingTable::new(&reference, (346, 260));
        let distance =
            edge_distance(&bin, &bin.moved(0.0), table.get(x as u16, y as u16).unwrap(), CENTER, RADIUS).unwrap();
        assert_close(distance.scale / slope_x.hypot(slope_y), 1.0, "scale");
        assert_close(distance.metres, metres(x, y), "metres");
    }

    #[test]
    fn board_velocity_is_the_motion_of_the_ray_on_the_board() {
        let (rotation, translation) = reference_pose();
        let reference = camera(&PARAMETERS);
        let bin = pose(rotation, translation);
        let bearing: [f64; 3] = reference.unproject(&nalgebra::Vector2::new(100.0, 50.0)).unwrap().into();
        let at = |dt: f64| board_point(&bin, &bin.moved(dt), &bearing).unwrap();
        let numeric = (at(STEP) - at(-STEP)) / (2.0 * STEP);
        let analytic = board_velocity(&bin, &bin.moved(0.0), &bearing);
        assert!((numeric - analytic).norm() < 1e-6 * analytic.norm());
    }
}
