//! Bearings of all pixels and their derivatives, computed once for each set of intrinsics.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use nalgebra::Vector2;
use rayon::prelude::*;

/// The bearing of one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelBearing {
    /// Unit vector in the camera frame.
    pub bearing: [f64; 3],
    /// Derivative of the bearing by pixel x and pixel y.
    pub by_pixel: [[f64; 3]; 2],
    /// Derivative of the bearing by each intrinsic parameter.
    pub by_parameter: [[f64; MAX_PARAMETERS]; 3],
}

/// Bearings of a whole sensor.
pub struct BearingTable {
    width: usize,
    pixels: Vec<Option<PixelBearing>>,
}

impl BearingTable {
    /// Unprojects every pixel of a sensor of (width, height) pixels.
    pub fn new(camera: &Camera<f64>, sensor: (u16, u16)) -> Self {
        let (width, height) = (usize::from(sensor.0), usize::from(sensor.1));
        let pixels = (0..width * height)
            .into_par_iter()
            .with_min_len(1024)
            .map(|index| pixel_bearing(camera, (index % width) as f64, (index / width) as f64))
            .collect();
        Self { width, pixels }
    }

    /// Bearing of the pixel (x, y); `None` outside the sensor or the camera model's domain.
    #[inline]
    pub fn get(&self, x: u16, y: u16) -> Option<&PixelBearing> {
        if usize::from(x) >= self.width {
            return None;
        }
        self.pixels.get(usize::from(y) * self.width + usize::from(x))?.as_ref()
    }
}

fn pixel_bearing(camera: &Camera<f64>, x: f64, y: f64) -> Option<PixelBearing> {
    let unprojection = camera.unproject_with_jacobians(&Vector2::new(x, y))?;
    let by_pixel = |column: usize| std::array::from_fn(|row| unprojection.by_pixel[(row, column)]);
    Some(PixelBearing {
        bearing: unprojection.bearing.into(),
        by_pixel: [by_pixel(0), by_pixel(1)],
        by_parameter: std::array::from_fn(|row| {
            std::array::from_fn(|column| unprojection.by_parameters[(row, column)])
        }),
    })
}
