//! The centre of a dark dot, to a small fraction of a pixel.
//!
//! Around a spot a plane is fitted to the light of the paper. The light that is missing in each pixel, as a share of
//! the paper's light, is summed: this determines the area of the dot and its centre of area. Blur by the lens does not
//! change them. Neither does motion while the shutter is open: the centre belongs to the middle of the exposure, as far
//! as the motion is straight. Both would change the position of the steepest edge.

use std::fmt;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::dark_spots::{DarkSpot, SMALLEST_CONTRAST};
use evcal_geometry::board::CircleBoard;
use evcal_geometry::numerics::statistics::{SIGMA_BY_MEDIAN, median};
use evcal_squares::picture::{Picture, PixelResidual};

/// A dot of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dot {
    /// Centre of area in pixels.
    pub center: Vector2<f64>,
    /// Radius in pixels of the circle with the same area.
    pub radius: f64,
    /// Blur of its edge, as the standard deviation of a Gaussian in pixels.
    pub blur: f64,
}

/// Reason why a spot cannot be measured as a dot. The order of the variants is the order in `calibration.json`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum NoDot {
    /// The border of the image cuts the dot or its surroundings.
    #[serde(rename = "cut by the border of the image")]
    CutByBorder,
    /// It is hardly darker than the paper.
    #[serde(rename = "low contrast")]
    LowContrast,
    /// The paper around it is not evenly lit, or there is something next to it.
    #[serde(rename = "surroundings not even")]
    UnevenSurroundings,
}

impl fmt::Display for NoDot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The same text as in reports.
        self.serialize(f)
    }
}

/// Share of the distance from the rim to the outer end of the surroundings up to which the dot is summed.
const INNER_SHARE: f64 = 0.65;
/// Number of rounds of centring.
const ROUNDS: usize = 3;
/// Radius, as a share of the dot's, within which a dot has its full darkness.
const CORE: f64 = 0.4;
/// Largest scatter of the light around a dot, as a share of the dot's contrast.
const MOST_UNEVEN: f64 = 0.15;

/// Smallest and largest outer end of the surroundings of a dot, in radii of the dot.
const REACH: [f64; 2] = [1.2, 3.0];
/// Width of a dot's rim, in standard deviations of its blur to each side, and the least (px).
const RIM: f64 = 3.0;
const LEAST_RIM: f64 = 1.5;

/// The paper around a dot, by which its light is measured.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings {
    /// Distance up to which the dot is summed, in radii. The border of the image may not cut this part.
    pub inner: f64,
    /// Outer end, in radii.
    pub outer: f64,
    /// Lower limit of the median deviation of the paper's grey levels from a plane, because smaller deviations cannot
    /// be measured.
    pub least_scatter: f64,
}

impl Surroundings {
    /// For the dots of a board in pictures: halfway to the rim of the next dot.
    pub fn on(board: &CircleBoard) -> Self {
        Self::new((0.5 * board.neighbour_distance() / board.radius).clamp(REACH[0], REACH[1]))
    }

    /// For dots of pictures; `reach` is the outer end, in radii: halfway to the rim of the next dot.
    pub fn new(reach: f64) -> Self {
        Self { inner: 1.0 + INNER_SHARE * (reach - 1.0), outer: reach, least_scatter: SMALLEST_SCATTER }
    }
}

/// Measures the dot at `spot`.
pub fn measure(image: &Picture, spot: &DarkSpot, surroundings: &Surroundings) -> Result<Dot, NoDot> {
    let inverse = spot.shape.try_inverse().ok_or(NoDot::LowContrast)?;
    let mut center = spot.center;
    let mut measured = Err(NoDot::LowContrast);
    for _ in 0..ROUNDS {
        let window = Window { center, inverse, shape: spot.shape, surroundings: *surroundings };
        let dot = window.measure(image)?;
        center = dot.center;
        measured = Ok(dot);
    }
    measured
}

/// Returns the residuals of the pixels beside the rim of a `dot` that was measured at `spot`: those of the paper, and those of
/// the dot's middle.
pub fn pixel_residuals(
    picture: &Picture,
    spot: &DarkSpot,
    dot: &Dot,
    surroundings: &Surroundings,
) -> Vec<PixelResidual> {
    let Some(inverse) = spot.shape.try_inverse() else { return Vec::new() };
    let window = Window { center: dot.center, inverse, shape: spot.shape, surroundings: *surroundings };
    let pixels: Vec<_> = window.pixels(picture).collect();
    let ring = pixels.iter().filter(|(_, distance, _)| *distance > surroundings.inner);
    let ring: Vec<_> = ring.map(|(place, _, value)| (*place, *value)).collect();
    let Some(paper) = Window::paper(&ring, surroundings.least_scatter) else { return Vec::new() };
    let light = |place: &Vector2<f64>| paper.plane.dot(&place.push(1.0));
    let rim = (RIM * dot.blur).max(LEAST_RIM) / spot.half_axes().1;
    let inside = || pixels.iter().filter(|(_, distance, _)| *distance < 1.0 - rim);
    let dark = inside().map(|(place, _, value)| value / light(place)).sum::<f64>() / inside().count().max(1) as f64;
    let residual = |(place, distance, value): &(Vector2<f64>, f64, f64)| {
        let share = if *distance < 1.0 - rim {
            dark
        } else if *distance > 1.0 + rim {
            1.0
        } else {
            return None;
        };
        let expected = share * light(place);
        let error = value - expected;
        let pixel = place + dot.center;
        let number = pixel.y.round() as usize * picture.width() + pixel.x.round() as usize;
        (error.abs() <= OUTLIER * paper.scatter).then_some(PixelResidual {
            pixel: number as u32,
            value: expected as f32,
            error: error as f32,
        })
    };
    pixels.iter().filter_map(residual).collect()
}

/// Distance from the paper's light, in standard deviations, beyond which a pixel does not belong to the paper.
const OUTLIER: f64 = 3.0;
/// Largest share of the surroundings that is not evenly lit paper.
const FOREIGN_SHARE: f64 = 0.1;
/// Smallest median deviation from the paper: grey levels are integers, so their scatter is known to half a level at best.
const SMALLEST_SCATTER: f64 = 0.3;

/// Light of the paper, as a plane over the image.
struct Paper {
    plane: Vector3<f64>,
    /// Standard deviation of the pixels about it.
    scatter: f64,
}

struct Window {
    center: Vector2<f64>,
    shape: Matrix2<f64>,
    inverse: Matrix2<f64>,
    surroundings: Surroundings,
}

impl Window {
    /// Returns the pixels within `outer`: position relative to the centre, distance in radii, value.
    fn pixels<'a>(&self, image: &'a Picture) -> impl Iterator<Item = (Vector2<f64>, f64, f64)> + use<'a> {
        let half = Vector2::new(self.shape[(0, 0)].sqrt(), self.shape[(1, 1)].sqrt()) * self.surroundings.outer;
        // Casts saturate: positions left of or above the image become 0.
        let range = |low: f64, high: f64, size: usize| {
            let first = low.ceil().max(0.0) as usize;
            first..(high.floor() as usize + 1).clamp(first, size.max(first))
        };
        let (low, high) = (self.center - half, self.center + half);
        let rows = if high.y < 0.0 { 0..0 } else { range(low.y, high.y, image.height()) };
        let columns = if high.x < 0.0 { 0..0 } else { range(low.x, high.x, image.width()) };
        let (center, inverse, outer) = (self.center, self.inverse, self.surroundings.outer);
        rows.flat_map(move |y| columns.clone().map(move |x| (x, y))).filter_map(move |(x, y)| {
            let place = Vector2::new(x as f64, y as f64) - center;
            let distance = place.dot(&(inverse * place)).max(0.0).sqrt();
            let value = image.values().get(y * image.width() + x)?;
            (distance <= outer).then(|| (place, distance, f64::from(*value)))
        })
    }

    fn inside(&self, image: &Picture) -> bool {
        let half = Vector2::new(self.shape[(0, 0)].sqrt(), self.shape[(1, 1)].sqrt()) * self.surroundings.inner;
        let (low, high) = (self.center - half, self.center + half);
        let (right, bottom) = (image.width() as f64 - 1.0, image.height() as f64 - 1.0);
        low.x >= 0.0 && low.y >= 0.0 && high.x <= right && high.y <= bottom
    }

    /// Fits the paper's light to `ring`, the positions and values of the surroundings.
    fn paper(ring: &[(Vector2<f64>, f64)], least_scatter: f64) -> Option<Paper> {
        let residual = |place: &Vector2<f64>, value: f64, plane: &Vector3<f64>| value - plane.dot(&place.push(1.0));
        let scatter_about = |plane: &Vector3<f64>| {
            let mut sizes: Vec<f64> = ring.iter().map(|(place, value)| residual(place, *value, plane).abs()).collect();
            median(&mut sizes, f64::total_cmp).map(|median| SIGMA_BY_MEDIAN * median.max(least_scatter))
        };
        // Objects next to the paper would tilt the plane, so it begins level, at the median.
        let mut values: Vec<f64> = ring.iter().map(|(_, value)| *value).collect();
        let mut plane = Vector3::new(0.0, 0.0, median(&mut values, f64::total_cmp)?);
        let mut scatter = scatter_about(&plane)?;
        for _ in 0..2 {
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for (place, value) in ring {
                if residual(place, *value, &plane).abs() <= OUTLIER * scatter {
                    let row = place.push(1.0);
                    normal += row * row.transpose();
                    right += row * *value;
                }
            }
            plane = normal.cholesky()?.solve(&right);
            scatter = scatter_about(&plane)?;
        }
        let is_foreign =
            |(place, value): &&(Vector2<f64>, f64)| residual(place, *value, &plane).abs() > OUTLIER * scatter;
        let foreign = ring.iter().filter(is_foreign).count();
        // With too many other pixels there may be an object, perhaps also nearer to the dot.
        (foreign as f64 <= FOREIGN_SHARE * ring.len() as f64).then_some(Paper { plane, scatter })
    }

    fn measure(&self, image: &Picture) -> Result<Dot, NoDot> {
        if !self.inside(image) {
            return Err(NoDot::CutByBorder);
        }
        let Surroundings { inner, least_scatter, .. } = self.surroundings;
        let (dot, ring): (Vec<_>, Vec<_>) = self.pixels(image).partition(|(_, distance, _)| *distance <= inner);
        let ring: Vec<(Vector2<f64>, f64)> = ring.into_iter().map(|(place, _, value)| (place, value)).collect();
        let paper = Self::paper(&ring, least_scatter).ok_or(NoDot::UnevenSurroundings)?;
        let brightness = paper.plane.z;
        let (mut core, mut core_count) = (0.0, 0.0);
        let (mut sum, mut squares, mut noise) = (0.0, 0.0, 0.0);
        let mut moment = Vector2::zeros();
        for (place, distance, value) in dot {
            let light = paper.plane.dot(&place.push(1.0));
            if light <= 0.0 {
                return Err(NoDot::UnevenSurroundings);
            }
            let missing = 1.0 - value / light;
            sum += missing;
            squares += missing * missing;
            noise += (paper.scatter / light).powi(2);
            moment += place * missing;
            if distance <= CORE {
                core += missing;
                core_count += 1.0;
            }
        }
        let contrast = core / core_count;
        if contrast.is_nan() || contrast < SMALLEST_CONTRAST || sum <= 0.0 {
            return Err(NoDot::LowContrast);
        }
        if paper.scatter > MOST_UNEVEN * contrast * brightness {
            return Err(NoDot::UnevenSurroundings);
        }
        let area = sum / contrast;
        // For a share u of the dot from 0 to 1 across a Gaussian edge, ∫ u (1 − u) = σ / √π.
        let edge = (area - (squares - noise) / (contrast * contrast)).max(0.0);
        let scale = (area / (std::f64::consts::PI * self.shape.determinant().sqrt())).max(0.0).sqrt();
        let perimeter = perimeter(&self.shape) * scale;
        Ok(Dot {
            center: self.center + moment / sum,
            radius: (area / std::f64::consts::PI).sqrt(),
            blur: edge / perimeter * std::f64::consts::PI.sqrt(),
        })
    }
}

/// Returns the perimeter of the ellipse `dᵀ shape⁻¹ d = 1` (Ramanujan's first approximation).
fn perimeter(shape: &Matrix2<f64>) -> f64 {
    let values = shape.symmetric_eigenvalues();
    let (a, b) = (values.max().max(0.0).sqrt(), values.min().max(0.0).sqrt());
    std::f64::consts::PI * (3.0 * (a + b) - ((3.0 * a + b) * (a + 3.0 * b)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::super::dark_spots::dark_spots;
    use super::*;
    use event_recordings::pictures::GreyImage;

    /// An ellipse at `center` with half axes (9, 5), blurred by a Gaussian, on paper that gets lighter to the right.
    fn picture(center: Vector2<f64>, sigma: f64, wall: Option<u8>) -> GreyImage {
        // The blur, sample by sample.
        const STEPS: i32 = 15;
        let offsets: Vec<f64> = (-STEPS..=STEPS).map(|step| 3.5 * f64::from(step) / f64::from(STEPS)).collect();
        let weights: Vec<f64> = offsets.iter().map(|offset| libm::exp(-0.5 * offset * offset)).collect();
        let total: f64 = weights.iter().sum();
        let inside = |x: f64, y: f64| (x / 9.0).powi(2) + (y / 5.0).powi(2) < 1.0;
        let value = |x: usize, y: usize| {
            if let Some(value) = wall.filter(|_| x > 78) {
                return value;
            }
            let place = Vector2::new(x as f64, y as f64) - center;
            let mut share = 0.0;
            for (dx, weight_x) in offsets.iter().zip(&weights) {
                for (dy, weight_y) in offsets.iter().zip(&weights) {
                    if inside(place.x + sigma * dx, place.y + sigma * dy) {
                        share += weight_x * weight_y / (total * total);
                    }
                }
            }
            let paper = 150.0 + 0.5 * (x as f64 - 50.0);
            (paper * (1.0 - 0.85 * share)).round() as u8
        };
        let pixels = (0..80 * 100).map(|index| value(index % 100, index / 100)).collect();
        GreyImage::new(100, 80, pixels).unwrap()
    }

    fn dots(image: &GreyImage) -> Vec<Result<Dot, NoDot>> {
        let picture = Picture::from_bytes(image.width(), image.height(), &image.pixels).unwrap();
        dark_spots(image, 40.0).iter().map(|spot| measure(&picture, spot, &Surroundings::new(2.2))).collect()
    }

    #[test]
    fn centre_radius_and_blur_agree_with_the_picture() {
        for (x, y, sigma) in [(50.0, 40.0, 0.7), (50.37, 40.81, 0.7), (49.66, 39.5, 1.5)] {
            let [Ok(dot)] = dots(&picture(Vector2::new(x, y), sigma, None))[..] else { panic!("no dot") };
            assert!((dot.center - Vector2::new(x, y)).norm() < 0.01, "{} for {x} {y}", dot.center);
            assert!((dot.radius - 45f64.sqrt()).abs() < 0.1, "{}", dot.radius);
            assert!((dot.blur - sigma).abs() < 0.2 * sigma, "{} for {sigma}", dot.blur);
        }
    }

    #[test]
    fn spots_that_cannot_be_measured_are_refused_with_the_reason() {
        let dots_at = |x: f64, y: f64, wall| dots(&picture(Vector2::new(x, y), 0.7, wall));
        assert_eq!(dots_at(50.0, 8.0, None), [Err(NoDot::CutByBorder)]);
        // A grey wall near the dot.
        assert_eq!(dots_at(66.0, 40.0, Some(90)), [Err(NoDot::UnevenSurroundings)]);
    }
}
