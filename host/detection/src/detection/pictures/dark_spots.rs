//! Dark spots of a picture: connected pixels darker than the mean of the darkest and the brightest pixel around them.

use nalgebra::{Matrix2, Vector2};

use event_recordings::pictures::GreyImage;

/// Smallest contrast of a dot: the share of the light around it that is missing in its middle.
pub const SMALLEST_CONTRAST: f64 = 0.25;
/// Smallest half axis of a dot (px).
const SMALLEST_HALF_AXIS: f64 = 2.0;
/// Largest ratio of a dot's longest to its shortest diameter.
const MOST_ELONGATED: f64 = 4.0;
/// Largest difference between a dot's area and the area of the ellipse with its moments, as a share of it.
const LARGEST_ELLIPSE_ERROR: f64 = 0.25;

/// A connected dark region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DarkSpot {
    /// Mean of its pixels.
    pub center: Vector2<f64>,
    /// Four times the covariance of its pixels: `dᵀ shape⁻¹ d = 1` on the rim of an ellipse.
    pub shape: Matrix2<f64>,
    /// Number of its pixels.
    pub area: usize,
}

impl DarkSpot {
    /// Returns the radius in pixels of the circle with the area of the ellipse.
    pub fn radius(&self) -> f64 {
        self.shape.determinant().max(0.0).sqrt().sqrt()
    }

    /// Returns the longest and the shortest half axis in pixels.
    pub fn half_axes(&self) -> (f64, f64) {
        let values = self.shape.symmetric_eigenvalues();
        (values.max().max(0.0).sqrt(), values.min().max(0.0).sqrt())
    }

    fn is_dot(&self, largest_radius: f64) -> bool {
        let (longest, shortest) = self.half_axes();
        let ellipse = std::f64::consts::PI * longest * shortest;
        shortest >= SMALLEST_HALF_AXIS
            && self.radius() <= largest_radius
            && longest <= MOST_ELONGATED * shortest
            && (self.area as f64 - ellipse).abs() <= LARGEST_ELLIPSE_ERROR * ellipse
    }
}

/// Returns the dark spots that may be dots of up to `largest_radius` pixels. Grey levels are compared within two distances, so
/// that both small dots in uneven light and large dots are found.
pub fn dark_spots(image: &GreyImage, largest_radius: f64) -> Vec<DarkSpot> {
    let mut spots: Vec<DarkSpot> = Vec::new();
    for reach in [largest_radius / 3.0, largest_radius] {
        let dark = darker_than_around(image, reach.ceil() as usize + 2);
        for spot in regions(image, &dark).into_iter().filter(|spot| spot.is_dot(largest_radius)) {
            let known = |other: &DarkSpot| (other.center - spot.center).norm() < other.radius().max(spot.radius());
            if !spots.iter().any(known) {
                spots.push(spot);
            }
        }
    }
    spots
}

/// Returns the pixels that are darker than halfway between the darkest and the brightest within `reach` pixels, where these
/// differ enough.
fn darker_than_around(image: &GreyImage, reach: usize) -> Vec<bool> {
    let darkest = extreme_around(image, reach, u8::MAX, |a, b| a.min(b));
    let brightest = extreme_around(image, reach, u8::MIN, |a, b| a.max(b));
    let pixels = image.pixels.iter().zip(darkest.iter().zip(&brightest));
    let judge = |(&pixel, (&low, &high)): (&u8, (&u8, &u8))| {
        let differs = f64::from(high - low) >= SMALLEST_CONTRAST * f64::from(high) && high > low;
        differs && 2 * u16::from(pixel) < u16::from(low) + u16::from(high)
    };
    pixels.map(judge).collect()
}

/// Returns the `extreme` of the values within `reach` pixels in x and y of each pixel; combining a value with `neutral` returns
/// the value.
fn extreme_around(image: &GreyImage, reach: usize, neutral: u8, extreme: impl Fn(u8, u8) -> u8 + Copy) -> Vec<u8> {
    let (width, height) = (image.width(), image.height());
    let window = 2 * reach + 1;
    let padding = |length: usize| std::iter::repeat_n(neutral, length);
    let mut rows: Vec<u8> = padding(reach * width).collect();
    rows.reserve(width * (height + reach));
    for row in image.pixels.chunks(width) {
        let padded = padding(reach).chain(row.iter().copied()).chain(padding(reach)).collect();
        rows.extend(sliding_extreme(padded, window, 1, extreme));
    }
    rows.extend(padding(reach * width));
    sliding_extreme(rows, window, width, extreme)
}

/// Returns the extremes of `window` values at distances of `step`, by repeated doubling: whole slices are compared, which
/// processors vectorise.
fn sliding_extreme(mut values: Vec<u8>, window: usize, step: usize, extreme: impl Fn(u8, u8) -> u8) -> Vec<u8> {
    let mut covered = 1;
    while covered < window {
        let more = covered.min(window - covered);
        let ahead = values.get(more * step..).unwrap_or_default();
        values = values.iter().zip(ahead).map(|(&here, &ahead)| extreme(here, ahead)).collect();
        covered += more;
    }
    values
}

/// Returns connected regions (over edges) of dark pixels that do not touch the border of the image.
fn regions(image: &GreyImage, dark: &[bool]) -> Vec<DarkSpot> {
    let (width, height) = (image.width(), image.height());
    let mut open = dark.to_vec();
    let mut stack = Vec::new();
    let mut found = Vec::new();
    for start in 0..open.len() {
        if !take(&mut open, start) {
            continue;
        }
        stack.push(start);
        let mut moments = Moments::default();
        let mut at_border = false;
        while let Some(index) = stack.pop() {
            let (x, y) = (index % width, index / width);
            moments.add(x as f64, y as f64);
            at_border |= x == 0 || y == 0 || x + 1 == width || y + 1 == height;
            let left = (x > 0).then(|| index - 1);
            let right = (x + 1 < width).then_some(index + 1);
            for neighbour in [left, right, index.checked_sub(width), Some(index + width)].into_iter().flatten() {
                if take(&mut open, neighbour) {
                    stack.push(neighbour);
                }
            }
        }
        if !at_border {
            found.push(moments.spot());
        }
    }
    found
}

/// Returns the flag and clears it.
fn take(flags: &mut [bool], index: usize) -> bool {
    flags.get_mut(index).is_some_and(std::mem::take)
}

#[derive(Default)]
struct Moments {
    count: usize,
    first: Vector2<f64>,
    second: Matrix2<f64>,
}

impl Moments {
    fn add(&mut self, x: f64, y: f64) {
        let place = Vector2::new(x, y);
        self.count += 1;
        self.first += place;
        self.second += place * place.transpose();
    }

    fn spot(&self) -> DarkSpot {
        let count = self.count as f64;
        let center = self.first / count;
        // A pixel is a square, not a point: its own moment is 1/12.
        let covariance = self.second / count - center * center.transpose() + Matrix2::identity() / 12.0;
        DarkSpot { center, shape: covariance * 4.0, area: self.count }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extremes_agree_with_an_exhaustive_search() {
        let pixels: Vec<u8> = (0..23 * 17).map(|index: u32| (index * index * 37 % 251) as u8).collect();
        let image = GreyImage::new(23, 17, pixels).unwrap();
        for reach in [1, 4, 30] {
            let found = extreme_around(&image, reach, u8::MAX, |a, b| a.min(b));
            assert_eq!(found.len(), 23 * 17);
            for (index, found) in found.iter().enumerate() {
                let (x, y) = (index % 23, index / 23);
                let near = |a: usize, b: usize| a.abs_diff(b) <= reach;
                let places = (0..17).flat_map(|v| (0..23).map(move |u| (u, v)));
                let inside = places.filter(|(u, v)| near(*u, x) && near(*v, y));
                assert_eq!(Some(*found), inside.map(|(u, v)| image.pixels[v * 23 + u]).min());
            }
        }
    }

    #[test]
    fn an_ellipse_has_its_axes_and_spots_at_the_border_are_excluded() {
        let inside = |x: f64, y: f64| ((x - 50.3) / 12.0).powi(2) + ((y - 40.6) / 6.0).powi(2) < 1.0 || x + y < 9.0;
        let pixels =
            (0..80 * 100).map(|index| if inside((index % 100) as f64, (index / 100) as f64) { 20 } else { 200 });
        let image = GreyImage::new(100, 80, pixels.collect()).unwrap();
        let spots = dark_spots(&image, 40.0);
        let [spot] = spots[..] else { panic!("{spots:?}") };
        let (longest, shortest) = spot.half_axes();
        assert!((longest - 12.0).abs() < 0.15 && (shortest - 6.0).abs() < 0.15, "{longest} {shortest}");
        assert!((spot.center - Vector2::new(50.3, 40.6)).norm() < 0.15, "{}", spot.center);
    }
}
