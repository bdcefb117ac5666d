//! The residual of one event and its derivatives.
//!
//! With the bearing b of the event's pixel, the pose (R, p) = `T_world_camera` at its time and its
//! circle's centre l on the board plane z = 0:
//!
//! d = R b, X = p − (p_z / d_z) d (the ray meets the board), n = (X − l) / ‖X − l‖,
//! r = (‖X − l‖ − radius) / s − offset,
//!
//! where s = ‖∂‖X − l‖ / ∂pixel‖ is the local scale in metres per pixel (1 / mean scale for the
//! plane residual of the paper). With h = λ (n_x, n_y, −(n · d_xy) / d_z), λ = −p_z / d_z:
//! ∂r/∂ω = b × Rᵀh / s (rotation perturbed in the camera frame), ∂r/∂p = h / (λ s),
//! ∂r/∂k = (Rᵀh · ∂b/∂k) / s, ∂r/∂offset = −1, ∂r/∂latency = −dr/dt.

use evcal_core::camera::MAX_PARAMETERS;
use nalgebra::Vector2;

use super::bearing_table::PixelBearing;
use super::pose_bin::{MovedPose, PoseBin, cross, dot};

/// Where the ray of a pixel meets the board, relative to a circle.
#[derive(Clone, Copy, Debug)]
pub struct EdgeDistance {
    /// Signed distance from the circle's edge in metres on the board plane, positive outside.
    pub metres: f64,
    /// Metres on the board plane for each pixel across the edge.
    pub scale: f64,
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
    let bearing = pose.bearing_at_center(moved, &pixel.bearing);
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
    let by_translation =
        [normal_x, normal_y, -(normal_x * direction[0] + normal_y * direction[1]) * inverse];
    let by_direction = by_translation.map(|value| depth * value);
    let by_bearing = pose.to_camera(&by_direction);
    let by_rotation = cross(&bearing, &by_bearing);
    let scale_x = dot(&by_bearing, &pixel.by_pixel[0]);
    let scale_y = dot(&by_bearing, &pixel.by_pixel[1]);
    let scale = (scale_x * scale_x + scale_y * scale_y).sqrt();
    Some(EdgeDistance { metres: distance - radius, scale, by_bearing, by_translation, by_rotation })
}

/// Length of a row: pose (rotation 3, translation 3), intrinsics, offset, latency, residual, and
/// padding to a multiple of the vector width.
pub const ROW: usize = 24;
/// Where the intrinsics begin in a row.
pub const ROW_INTRINSICS: usize = 6;
/// Where the offset stands in a row; the latency follows.
pub const ROW_OFFSET: usize = ROW_INTRINSICS + MAX_PARAMETERS;
/// Where the residual stands in a row.
pub const ROW_RESIDUAL: usize = ROW_OFFSET + 2;

/// Fills the row of one event: derivatives and the residual, all times `weight`; the residual is
/// (`metres` · `inverse_scale` − `offset`).
#[inline(always)]
pub fn fill_row(
    row: &mut [f64; ROW],
    distance: &EdgeDistance,
    pose: &PoseBin,
    pixel: &PixelBearing,
    inverse_scale: f64,
    residual: f64,
    weight: f64,
) {
    let factor = inverse_scale * weight;
    let speed = (dot(&distance.by_rotation, &pose.angular_velocity)
        + dot(&distance.by_translation, &pose.linear_velocity))
        * factor;
    for axis in 0..3 {
        row[axis] = distance.by_rotation[axis] * factor;
        row[3 + axis] = distance.by_translation[axis] * factor;
    }
    let scaled = distance.by_bearing.map(|value| value * factor);
    for parameter in 0..MAX_PARAMETERS {
        row[ROW_INTRINSICS + parameter] = scaled[0] * pixel.by_parameter[0][parameter]
            + scaled[1] * pixel.by_parameter[1][parameter]
            + scaled[2] * pixel.by_parameter[2][parameter];
    }
    row[ROW_OFFSET] = -weight;
    row[ROW_OFFSET + 1] = -speed;
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
