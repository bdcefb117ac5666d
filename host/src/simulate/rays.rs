//! What every pixel looks at: its bearing and how the bearing turns from pixel to pixel.

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
}

/// The rays of all pixels of a sensor.
#[derive(Clone, Debug)]
pub struct Rays {
    width: u16,
    height: u16,
    rays: Vec<Option<Ray>>,
}

/// Half the distance in pixels over which bearings are differenced.
const DIFFERENCE: f64 = 1e-2;

impl Rays {
    /// The rays of a `width` × `height` sensor behind a lens that maps a pixel to its unit bearing.
    /// A pixel at or beside which the lens has no bearing has no ray: it sees constant light.
    pub fn new(width: u16, height: u16, unproject: impl Fn(&Vector2<f64>) -> Option<Vector3<f64>>) -> Self {
        let ray = |x: u16, y: u16| {
            let pixel = Vector2::new(f64::from(x), f64::from(y));
            let derivative = |offset: Vector2<f64>| {
                Some((unproject(&(pixel + offset))? - unproject(&(pixel - offset))?) / (2.0 * DIFFERENCE))
            };
            let ray = Ray {
                bearing: unproject(&pixel)?,
                along_x: derivative(Vector2::new(DIFFERENCE, 0.0))?,
                along_y: derivative(Vector2::new(0.0, DIFFERENCE))?,
            };
            [ray.bearing, ray.along_x, ray.along_y].iter().all(|v| v.iter().all(|c| c.is_finite())).then_some(ray)
        };
        let rays = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| ray(x, y)).collect();
        Self { width, height, rays }
    }

    /// Number of columns.
    pub fn width(&self) -> u16 {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> u16 {
        self.height
    }

    /// The ray of pixel (x, y); `None` where the lens has no bearing or outside the sensor.
    pub fn get(&self, x: u16, y: u16) -> Option<&Ray> {
        if x >= self.width {
            return None;
        }
        self.rays.get(usize::from(y) * usize::from(self.width) + usize::from(x))?.as_ref()
    }

    /// About `columns` × `rows` rays, spread evenly over the sensor.
    pub fn grid(&self, columns: u16, rows: u16) -> impl Iterator<Item = &Ray> {
        let position = |index: u16, count: u16, size: u16| {
            ((2 * u32::from(index) + 1) * u32::from(size) / (2 * u32::from(count.max(1)))) as u16
        };
        (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row))).filter_map(move |(column, row)| {
            self.get(position(column, columns, self.width), position(row, rows, self.height))
        })
    }
}
