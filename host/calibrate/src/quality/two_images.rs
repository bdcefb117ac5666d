//! Detection of two images in one stream of events, as of two cameras whose events were merged.
//!
//! If two cameras look at a board with the same motion, each edge appears twice, and the calibration lies between them. The residuals
//! of the events of one edge direction in a small part of the image then have two peaks, with few events in the middle. Noise, blur and
//! outliers have most events in the middle.

use evcal_core::sensor::Sensor;

use crate::solve::observation_range::EventResidual;

/// Number of columns of square cells; the number of rows follows.
const COLUMNS: usize = 16;
/// Number of directions of edges that are distinguished.
const DIRECTIONS: usize = 4;
/// Fewest events in a cell and direction.
const FEWEST: usize = 100;
/// Residuals of less than this share of their root mean square are in the middle.
const MIDDLE: f64 = 0.5;
/// Largest share of events in the middle if there are two peaks: of normally distributed residuals it is 0.38, and of two peaks that
/// are three standard deviations apart 0.27.
const TWO_PEAKS: f64 = 0.28;
/// Smallest share of the events in cells and directions with two peaks.
const SMALLEST_SHARE: f64 = 0.15;

/// Two images in one stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoImages {
    /// Share of the events near edges that appear twice.
    pub share: f64,
    /// Mean distance of both images there (px, root mean square).
    pub distance: f64,
}

/// Searches `events`, the residuals at the solution, for two images.
pub fn two_images(events: &[EventResidual], sensor: Sensor) -> Option<TwoImages> {
    let cell = f64::from(sensor.width.max(1)) / COLUMNS as f64;
    let rows = (f64::from(sensor.height.max(1)) / cell).ceil().max(1.0) as usize;
    let mut groups = vec![Group::default(); COLUMNS * rows * DIRECTIONS];
    let place = |event: &EventResidual| {
        let [column, row] = event.pixel.map(|coordinate| ((f64::from(coordinate) + 0.5) / cell).max(0.0) as usize);
        let cell = row.min(rows - 1) * COLUMNS + column.min(COLUMNS - 1);
        // The opposite side of a dot has the opposite normal, and a displacement has the opposite sign there.
        let [x, y] = event.normal.map(f64::from);
        let is_opposite = y < 0.0 || (y == 0.0 && x < 0.0);
        let angle = if is_opposite { libm::atan2(-y, -x) } else { libm::atan2(y, x) };
        let direction = (angle / std::f64::consts::PI * DIRECTIONS as f64) as usize;
        let residual = f64::from(event.residual);
        (cell * DIRECTIONS + direction.min(DIRECTIONS - 1), if is_opposite { -residual } else { residual })
    };
    for event in events {
        let (index, residual) = place(event);
        if let Some(group) = groups.get_mut(index) {
            group.count += 1;
            group.sum += residual;
            group.squares += residual * residual;
        }
    }
    for event in events {
        let (index, residual) = place(event);
        if let Some(group) = groups.get_mut(index) {
            group.middle += usize::from((residual - group.mean()).abs() < MIDDLE * group.spread());
        }
    }
    let judged = || groups.iter().filter(|group| group.count >= FEWEST);
    let double = || judged().filter(|group| (group.middle as f64) < TWO_PEAKS * group.count as f64);
    let count = |groups: &mut dyn Iterator<Item = &Group>| groups.map(|group| group.count).sum::<usize>() as f64;
    let (all, twice) = (count(&mut judged()), count(&mut double()));
    let share = twice / all.max(1.0);
    let squares: f64 = double().map(|group| group.count as f64 * group.spread().powi(2)).sum();
    (share > SMALLEST_SHARE).then(|| TwoImages { share, distance: 2.0 * (squares / twice).sqrt() })
}

/// The residuals of one cell and direction.
#[derive(Clone, Copy, Default)]
struct Group {
    count: usize,
    sum: f64,
    squares: f64,
    middle: usize,
}

impl Group {
    fn mean(&self) -> f64 {
        self.sum / self.count.max(1) as f64
    }

    fn spread(&self) -> f64 {
        (self.squares / self.count.max(1) as f64 - self.mean().powi(2)).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use evcal_geometry::numerics::random::{normal, uniform_in};

    const SENSOR: Sensor = Sensor::new(346, 260);

    /// Events all over the sensor, on edges of all directions; `residual` returns the residual at a pixel of an edge with this normal.
    fn found(residual: impl Fn(&mut ChaCha8Rng, [f64; 2], [f64; 2]) -> f64) -> Option<TwoImages> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut event = || {
            let pixel = [uniform_in(&mut rng, 0.0, 346.0), uniform_in(&mut rng, 0.0, 260.0)];
            let angle = uniform_in(&mut rng, -3.14, 3.14);
            let normal = [libm::cos(angle), libm::sin(angle)];
            EventResidual {
                pixel: pixel.map(|coordinate| coordinate as u16),
                normal: normal.map(|part| part as f32),
                residual: residual(&mut rng, pixel, normal) as f32,
                ..EventResidual::default()
            }
        };
        let events: Vec<EventResidual> = (0..300_000).map(|_| event()).collect();
        two_images(&events, SENSOR)
    }

    /// Distance along the normal of a pixel from its place in the mean image, if an image is scaled by this share about the centre.
    fn scaled(share: f64, pixel: [f64; 2], normal: [f64; 2]) -> f64 {
        share * ((pixel[0] - 172.5) * normal[0] + (pixel[1] - 129.5) * normal[1])
    }

    #[test]
    fn noise_blur_and_a_wrong_scale_are_one_image() {
        assert_eq!(found(|rng, _, _| 0.15 * normal(rng)), None);
        // Outliers.
        assert_eq!(found(|rng, _, _| normal(rng) * if uniform_in(rng, 0.0, 1.0) < 0.1 { 1.0 } else { 0.15 }), None);
        // More blur in the corners.
        assert_eq!(found(|rng, [x, y], _| normal(rng) * (0.1 + 3e-3 * (x - 172.5).hypot(y - 129.5))), None);
        // A wrong focal length.
        assert_eq!(found(|rng, pixel, along| 0.15 * normal(rng) + scaled(0.006, pixel, along)), None);
    }

    /// Two cameras whose focal lengths differ by 1.2 %.
    #[test]
    fn two_scales_are_two_images() {
        let two = |rng: &mut ChaCha8Rng, pixel, along| {
            let side = if uniform_in(rng, 0.0, 1.0) < 0.5 { 0.006 } else { -0.006 };
            0.15 * normal(rng) + scaled(side, pixel, along)
        };
        let images = found(two).expect("two images");
        assert!(images.share > 0.3 && (0.8..1.8).contains(&images.distance), "{images:?}");
    }
}
