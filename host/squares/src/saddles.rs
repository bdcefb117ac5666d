//! Saddle points of a picture: points between two dark and two bright quadrants, as at the inner corners of a
//! checkerboard.

use std::f32::consts::PI;

use crate::picture::Picture;

/// Standard deviation in pixels of the smoothing before the search.
const SMOOTHING: f32 = 1.2;
/// Smallest contrast between the quadrants of a saddle, as a fraction of the picture's contrast; weaker saddles are
/// noise.
const LEAST_CONTRAST: f32 = 0.08;
/// Radius in pixels of the ring around a saddle that is examined, and number of pixels on it.
const RING_RADIUS: f32 = 3.5;
const RING: usize = 16;
/// Smallest fraction of the ring's variance that two dark and two bright quadrants explain (8/π² for sharp quadrants of
/// 90°).
const LEAST_EXPLAINED: f32 = 0.5;
/// Half the side in pixels of the window for the position, before the neighbours of a saddle are known.
const WINDOW: usize = 3;
/// Largest motion of a position from its start, in pixels and as a fraction of half the window.
const FARTHEST: f32 = 2.0;
const FARTHEST_IN_WINDOW: f32 = 0.5;
/// Slopes at neighbouring pixels share pixels, so the number of independent slopes is smaller by this factor.
const CORRELATION: f32 = 2.0;
/// Largest number of steps to a position, and the step in pixels below which it has converged.
const STEPS: usize = 30;
const REACHED: f32 = 0.004;

/// A point between two dark and two bright quadrants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saddle {
    /// Position in the picture.
    pub pixel: [f32; 2],
    /// Direction of the middle of the bright quadrants: an angle from x towards y in radians, 0 to π.
    pub bright: f32,
    /// Contrast between the quadrants, in values of the picture.
    pub strength: f32,
}

/// Finds the saddle points of a picture, the strongest first, and at most this number of them.
pub fn find_saddles(picture: &Picture, most: usize) -> Vec<Saddle> {
    let (width, height) = (picture.width(), picture.height());
    let test = SaddleTest::new(picture);
    let response = saddle_response(&test.smooth);
    // Square root of the response to sharp quadrants, per unit of their contrast.
    let scale = 1.0 / (PI * SMOOTHING * SMOOTHING);
    let least = (test.least_contrast * scale).powi(2);
    let border = RING_RADIUS.ceil() as usize + 1;
    let mut saddles = Vec::new();
    for y in border..height.saturating_sub(border) {
        for x in border..width.saturating_sub(border) {
            let value = response[y * width + x];
            if value <= least || !is_greatest(&response, width, x, y) {
                continue;
            }
            saddles.extend(test.saddle(x as f32, y as f32));
        }
    }
    saddles.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    let refined = |found: Saddle| {
        let position = refine_saddle(picture, found.pixel, WINDOW)?;
        Some(Saddle { pixel: position.pixel, ..found })
    };
    // Noise has thousands of weak ones, whose positions are not needed.
    saddles.into_iter().filter_map(refined).take(most).collect()
}

/// Test for saddles of a picture.
pub(crate) struct SaddleTest {
    smooth: Picture,
    least_contrast: f32,
}

impl SaddleTest {
    pub(crate) fn new(picture: &Picture) -> Self {
        let smooth = picture.blurred(SMOOTHING);
        let least_contrast = LEAST_CONTRAST * smooth.contrast();
        Self { smooth, least_contrast }
    }

    /// Returns the saddle at a pixel, if its quadrants differ enough.
    fn saddle(&self, x: f32, y: f32) -> Option<Saddle> {
        quadrants(&self.smooth, x, y).filter(|found| found.strength > self.least_contrast)
    }

    /// Returns `true` if the examined region around this position is in the picture.
    pub(crate) fn covers(&self, pixel: [f32; 2]) -> bool {
        self.smooth.contains(pixel, RING_RADIUS)
    }

    /// Returns `true` if one quadrant around this position differs from the other three, by at least half of this
    /// contrast.
    pub(crate) fn is_outer_corner(&self, pixel: [f32; 2], contrast: f32) -> bool {
        let ring = ring(&self.smooth, pixel[0], pixel[1]);
        let low = ring.iter().copied().fold(f32::INFINITY, f32::min);
        let high = ring.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let middle = 0.5 * (low + high);
        let changes = (0..RING).filter(|&index| (ring[index] > middle) != (ring[(index + 1) % RING] > middle)).count();
        let bright = ring.iter().filter(|value| **value > middle).count();
        let quadrant = bright.min(RING - bright);
        changes == 2 && high - low >= 0.5 * contrast && (RING / 8..=RING * 7 / 16).contains(&quadrant)
    }

    /// Returns `true` if there are two dark and two bright quadrants around this position.
    pub(crate) fn is_saddle(&self, pixel: [f32; 2]) -> bool {
        self.saddle(pixel[0], pixel[1]).is_some()
    }
}

/// Returns minus the determinant of the second derivatives, which is largest in the middle of a saddle.
fn saddle_response(smooth: &Picture) -> Vec<f32> {
    let (width, height) = (smooth.width(), smooth.height());
    let mut response = vec![0.0; width * height];
    if width < 3 || height < 3 {
        return response;
    }
    let rows = smooth.values().chunks_exact(width);
    let three = rows.clone().zip(rows.clone().skip(1)).zip(rows.skip(2));
    for (((above, row), below), out) in three.zip(response.chunks_exact_mut(width).skip(1)) {
        for x in 1..width - 1 {
            let twice = 2.0 * row[x];
            let xx = row[x - 1] + row[x + 1] - twice;
            let yy = above[x] + below[x] - twice;
            let xy = 0.25 * (above[x - 1] + below[x + 1] - above[x + 1] - below[x - 1]);
            out[x] = xy * xy - xx * yy;
        }
    }
    response
}

/// Returns `true` if no pixel within two pixels has a greater response; of equal ones the first counts.
fn is_greatest(response: &[f32], width: usize, x: usize, y: usize) -> bool {
    let place = y * width + x;
    let value = response[place];
    (y - 2..=y + 2).all(|row| {
        (row * width + x - 2..=row * width + x + 2).all(|other| {
            let rival = response[other];
            rival < value || (rival == value && other >= place)
        })
    })
}

/// Returns the values on a ring around a position, from x towards y.
fn ring(smooth: &Picture, x: f32, y: f32) -> [f32; RING] {
    std::array::from_fn(|index| {
        let (sine, cosine) = libm::sincosf(index as f32 * 2.0 * PI / RING as f32);
        smooth.bilinear(x + RING_RADIUS * cosine, y + RING_RADIUS * sine)
    })
}

/// Returns the saddle at a pixel, if the ring around it has two dark and two bright parts.
fn quadrants(smooth: &Picture, x: f32, y: f32) -> Option<Saddle> {
    let ring = ring(smooth, x, y);
    let mean = ring.iter().sum::<f32>() / RING as f32;
    let variance = ring.iter().map(|value| (value - mean).powi(2)).sum::<f32>() / RING as f32;
    let (mut along, mut across) = (0.0, 0.0);
    for (index, value) in ring.iter().enumerate() {
        let (sine, cosine) = libm::sincosf(index as f32 * 4.0 * PI / RING as f32);
        along += (value - mean) * cosine * 2.0 / RING as f32;
        across += (value - mean) * sine * 2.0 / RING as f32;
    }
    let explained = 0.5 * (along * along + across * across);
    let changes = (0..RING).filter(|&index| (ring[index] > mean) != (ring[(index + 1) % RING] > mean)).count();
    if changes != 4 || explained < LEAST_EXPLAINED * variance {
        return None;
    }
    let bright = (0.5 * libm::atan2f(across, along)).rem_euclid(PI);
    // The amplitude of the second harmonic of sharp quadrants is 2/π of their contrast.
    let strength = libm::sqrtf(along * along + across * across) * PI / 2.0;
    strength.is_finite().then_some(Saddle { pixel: [x, y], bright, strength })
}

/// The position of a saddle and its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SaddlePosition {
    /// Position in the picture.
    pub pixel: [f32; 2],
    /// Standard deviation along one axis in pixels, from the agreement of the edges about the position.
    pub sigma: f32,
}

/// Refines the position of the saddle near `start`. All edges within `half` pixels to each side point towards the
/// saddle (Förstner and Gülch 1987; with the weights of OpenCV's `cornerSubPix`). Returns `None` if there is no such
/// point nearby.
pub fn refine_saddle(picture: &Picture, start: [f32; 2], half: usize) -> Option<SaddlePosition> {
    let half = half.clamp(1, 20) as isize;
    let farthest = FARTHEST.max(FARTHEST_IN_WINDOW * half as f32);
    let mut pixel = start;
    let mut sigma = 0.0;
    let side = (2 * half + 3) as usize;
    let mut patch = vec![0.0; side * side];
    let weights: Vec<f32> = (-half..=half).map(|offset| libm::expf(-(offset as f32 / half as f32).powi(2))).collect();
    let count = weights.iter().sum::<f32>().powi(2);
    for _ in 0..STEPS {
        for (index, value) in patch.iter_mut().enumerate() {
            let (dx, dy) = ((index % side) as isize - half - 1, (index / side) as isize - half - 1);
            *value = picture.bilinear(pixel[0] + dx as f32, pixel[1] + dy as f32);
        }
        let (mut xx, mut xy, mut yy, mut bx, mut by, mut square) =
            (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
        for (row, weight_y) in weights.iter().enumerate() {
            for (column, weight_x) in weights.iter().enumerate() {
                let at = (row + 1) * side + column + 1;
                let (dx, dy) = ((column as isize - half) as f32, (row as isize - half) as f32);
                let weight = weight_x * weight_y;
                let gx = patch[at + 1] - patch[at - 1];
                let gy = patch[at + side] - patch[at - side];
                let (gxx, gxy, gyy) = (weight * gx * gx, weight * gx * gy, weight * gy * gy);
                xx += gxx;
                xy += gxy;
                yy += gyy;
                bx += gxx * dx + gxy * dy;
                by += gxy * dx + gyy * dy;
                square += weight * (gx * dx + gy * dy).powi(2);
            }
        }
        let determinant = xx * yy - xy * xy;
        // If all edges have one direction, they do not determine the position along it.
        if determinant.is_nan() || determinant <= 1e-3 * (xx + yy).powi(2) {
            return None;
        }
        let step = [(yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant];
        pixel = [pixel[0] + step[0], pixel[1] + step[1]];
        let scatter = (square - step[0] * bx - step[1] * by).max(0.0) / (count - 2.0).max(1.0);
        sigma = (CORRELATION * scatter * 0.5 * (xx + yy) / determinant).sqrt();
        let moved = (pixel[0] - start[0]).powi(2) + (pixel[1] - start[1]).powi(2);
        if moved > farthest * farthest || !picture.contains(pixel, 0.0) {
            return None;
        }
        if step[0].abs().max(step[1].abs()) < REACHED {
            break;
        }
    }
    Some(SaddlePosition { pixel, sigma })
}
