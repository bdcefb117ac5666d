//! Undistortion of recordings and pictures.
//!
//! Events are moved from their pixel to the pixel of the new camera and are rounded, or keep their fractions; pictures are
//! interpolated bilinearly at the exact position in the old picture, and black outside it.

pub mod picture;
pub mod recording;
pub mod sub_pixel;
pub mod target;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

/// Largest number of pixels of all maps that exist at once: 268 MB.
const MOST_PIXELS: u64 = 1 << 24;

/// The calibrated sensor is larger than undistortion supports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the calibration is for {sensor} pixels, but at most {most} can be undistorted: is this the true size of the sensor?",
    most = MOST_PIXELS / maps
)]
pub struct TooLarge {
    sensor: Sensor,
    maps: u64,
}

impl evcal_files::remedy::Remedy for TooLarge {}

/// Checks that this number of maps of `sensor` fits into the memory.
///
/// # Errors
/// [`TooLarge`].
pub fn check_size(sensor: Sensor, maps: u64) -> Result<(), TooLarge> {
    let pixels = u64::from(sensor.width) * u64::from(sensor.height);
    if pixels * maps > MOST_PIXELS { Err(TooLarge { sensor, maps }) } else { Ok(()) }
}

/// Maps each pixel of a camera to its position in another one.
#[derive(Clone, Debug)]
pub struct PixelMap {
    sensor: Sensor,
    /// Row by row; NaN if the other camera does not see the ray of the pixel.
    pixels: Vec<[f64; 2]>,
}

impl PixelMap {
    /// Creates the map from the pixels of `from` on a `sensor` (width, height) to the pixels of `to`.
    pub fn new(from: &Camera<f64>, to: &Camera<f64>, sensor: Sensor) -> Self {
        let places =
            (0..sensor.height).flat_map(|y| (0..sensor.width).map(move |x| Vector2::new(f64::from(x), f64::from(y))));
        let seen = |pixel: Vector2<f64>| from.unproject(&pixel).and_then(|bearing| to.project(&bearing));
        let pixels = places.map(|pixel| seen(pixel).map_or([f64::NAN; 2], Into::into)).collect();
        Self { sensor, pixels }
    }

    /// Returns width and height of the sensor.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the position of pixel (x, y); `None` if it is not visible.
    pub fn get(&self, x: u16, y: u16) -> Option<[f64; 2]> {
        let Sensor { width, height } = self.sensor;
        let inside = x < width && y < height;
        let place = self.pixels.get(usize::from(y) * usize::from(width) + usize::from(x))?;
        (inside && place[0].is_finite()).then_some(*place)
    }

    /// Returns the position like [`get`](Self::get), but `None` also if it is outside the sensor (from −0.5 to width or
    /// height − 0.5).
    pub fn get_on_sensor(&self, x: u16, y: u16) -> Option<[f64; 2]> {
        let on = |at: f64, size: u16| at >= -0.5 && at < f64::from(size) - 0.5;
        self.get(x, y).filter(|[u, v]| on(*u, self.sensor.width) && on(*v, self.sensor.height))
    }

    /// Returns the pixel nearest to the position of (x, y), if it is on the sensor.
    pub fn nearest_pixel(&self, x: u16, y: u16) -> Option<[u16; 2]> {
        // On the sensor both are at least −0.5, and the cast saturates.
        self.get_on_sensor(x, y).map(|place| place.map(|at| (at + 0.5).floor() as u16))
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;

    #[test]
    fn pixels_follow_their_rays_and_border_pixels_may_leave_the_sensor() {
        let from = Camera::from_parameters(ModelKind::Radtan4, &[300.0, 301.0, 170.0, 131.0, -0.3, 0.1, 0.001, -0.002]);
        let (from, sensor): (Camera<f64>, _) = (from.unwrap(), Sensor::new(346, 260));
        let to = Camera::from_parameters(ModelKind::Radtan4, &[300.0, 301.0, 170.0, 131.0, 0., 0., 0., 0.]).unwrap();
        let map = PixelMap::new(&from, &to, sensor);
        let [u, v] = map.get(200, 60).unwrap();
        let bearing = from.unproject(&Vector2::new(200.0, 60.0)).unwrap();
        assert!((u - (300.0 * bearing.x / bearing.z + 170.0)).abs() < 1e-9);
        assert!((v - (301.0 * bearing.y / bearing.z + 131.0)).abs() < 1e-9);
        assert_eq!(map.nearest_pixel(200, 60), Some([u.round() as u16, v.round() as u16]));
        // Barrel distortion is removed: the corner moves outwards.
        assert!(map.get(0, 0).is_some() && map.get_on_sensor(0, 0).is_none() && map.nearest_pixel(0, 0).is_none());
        assert_eq!((map.get(346, 0), map.get(0, 260), map.get(u16::MAX, u16::MAX)), (None, None, None));
    }
}
