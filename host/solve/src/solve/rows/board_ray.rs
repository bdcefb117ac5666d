//! Intersection of a pixel's ray with the board, and its distance from an edge of the print.
//!
//! Notation: b is the bearing of a pixel, (R, p) = `T_world_camera` the pose, f the signed distance of a point X on the board
//! plane z = 0 from an edge, and n the gradient of f ([`board_edge`](super::board_edge)). Then
//!
//! d = R b, X = p − (p_z / d_z) d (the ray meets the board), h = λ (n_x, n_y, −(n · d_xy) / d_z), λ = −p_z / d_z,
//! ∂f/∂ω = b × Rᵀh (rotation perturbed in the camera frame), ∂f/∂p = h / λ,
//! ∂f/∂pixel = Rᵀh · ∂b/∂pixel, and s = ‖∂f/∂pixel‖ is the local scale in metres per pixel.
//!
//! If the board's shape differs from the nominal one ([`board_surface`](super::board_surface)), X is the position on the print,
//! and z is measured along the surface's normal.
//!
//! All functions are free of branches, so that the compiler can process several events at once; [`is_in_front`] reports whether
//! the result is valid.

use nalgebra::Vector2;

use super::board_edge::{BoardEdge, PrintDistance};
use super::board_surface::{BoardSurface, RayMeeting};
use super::pose_bin::{PoseBin, cross, dot};
use crate::solve::BOARD_PARAMETERS;

/// A ray and its intersection with the board.
#[derive(Clone, Copy, Debug)]
pub struct BoardRay<S: BoardSurface> {
    surface: S,
    slope: S::Slope,
    /// Bearing in the camera frame at the bin's centre.
    bearing: [f64; 3],
    /// Direction in the world frame.
    direction: [f64; 3],
    /// One over the component of the direction across the surface.
    inverse: f64,
    /// Length along `direction` to the board.
    depth: f64,
    /// Intersection with the board: position on the print, in metres.
    point: [f64; 2],
}

/// Returns `true` if a ray of this depth meets the board in front of the camera.
#[inline(always)]
pub fn is_in_front(depth: f64) -> bool {
    // Also false for NaN and for rays parallel to the board.
    depth > 0.0 && depth < 1e6
}

/// Distance of a ray from an edge on the board, and its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct EdgeDistance {
    /// Signed distance from the edge in metres on the board plane, positive on its light side.
    pub metres: f64,
    /// Metres on the board plane per pixel across the edge.
    pub scale: f64,
    /// Derivative of `metres` by pixel x and y, in metres per pixel.
    pub by_pixel: [f64; 2],
    /// Derivative of `metres` by the camera centre in the world frame.
    pub by_translation: [f64; 3],
    /// Derivative of `metres` by a rotation perturbation in the camera frame (metres per radian).
    pub by_rotation: [f64; 3],
    /// Speed at which a pixel's ray slides along the edge, in m/s.
    pub sliding: f64,
    /// Direction on the print from the dark side to the light one.
    pub normal: [f64; 2],
}

impl<S: BoardSurface> BoardRay<S> {
    /// Intersects the ray of `bearing` (camera frame) with the board's `surface`, at `dt` seconds after the centre of `pose`'s
    /// bin; the pose is extrapolated to first order.
    #[inline(always)]
    pub fn new(surface: &S, pose: &PoseBin, dt: f64, bearing: &[f64; 3]) -> Self {
        let turn = cross(&pose.angular_velocity, bearing);
        let bearing: [f64; 3] = std::array::from_fn(|axis| bearing[axis] + dt * turn[axis]);
        let direction = pose.to_world(&bearing);
        let camera: [f64; 3] = std::array::from_fn(|axis| pose.translation[axis] + dt * pose.linear_velocity[axis]);
        let (RayMeeting { depth, inverse, point }, slope) = surface.meet(&camera, &direction);
        Self { surface: *surface, slope, bearing, direction, inverse, depth, point }
    }

    /// Returns the surface that the ray meets.
    #[inline(always)]
    pub fn surface(&self) -> &S {
        &self.surface
    }

    /// Returns the length along the ray to the board, in units of the bearing's length (metres).
    #[inline(always)]
    pub fn depth(&self) -> f64 {
        self.depth
    }

    /// Returns the length in metres on the board that a pixel covers along its longer side. It grows with the tilt of
    /// the board. `by_pixel` is the derivative of the bearing by pixel x and y.
    #[inline(always)]
    pub fn widest_pixel(&self, by_pixel: &[[f64; 3]; 2]) -> f64 {
        let square = dot(&by_pixel[0], &by_pixel[0]).max(dot(&by_pixel[1], &by_pixel[1]));
        let tilt = dot(&self.direction, &self.direction) * self.inverse * self.inverse;
        self.depth * (square * tilt).sqrt()
    }

    /// Returns the intersection with the board: position on the print, in metres.
    #[inline(always)]
    pub fn point(&self) -> Vector2<f64> {
        Vector2::from(self.point)
    }

    /// Computes the distance from `edge`. `by_pixel` is the derivative of the bearing by pixel x and y.
    #[inline(always)]
    pub fn edge_distance(&self, pose: &PoseBin, by_pixel: &[[f64; 3]; 2], edge: impl BoardEdge) -> EdgeDistance {
        let PrintDistance { metres, normal } = edge.distance(self.point);
        let gradient = self.surface.scaled(normal);
        let along = gradient[0] * self.direction[0] + gradient[1] * self.direction[1];
        let by_translation = S::by_camera(self.slope, gradient, along * self.inverse);
        let [x, y, z] = by_translation;
        let by_bearing = pose.to_camera(&[self.depth * x, self.depth * y, self.depth * z]);
        let by_rotation = cross(&self.bearing, &by_bearing);
        let by_pixel = [dot(&by_bearing, &by_pixel[0]), dot(&by_bearing, &by_pixel[1])];
        let scale = (by_pixel[0] * by_pixel[0] + by_pixel[1] * by_pixel[1]).sqrt();
        let velocity = self.velocity(pose);
        let sliding = normal[0] * velocity[1] - normal[1] * velocity[0];
        EdgeDistance { metres, scale, by_pixel, by_translation, by_rotation, sliding, normal }
    }

    /// Returns the derivatives of an edge's `distance` by print ratio and bends, in metres per unit of each.
    #[inline(always)]
    pub fn by_shape(&self, distance: &EdgeDistance) -> [f64; BOARD_PARAMETERS - 1] {
        self.surface.by_shape(self.point, distance.normal, distance.by_translation[2])
    }

    /// Returns the velocity (m/s) of the intersection over the print, for the ray of a fixed pixel.
    #[inline(always)]
    pub fn velocity(&self, pose: &PoseBin) -> [f64; 2] {
        let turning = pose.to_world(&cross(&pose.angular_velocity, &self.bearing));
        let linear = &pose.linear_velocity;
        let moved: [f64; 3] = std::array::from_fn(|axis| linear[axis] + self.depth * turning[axis]);
        let depth_rate = -S::across(self.slope, &moved) * self.inverse;
        self.surface.scaled(std::array::from_fn(|axis| {
            linear[axis] + depth_rate * self.direction[axis] + self.depth * turning[axis]
        }))
    }
}

impl EdgeDistance {
    /// Returns the rate at which the distance grows at a fixed pixel, in pixels per second: the normal speed of the edge,
    /// positive if the pixel becomes brighter.
    #[inline(always)]
    pub fn normal_speed(&self, pose: &PoseBin) -> f64 {
        (dot(&self.by_rotation, &pose.angular_velocity) + dot(&self.by_translation, &pose.linear_velocity)) / self.scale
    }
}
