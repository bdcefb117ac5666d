//! Bearings of all pixels and their derivatives, computed once for each set of intrinsics.

use evcal_core::camera::{Camera, MAX_PARAMETERS, Unprojection};
use nalgebra::Vector2;
use rayon::prelude::*;

/// The bearing of one pixel. Derivatives are in single precision: they give directions, and the
/// table is read at random, so that its size is time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelBearing {
    /// Unit vector in the camera frame.
    pub bearing: [f64; 3],
    /// Derivative of the bearing by pixel x and pixel y.
    by_pixel: [[f32; 3]; 2],
    /// Derivative of the pixel of a fixed bearing, x and y, by each intrinsic parameter.
    pub pixel_by_parameter: [[f32; MAX_PARAMETERS]; 2],
    /// Squared distance from the middle of the sensor, 1 at its corners.
    pub corner_share: f32,
}

/// Bearings of a whole sensor and of a margin around it: the edge that an event on the rim of the
/// sensor belongs to may lie just outside.
pub struct BearingTable {
    size: (usize, usize),
    pixels: Vec<Option<PixelBearing>>,
}

/// Pixels beyond the sensor on each side.
const MARGIN: i32 = 6;

impl PixelBearing {
    /// Derivative of the bearing by pixel x and pixel y.
    #[inline(always)]
    pub fn by_pixel(&self) -> [[f64; 3]; 2] {
        self.by_pixel.map(|column| column.map(f64::from))
    }

    /// Bearing (`x`, `y`) pixels from this one, to first order.
    #[inline(always)]
    pub fn bearing_beside(&self, x: f64, y: f64) -> [f64; 3] {
        let [by_x, by_y] = self.by_pixel();
        std::array::from_fn(|axis| self.bearing[axis] + x * by_x[axis] + y * by_y[axis])
    }
}

impl BearingTable {
    /// Unprojects every pixel of a sensor of (width, height) pixels.
    pub fn new(camera: &Camera<f64>, sensor: (u16, u16)) -> Self {
        let margin = 2 * MARGIN as usize;
        let size = (usize::from(sensor.0) + margin, usize::from(sensor.1) + margin);
        let middle = Vector2::new(f64::from(sensor.0) - 1.0, f64::from(sensor.1) - 1.0) / 2.0;
        let pixels = (0..size.0 * size.1)
            .into_par_iter()
            .with_min_len(1024)
            .map(|index| {
                let at = |position: usize| position as f64 - f64::from(MARGIN);
                let pixel = Vector2::new(at(index % size.0), at(index / size.0));
                let corner_share = (pixel - middle).norm_squared() / middle.norm_squared().max(1.0);
                camera.unproject_with_jacobians(&pixel).and_then(|unprojection| entry(&unprojection, corner_share))
            })
            .collect();
        Self { size, pixels }
    }

    /// Entry of the pixel (x, y); `None` far outside the sensor or outside the camera model's domain.
    #[inline(always)]
    pub fn get(&self, x: i32, y: i32) -> Option<&PixelBearing> {
        // Negative numbers become large ones.
        let (column, row) = (x.wrapping_add(MARGIN) as u32 as usize, y.wrapping_add(MARGIN) as u32 as usize);
        if column >= self.size.0 || row >= self.size.1 {
            return None;
        }
        self.pixels.get(row * self.size.0 + column)?.as_ref()
    }

    /// Entry of the pixel nearest to (x, y), and where (x, y) lies from it.
    #[inline(always)]
    pub fn nearest(&self, x: f64, y: f64) -> Option<(&PixelBearing, f64, f64)> {
        // Truncation is rounding once the number is positive; a cast saturates and makes 0 of NaN.
        const SHIFT: f64 = (1_i32 << 20) as f64;
        let round = |value: f64| (value + (SHIFT + 0.5)) as i32 - (1 << 20);
        let (near_x, near_y) = (round(x), round(y));
        let entry = self.get(near_x, near_y)?;
        Some((entry, x - f64::from(near_x), y - f64::from(near_y)))
    }
}

fn entry(unprojection: &Unprojection<f64>, corner_share: f64) -> Option<PixelBearing> {
    let by_pixel = unprojection.by_pixel;
    // A bearing that stays while the parameters move is seen by another pixel:
    // ∂b/∂k + ∂b/∂pixel · ∂pixel/∂k = 0.
    let normal = (by_pixel.transpose() * by_pixel).try_inverse()?;
    let by_parameter = -normal * by_pixel.transpose() * unprojection.by_parameters;
    Some(PixelBearing {
        bearing: unprojection.bearing.into(),
        by_pixel: std::array::from_fn(|column| std::array::from_fn(|row| by_pixel[(row, column)] as f32)),
        pixel_by_parameter: std::array::from_fn(|row| {
            std::array::from_fn(|column| by_parameter[(row, column)] as f32)
        }),
        corner_share: corner_share as f32,
    })
}
