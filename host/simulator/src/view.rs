//! Intersections of the rays of a camera at one pose with the board.

use nalgebra::{Isometry3, Matrix2, Matrix3, Vector2, Vector3};

use super::rays::Ray;
use evcal_geometry::board::shape::Surface;

/// The board seen from one camera pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    pub(super) rotation: Matrix3<f64>,
    pub(super) position: Vector3<f64>,
    /// Seconds since the start of the recording.
    pub(super) time: f64,
}

impl View {
    /// Creates the view from the pose `T_world_camera` (metres, board in the plane z = 0).
    pub fn new(world_from_camera: &Isometry3<f64>) -> Self {
        Self {
            rotation: *world_from_camera.rotation.to_rotation_matrix().matrix(),
            position: world_from_camera.translation.vector,
            time: 0.0,
        }
    }

    /// Returns the same view at time `t` (s), for scenes in which something other than the camera moves.
    pub fn at(self, t: f64) -> Self {
        Self { time: t, ..self }
    }

    /// Returns the intersection of a ray with the board plane; `None` if the ray is parallel to it or points away from
    /// it.
    // Always inlined, like the next two functions: an intersection that is passed through memory takes the processor
    // longer to read than to compute.
    #[inline(always)]
    pub fn gaze(&self, ray: &Ray) -> Option<Gaze> {
        let direction = self.rotation * ray.bearing;
        // A camera in front of the board is at z < 0 and looks towards positive z.
        if direction.z * -self.position.z.signum() < GRAZING {
            return None;
        }
        let inverse = 1.0 / direction.z;
        let slope = Vector2::new(direction.x * inverse, direction.y * inverse);
        let point = self.position.xy() - self.position.z * slope;
        Some(Gaze { point, slope, distance: -self.position.z * inverse, relief: None })
    }

    /// Returns the intersection with a board that has a `surface` of its own; points are positions on the print.
    #[inline(always)]
    pub(super) fn gaze_at(&self, ray: &Ray, surface: &Surface) -> Option<Gaze> {
        let direction = self.rotation * ray.bearing;
        if direction.z * -self.position.z.signum() < GRAZING {
            return None;
        }
        let met = surface.meet(&self.position.into(), &direction.into());
        let point = Vector2::from(surface.to_print(met.point));
        let relief = Relief { scale: Vector2::from(surface.per_scale()), slope: Vector2::from(met.slope) };
        let gaze = Gaze { point, slope: direction.xy() * met.inverse, distance: met.depth, relief: Some(relief) };
        (met.depth.is_finite() && met.inverse.is_finite()).then_some(gaze)
    }

    /// Returns the derivative of the intersection with respect to the pixel, in metres per pixel.
    #[inline(always)]
    pub fn jacobian(&self, ray: &Ray, gaze: &Gaze) -> Matrix2<f64> {
        let column = |along: &Vector3<f64>| {
            let turned = self.rotation * along;
            match &gaze.relief {
                None => (turned.xy() - gaze.slope * turned.z) * gaze.distance,
                Some(Relief { scale, slope }) => {
                    let across = turned.z - slope.dot(&turned.xy());
                    (turned.xy() - gaze.slope * across).component_mul(scale) * gaze.distance
                }
            }
        };
        Matrix2::from_columns(&[column(&ray.along_x), column(&ray.along_y)])
    }
}

/// Sine of the angle to the board plane below which a ray does not count as meeting it.
const GRAZING: f64 = 0.02;

/// Intersection of a ray with the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaze {
    /// Point on the print in metres.
    pub point: Vector2<f64>,
    /// Metres along the board per metre along its normal.
    pub(super) slope: Vector2<f64>,
    /// Distance from the camera in metres.
    pub(super) distance: f64,
    /// Local relief of the board, unless it has the nominal shape.
    relief: Option<Relief>,
}

/// Local scale and slope of a board that differs from the nominal one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Relief {
    /// Metres of the print per metre on the board, along x and y.
    scale: Vector2<f64>,
    /// Slope of its surface.
    slope: Vector2<f64>,
}

impl Gaze {
    /// Returns an upper bound of the displacement of the point on the board, in metres per pixel.
    #[inline]
    pub(super) fn metres_per_pixel(&self, ray: &Ray) -> f64 {
        let flat = self.distance * ray.turn * (1.0 + self.slope.norm_squared()).sqrt();
        match self.relief {
            None => flat,
            Some(Relief { scale, slope }) => flat * (scale.max() * (1.0 + slope.norm() * self.slope.norm())),
        }
    }
}
