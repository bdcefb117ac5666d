//! Bearings of all pixels and their derivatives.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{Vector2, Vector3};

/// The ray of one pixel, in camera coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Unit bearing of the pixel centre.
    pub bearing: Vector3<f64>,
    /// Derivative of the bearing with respect to x, per pixel.
    pub along_x: Vector3<f64>,
    /// Derivative of the bearing with respect to y, per pixel.
    pub along_y: Vector3<f64>,
    /// Second derivatives of the bearing with respect to xx, xy and yy, per squared pixel. Single precision is
    /// sufficient because they are used within a few pixels only.
    bends: [Vector3<f32>; 3],
    /// Largest rotation of the bearing in any direction of the image, in radians per pixel.
    pub turn: f64,
}

impl Ray {
    /// Returns the ray at a distance of `step` pixels from the pixel centre, correct to second order in `step`.
    #[inline]
    pub fn shifted(&self, step: &Vector2<f64>) -> Self {
        let [xx, xy, yy] = self.bends.map(|bend| bend.cast::<f64>());
        let turn_x = xx * step.x + xy * step.y;
        let turn_y = xy * step.x + yy * step.y;
        Self {
            bearing: self.bearing + (self.along_x + turn_x * 0.5) * step.x + (self.along_y + turn_y * 0.5) * step.y,
            along_x: self.along_x + turn_x,
            along_y: self.along_y + turn_y,
            ..*self
        }
    }
}

/// The rays of all pixels of a sensor.
#[derive(Clone, Debug)]
pub struct Rays {
    sensor: Sensor,
    rays: Vec<Option<Ray>>,
}

impl Rays {
    /// Computes the rays of `sensor` behind the lens `camera`. A pixel outside the lens model's domain has no ray: it
    /// sees constant light.
    pub fn new(camera: &Camera<f64>, sensor: Sensor) -> Self {
        let ray = |x: u16, y: u16| {
            let seen = camera.unproject_with_jacobians(&Vector2::new(f64::from(x), f64::from(y)))?;
            let along_x = seen.by_pixel.column(0).into_owned();
            let along_y = seen.by_pixel.column(1).into_owned();
            // The larger singular value of the 3×2 Jacobian.
            let (xx, yy, xy) = (along_x.norm_squared(), along_y.norm_squared(), along_x.dot(&along_y));
            let turn = (0.5 * (xx + yy + libm::hypot(xx - yy, 2.0 * xy))).sqrt();
            Some(Ray { bearing: seen.bearing, along_x, along_y, bends: bends(camera, x, y), turn })
        };
        let rays =
            (0..sensor.height).flat_map(|y| (0..sensor.width).map(move |x| (x, y))).map(|(x, y)| ray(x, y)).collect();
        Self { sensor, rays }
    }

    /// Returns the size of the sensor in pixels.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the ray of pixel (x, y); `None` if the lens has no bearing there or the pixel is outside the sensor.
    pub fn get(&self, x: u16, y: u16) -> Option<&Ray> {
        if x >= self.sensor.width {
            return None;
        }
        self.rays.get(usize::from(y) * usize::from(self.sensor.width) + usize::from(x))?.as_ref()
    }

    /// Returns the rays in the middle of `columns` × `rows` equal cells of the sensor, row by row.
    pub fn grid(&self, columns: u16, rows: u16) -> impl Iterator<Item = Option<&Ray>> {
        let position = |index: u16, count: u16, size: u16| {
            ((2 * u32::from(index) + 1) * u32::from(size) / (2 * u32::from(count.max(1)))) as u16
        };
        (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row))).map(move |(column, row)| {
            self.get(position(column, columns, self.sensor.width), position(row, rows, self.sensor.height))
        })
    }
}

/// Returns the second derivatives of the bearing at a pixel, by differences of the first derivatives; zero if the
/// domain of the lens ends within half a pixel.
fn bends(camera: &Camera<f64>, x: u16, y: u16) -> [Vector3<f32>; 3] {
    let by_pixel = |u: f64, v: f64| {
        Some(camera.unproject_with_jacobians(&Vector2::new(f64::from(x) + u, f64::from(y) + v))?.by_pixel)
    };
    let second = || {
        let by_x = by_pixel(0.5, 0.0)? - by_pixel(-0.5, 0.0)?;
        let by_y = by_pixel(0.0, 0.5)? - by_pixel(0.0, -0.5)?;
        let single = |column: Vector3<f64>| column.cast::<f32>();
        Some([by_x.column(0), by_x.column(1), by_y.column(1)].map(|column| single(column.into_owned())))
    };
    second().unwrap_or_default()
}
