//! What every pixel looks at: its bearing and how the bearing turns from pixel to pixel.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{Vector2, Vector3};

/// The ray of one pixel, in camera coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Unit bearing of the pixel centre.
    pub bearing: Vector3<f64>,
    /// Derivative of the bearing by x, per pixel.
    pub along_x: Vector3<f64>,
    /// Derivative of the bearing by y, per pixel.
    pub along_y: Vector3<f64>,
    /// Largest turn of the bearing in any direction of the image, in radians per pixel.
    pub turn: f64,
}

/// The rays of all pixels of a sensor.
#[derive(Clone, Debug)]
pub struct Rays {
    sensor: Sensor,
    rays: Vec<Option<Ray>>,
}

impl Rays {
    /// The rays of `sensor` behind the lens `camera`. A pixel outside the lens
    /// model's domain has no ray: it sees constant light.
    pub fn new(camera: &Camera<f64>, sensor: Sensor) -> Self {
        let ray = |x: u16, y: u16| {
            let seen = camera.unproject_with_jacobians(&Vector2::new(f64::from(x), f64::from(y)))?;
            let along_x = seen.by_pixel.column(0).into_owned();
            let along_y = seen.by_pixel.column(1).into_owned();
            // The larger singular value of the 3×2 Jacobian.
            let (xx, yy, xy) = (along_x.norm_squared(), along_y.norm_squared(), along_x.dot(&along_y));
            let turn = (0.5 * (xx + yy + libm::hypot(xx - yy, 2.0 * xy))).sqrt();
            Some(Ray { bearing: seen.bearing, along_x, along_y, turn })
        };
        let rays =
            (0..sensor.height).flat_map(|y| (0..sensor.width).map(move |x| (x, y))).map(|(x, y)| ray(x, y)).collect();
        Self { sensor, rays }
    }

    /// Size of the sensor in pixels.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// The ray of pixel (x, y); `None` where the lens has no bearing or outside the sensor.
    pub fn get(&self, x: u16, y: u16) -> Option<&Ray> {
        if x >= self.sensor.width {
            return None;
        }
        self.rays.get(usize::from(y) * usize::from(self.sensor.width) + usize::from(x))?.as_ref()
    }

    /// The rays in the middle of `columns` × `rows` equal cells of the sensor, row by row.
    pub fn grid(&self, columns: u16, rows: u16) -> impl Iterator<Item = Option<&Ray>> {
        let position = |index: u16, count: u16, size: u16| {
            ((2 * u32::from(index) + 1) * u32::from(size) / (2 * u32::from(count.max(1)))) as u16
        };
        (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row))).map(move |(column, row)| {
            self.get(position(column, columns, self.sensor.width), position(row, rows, self.sensor.height))
        })
    }
}
