//! Bearings of the pixels of a sensor, computed once for a lens.

use evcal_core::camera::Camera;
use nalgebra::{Matrix2, Matrix3, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;

/// The bearing of each pixel of a sensor.
pub struct Bearings {
    camera: Camera<f64>,
    width: usize,
    /// Unit vectors, row by row; NaN outside the lens's domain.
    bearings: Vec<Vector3<f64>>,
}

impl Bearings {
    /// Computes the bearings of a sensor of `width` × `height` pixels.
    pub fn new(camera: &Camera<f64>, width: usize, height: usize) -> Self {
        let row = |y: usize| {
            (0..width).into_par_iter().map(move |x| {
                let pixel = Vector2::new(x as f64, y as f64);
                camera.unproject(&pixel).unwrap_or_else(|| Vector3::repeat(f64::NAN))
            })
        };
        let bearings = (0..height).into_par_iter().flat_map(row).collect();
        Self { camera: *camera, width, bearings }
    }

    fn at(&self, x: usize, y: usize) -> Option<&Vector3<f64>> {
        if x < self.width { self.bearings.get(y * self.width + x) } else { None }
    }
}

/// A plane on which straight lines of the board are straight near a position in the picture. Its unit is about a pixel
/// there.
pub(crate) struct Plane<'a> {
    kind: Kind<'a>,
    /// Position of the picture's first pixel on the sensor.
    position: Vector2<f64>,
    middle: Vector2<f64>,
}

enum Kind<'a> {
    /// Without a lens the picture is the plane.
    Picture,
    /// The tangent plane of the sphere of bearings.
    Tangent { lens: &'a Bearings, tangent: Tangent },
}

/// A tangent plane of the sphere of bearings.
struct Tangent {
    /// Rotation from camera axes that moves the bearing of the middle to z.
    turn: Matrix3<f64>,
    scale: f64,
}

impl Tangent {
    /// Creates the tangent plane at a `pixel` of the sensor. `None` outside the lens's domain.
    fn new(camera: &Camera<f64>, pixel: &Vector2<f64>) -> Option<Self> {
        let unprojection = camera.unproject_with_jacobians(pixel)?;
        // For the opposite bearing there is no unique rotation.
        let turn = UnitQuaternion::rotation_between(&unprojection.bearing, &Vector3::z())
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let by_pixel = unprojection.by_pixel;
        let scale = 1.0 / by_pixel.column(0).cross(&by_pixel.column(1)).norm().sqrt();
        scale.is_finite().then(|| Self { turn: turn.to_rotation_matrix().into_inner(), scale })
    }

    fn place(&self, bearing: &Vector3<f64>) -> Option<Vector2<f64>> {
        let turned = self.turn * bearing;
        // A NaN is not in front either.
        (turned.z > 0.0).then(|| turned.xy() * (self.scale / turned.z))
    }

    fn bearing(&self, place: Vector2<f64>) -> Vector3<f64> {
        self.turn.tr_mul(&(place / self.scale).push(1.0))
    }
}

impl<'a> Plane<'a> {
    /// Creates the plane about `middle` (px). The picture's first pixel is at `position` of the sensor. `None` outside
    /// the lens's domain.
    pub(crate) fn new(lens: Option<&'a Bearings>, position: [usize; 2], middle: Vector2<f64>) -> Option<Self> {
        let position = Vector2::from(position.map(|value| value as f64));
        let kind = match lens {
            None => Kind::Picture,
            Some(lens) => Kind::Tangent { lens, tangent: Tangent::new(&lens.camera, &(middle + position))? },
        };
        Some(Self { kind, position, middle })
    }

    /// Returns the position on the plane of a position in the picture.
    pub(crate) fn place(&self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        match &self.kind {
            Kind::Picture => Some(pixel - self.middle),
            Kind::Tangent { lens, tangent } => tangent.place(&lens.camera.unproject(&(pixel + self.position))?),
        }
    }

    /// Returns the position on the plane of a pixel of the picture, and its derivative by the pixel.
    pub(crate) fn place_of_pixel(&self, x: usize, y: usize) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        match &self.kind {
            Kind::Picture => Some((Vector2::new(x as f64, y as f64) - self.middle, Matrix2::identity())),
            Kind::Tangent { lens, tangent } => {
                let (x, y) = (x + self.position.x as usize, y + self.position.y as usize);
                let at = |x: usize, y: usize| tangent.place(lens.at(x, y)?);
                let place = at(x, y)?;
                // The derivative is needed for the blur only, so differences between pixels are exact enough.
                let slope = |before: Option<Vector2<f64>>, after: Option<Vector2<f64>>| match (before, after) {
                    (Some(before), Some(after)) => Some(0.5 * (after - before)),
                    (Some(before), None) => Some(place - before),
                    (None, Some(after)) => Some(after - place),
                    (None, None) => None,
                };
                let along_x = slope(x.checked_sub(1).and_then(|x| at(x, y)), at(x + 1, y))?;
                let along_y = slope(y.checked_sub(1).and_then(|y| at(x, y)), at(x, y + 1))?;
                Some((place, Matrix2::from_columns(&[along_x, along_y])))
            }
        }
    }

    /// Returns the position in the picture of a position on the plane.
    pub(crate) fn pixel(&self, place: Vector2<f64>) -> Option<Vector2<f64>> {
        match &self.kind {
            Kind::Picture => Some(place + self.middle),
            Kind::Tangent { lens, tangent } => Some(lens.camera.project(&tangent.bearing(place))? - self.position),
        }
    }
}
