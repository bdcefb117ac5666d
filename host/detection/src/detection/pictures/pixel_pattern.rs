//! The fixed pattern of a sensor's pixels: each differs from the others in its dark value and its sensitivity.
//!
//! A pattern shifts the points of the board. Where the board moves slowly, they stay on the same pixels in several
//! pictures, and so does their shift. The pattern is estimated from the residuals of the pictures' fits: an error
//! proportional to the grey level, and one that is largest in the dark. Both are normally distributed over the pixels;
//! their variance comes from the residuals too, so a sensor without a pattern is hardly changed.

use evcal_core::sensor::Sensor;
use evcal_squares::picture::{Picture, PixelResidual};

/// The largest grey level.
const WHITE: f64 = 255.0;

/// The fixed pattern of a sensor's pixels.
pub struct PixelPattern {
    sensor: Sensor,
    /// The errors of each pixel where it sees black and where it sees white.
    errors: Vec<[f32; 2]>,
}

/// The residuals of all pixels of a sensor in several pictures.
pub struct PixelResiduals {
    sensor: Sensor,
    pixels: Vec<Sums>,
    /// Sum of the squares of the residuals.
    squares: f64,
}

/// The sums of a pixel: products of the shares of black and white in its grey level, and of both with the residual.
#[derive(Clone, Copy, Default)]
struct Sums {
    products: [f32; 3],
    errors: [f32; 2],
}

/// Returns the shares of black and white in a grey level.
fn shares(value: f64) -> [f64; 2] {
    let white = value / WHITE;
    [1.0 - white, white]
}

/// Returns the number on the `sensor` of a pixel of a picture of `width` columns whose first pixel is at `position`.
fn on_sensor(sensor: Sensor, width: usize, position: [usize; 2], pixel: usize) -> Option<usize> {
    let (x, y) = (pixel.checked_rem(width)? + position[0], pixel / width + position[1]);
    let columns = usize::from(sensor.width);
    (x < columns).then_some(y * columns + x)
}

impl Sums {
    fn count(&self) -> f64 {
        let [bb, bw, ww] = self.products.map(f64::from);
        bb + 2.0 * bw + ww
    }

    /// Returns the sum of the residuals.
    fn sum(&self) -> f64 {
        self.errors.iter().copied().map(f64::from).sum()
    }

    /// Returns the errors of the pixel where it sees black and white.
    fn errors(&self, noise: f64) -> [f64; 2] {
        let [bb, bw, ww] = self.products.map(f64::from);
        let [b, w] = self.errors.map(f64::from);
        let (bb, ww) = (bb + noise, ww + noise);
        let determinant = bb * ww - bw * bw;
        if !determinant.is_finite() || determinant <= 0.0 {
            return [0.0; 2];
        }
        [(ww * b - bw * w) / determinant, (bb * w - bw * b) / determinant]
    }
}

impl PixelPattern {
    /// The pattern of a perfect sensor.
    pub fn none(sensor: Sensor) -> Self {
        Self { sensor, errors: vec![[0.0; 2]; sensor.pixel_count()] }
    }

    /// Returns the size of the sensor.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the error of a pixel of the sensor where it should have the grey level `value`.
    fn error(&self, pixel: usize, value: f64) -> Option<f64> {
        let [black, white] = shares(value);
        let [in_black, in_white] = self.errors.get(pixel)?.map(f64::from);
        Some(black * in_black + white * in_white)
    }

    /// Removes the pattern from a picture whose first pixel is at `position` of the sensor.
    pub fn remove_from(&self, picture: &mut Picture, position: [usize; 2]) {
        let width = picture.width();
        for (pixel, value) in picture.values_mut().iter_mut().enumerate() {
            let place = on_sensor(self.sensor, width, position, pixel);
            *value -= place.and_then(|place| self.error(place, f64::from(*value))).unwrap_or(0.0) as f32;
        }
    }
}

impl PixelResiduals {
    /// No residuals.
    pub fn none(sensor: Sensor) -> Self {
        Self { sensor, pixels: vec![Sums::default(); sensor.pixel_count()], squares: 0.0 }
    }

    /// Adds the `residuals` of a picture from which the pattern `removed` was removed.
    pub fn add(&mut self, residuals: &mut [PixelResidual], removed: &PixelPattern, width: usize, position: [usize; 2]) {
        // A pixel of several fits counts once.
        residuals.sort_by_key(|residual| residual.pixel);
        for of_pixel in residuals.chunk_by(|a, b| a.pixel == b.pixel) {
            let count = of_pixel.len() as f64;
            let mean =
                |of: fn(&PixelResidual) -> f32| of_pixel.iter().map(|one| f64::from(of(one))).sum::<f64>() / count;
            let (value, error) = (mean(|one| one.value), mean(|one| one.error));
            let pixel = of_pixel.first().map(|one| one.pixel as usize);
            let Some(pixel) = pixel.and_then(|pixel| on_sensor(self.sensor, width, position, pixel)) else { continue };
            let (Some(sums), Some(before)) = (self.pixels.get_mut(pixel), removed.error(pixel, value)) else {
                continue;
            };
            let error = error + before;
            if !error.is_finite() || !value.is_finite() {
                continue;
            }
            let [black, white] = shares(value);
            self.squares += error * error;
            for (sum, product) in sums.products.iter_mut().zip([black * black, black * white, white * white]) {
                *sum += product as f32;
            }
            for (sum, share) in sums.errors.iter_mut().zip([black, white]) {
                *sum += (share * error) as f32;
            }
        }
    }

    /// Returns the pattern that they show.
    pub fn pattern(&self) -> PixelPattern {
        let noise = self.noise();
        if noise.is_nan() || noise <= 0.0 {
            return PixelPattern::none(self.sensor);
        }
        let errors = self.pixels.iter().map(|sums| sums.errors(noise).map(|error| error as f32)).collect();
        PixelPattern { sensor: self.sensor, errors }
    }

    /// Returns the variance of a residual over the variance of the pattern; not positive without a pattern.
    fn noise(&self) -> f64 {
        let seen = || self.pixels.iter().map(|sums| (sums, sums.count())).filter(|(_, count)| *count > 0.5);
        let (mut repeated, mut within) = (0.0, self.squares);
        for (sums, count) in seen() {
            repeated += count - 1.0;
            within -= sums.sum() * sums.sum() / count;
        }
        let variance = within / repeated;
        let (mut between, mut weight) = (0.0, 0.0);
        for (sums, count) in seen().filter(|(_, count)| *count > 1.5) {
            let white = f64::from(sums.products[1] + sums.products[2]) / count;
            between += (sums.sum() / count).powi(2) - variance / count;
            weight += white * white + (1.0 - white) * (1.0 - white);
        }
        variance * weight / between
    }
}

#[cfg(test)]
mod tests {
    use evcal_geometry::numerics::random::normal;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const SENSOR: Sensor = Sensor::new(24, 20);
    const WIDTH: usize = 20;
    const POSITION: [usize; 2] = [3, 2];

    /// Estimates the pattern of pixels with these standard deviations of dark value, sensitivity and noise, which see black
    /// and white in `pictures` pictures. Returns the rms error of a picture before and after the pattern is removed.
    fn errors([dark, gain, noise]: [f64; 3], pictures: usize) -> (f64, f64) {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut pixels = |sigma: f64| (0..WIDTH * 18).map(|_| sigma * normal(&mut rng)).collect::<Vec<f64>>();
        let (dark, gain) = (pixels(dark), pixels(gain));
        let truth = |picture: usize, pixel: usize| if (pixel * 7 + picture * 3) % 11 < 5 { 30.0 } else { 190.0 };
        let value = |picture: usize, pixel: usize| truth(picture, pixel) * (1.0 + gain[pixel]) + dark[pixel];
        let mut seen = PixelResiduals::none(SENSOR);
        for picture in 0..pictures {
            let noise = pixels(noise);
            let residual = |pixel: usize| {
                let error = value(picture, pixel) + noise[pixel] - truth(picture, pixel);
                PixelResidual { pixel: pixel as u32, value: truth(picture, pixel) as f32, error: error as f32 }
            };
            // Each pixel belongs to two fits.
            let mut residuals: Vec<_> = (0..dark.len()).chain(0..dark.len()).map(residual).collect();
            seen.add(&mut residuals, &PixelPattern::none(SENSOR), WIDTH, POSITION);
        }
        let pattern = seen.pattern();
        let last = (0..dark.len()).map(|pixel| value(pictures, pixel) as f32).collect();
        let mut picture = Picture::new(WIDTH, 18, last).unwrap();
        let rms = |picture: &Picture| {
            let errors = picture.values().iter().enumerate();
            let squares = errors.map(|(pixel, value)| (f64::from(*value) - truth(pictures, pixel)).powi(2));
            (squares.sum::<f64>() / picture.values().len() as f64).sqrt()
        };
        let before = rms(&picture);
        pattern.remove_from(&mut picture, POSITION);
        (before, rms(&picture))
    }

    #[test]
    fn dark_values_and_sensitivities_are_removed() {
        let (before, after) = errors([1.2, 0.01, 1.0], 40);
        assert!(before > 1.5 && after < 0.3, "{before} {after}");
        // Two pictures show only a part of the pattern.
        let (before, after) = errors([1.2, 0.01, 1.0], 2);
        assert!(after < 0.8 * before, "{before} {after}");
    }

    #[test]
    fn noise_is_not_taken_for_a_pattern() {
        for pictures in [1, 2, 5, 40] {
            let (_, after) = errors([0.0, 0.0, 1.0], pictures);
            assert!(after < 0.08, "{pictures} pictures: {after}");
        }
    }
}
