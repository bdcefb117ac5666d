use evcal_core::sensor::Sensor;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const SENSOR: Sensor = Sensor::new(320, 240);
const SIGMA: f64 = 0.3;

/// A normal deviate.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let mut uniform = || (f64::from(random.next_u32()) + 0.5) / 2f64.powi(32);
    let (a, b) = (uniform(), uniform());
    (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

/// Edges of all directions all over the sensor for 4 s. The image is displaced by `shift(pixel)`, and events lie `outward`
/// further out; their noise has an individual part, and a part that all events of a crossing share.
fn observations(shift: impl Fn([f64; 2]) -> Vector2<f64>, outward: f64, shared: f64) -> Vec<Observation> {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut all = Vec::new();
    for crossing in 0..20_000 {
        let t = f64::from(crossing) * 2e-4;
        let pixel = [f64::from(random.next_u32() % 320), f64::from(random.next_u32() % 240)];
        let angle = f64::from(random.next_u32() % 360).to_radians();
        let row = Vector3::new(angle.cos(), angle.sin(), 1.0);
        let common = shared * normal(&mut random);
        for _ in 0..8 {
            let residual = row.xy().dot(&shift(pixel)) + outward + common + SIGMA * normal(&mut random);
            all.push(Observation { t, pixel, row, residual, weight: 1.0 / (SIGMA * SIGMA) });
        }
    }
    all
}

fn of(observations: &[Observation]) -> ResidualMap {
    map_of(SENSOR, || observations.iter().copied())
}

#[test]
fn a_displacement_is_found_where_it_is() {
    // To the right in the left half, downwards in the right half.
    let shift = |pixel: [f64; 2]| if pixel[0] < 160.0 { Vector2::new(0.2, 0.0) } else { Vector2::new(0.0, 0.1) };
    let map = of(&observations(shift, -0.05, 0.0));
    assert_eq!((map.columns, map.rows, map.cell, map.cells.len()), (16, 12, [318.0 / 16.0, 238.0 / 12.0], 192));
    assert_eq!(map.pattern.cells, 192);
    for (index, cell) in map.cells.iter().enumerate() {
        let found = cell.displacement.unwrap();
        let truth = shift([20.0 * (index % 16) as f64 + 10.0, 0.0]);
        let sigma = found.covariance.diagonal().map(f64::sqrt);
        assert!((found.shift - truth).component_div(&sigma).amax() < 5.0, "cell {index}: {found:?}");
        let (outward, sigma) = found.outward.unwrap();
        assert!((outward + 0.05).abs() < 5.0 * sigma, "cell {index}: {found:?}");
    }
    let rms = ((0.2_f64.powi(2) + 0.1_f64.powi(2)) / 2.0).sqrt();
    assert!((map.pattern.shift - rms).abs() < 0.01, "{:?}", map.pattern);
    assert!((map.pattern.outward - 0.05).abs() < 0.005, "{:?}", map.pattern);
    assert!(map.pattern.shift_ratio > 5.0 && map.pattern.outward_ratio > 2.0, "{:?}", map.pattern);
}

#[test]
fn noise_alone_has_a_ratio_of_one_even_if_events_have_common_errors() {
    for shared in [0.0, 0.3, 1.0] {
        let observations = observations(|_| Vector2::zeros(), 0.0, shared);
        let ResidualPattern { cells, shift, shift_ratio, outward_ratio, .. } = of(&observations).pattern;
        assert_eq!(cells, 192);
        assert!((0.85..1.15).contains(&shift_ratio), "shared {shared}: {shift_ratio}");
        assert!((0.8..1.2).contains(&outward_ratio), "shared {shared}: {outward_ratio}");
        assert!(shift < 0.03 + 0.1 * shared, "shared {shared}: {shift}");
    }
}

#[test]
fn edges_of_one_direction_do_not_determine_a_displacement() {
    let mut observations = observations(|_| Vector2::zeros(), 0.0, 0.0);
    for observation in &mut observations {
        observation.row = Vector3::new(observation.row.x.signum(), 0.0, 1.0);
    }
    let map = of(&observations);
    assert_eq!(map.pattern, ResidualPattern::default());
    assert!(map.cells.iter().all(|cell| cell.count > 0 && (cell.rms - SIGMA).abs() < 0.05));
}

#[test]
fn circle_centres_determine_a_displacement_but_no_outward_shift() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut all = Vec::new();
    for frame in 0..400 {
        let (t, pixel) = (f64::from(frame) * 0.06, [100.0, 100.0]);
        for (row, mean) in [(Vector3::x(), 0.1), (Vector3::y(), -0.2)] {
            all.push(Observation { t, pixel, row, residual: mean + 0.1 * normal(&mut random), weight: 100.0 });
        }
    }
    let map = of(&all);
    let found = map.cells[5 * 16 + 5].displacement.unwrap();
    assert_eq!(found.outward, None);
    assert!((found.shift - Vector2::new(0.1, -0.2)).amax() < 0.02);
    // 400 independent frames.
    assert!((found.covariance[(0, 0)].sqrt() / (0.1 / 20.0) - 1.0).abs() < 0.2, "{found:?}");
    assert_eq!(map.pattern.cells, 1);
}

#[test]
fn a_map_without_observations_is_empty() {
    let map = of(&[]);
    assert_eq!(map.pattern, ResidualPattern::default());
    assert!(map.cells.iter().all(|cell| *cell == CellResiduals::default()));
}

/// 346 × 260 pixels had a thirteenth row of cells, one pixel high, which counted as much as any other row. Events of the outermost
/// pixels were displaced by 0.25 px in it, and a flat board was suspected to be wavy.
#[test]
fn the_outermost_pixels_do_not_count() {
    let sensor = Sensor::new(346, 260);
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut all = Vec::new();
    for index in 0..200_000 {
        let pixel = [f64::from(random.next_u32() % 346), f64::from(random.next_u32() % 260)];
        let is_outermost = pixel[0] < 1.0 || pixel[1] < 1.0 || pixel[0] > 344.0 || pixel[1] > 258.0;
        let angle = f64::from(random.next_u32() % 360).to_radians();
        let row = Vector3::new(angle.cos(), angle.sin(), 1.0);
        let shift = if is_outermost { Vector2::new(0.0, 0.25) } else { Vector2::zeros() };
        let residual = row.xy().dot(&shift) + SIGMA * normal(&mut random);
        all.push(Observation { t: f64::from(index) * 2e-5, pixel, row, residual, weight: 1.0 / (SIGMA * SIGMA) });
    }
    let map = map_of(sensor, || all.iter().copied());
    assert_eq!((map.rows, map.cell), (12, [21.5, 21.5]));
    assert!(map.pattern.shift < 0.01 && map.pattern.shift_ratio < 1.15, "{:?}", map.pattern);
}

#[test]
fn all_cells_of_a_sensor_have_the_same_size() {
    for [width, height] in
        [[346, 260], [128, 128], [240, 180], [304, 240], [320, 320], [640, 480], [1280, 720], [1281, 721]]
    {
        let map = map_of(Sensor::new(width, height), std::iter::empty);
        let places: Vec<[f64; 4]> = map.places().collect();
        assert_eq!(places.len(), map.cells.len());
        let (first, last) = (places[0], places[places.len() - 1]);
        assert_eq!((first[0], first[1]), (0.5, 0.5));
        let far = [f64::from(width) - 1.5, f64::from(height) - 1.5];
        assert!((last[2] - far[0]).abs() < 1e-9 && (last[3] - far[1]).abs() < 1e-9, "{last:?}");
        let [cell_width, cell_height] = map.cell;
        assert!((0.75..1.34).contains(&(cell_width / cell_height)), "{:?}", map.cell);
        assert!(places.iter().all(|[left, top, right, bottom]| {
            (right - left - cell_width).abs() < 1e-9 && (bottom - top - cell_height).abs() < 1e-9
        }));
    }
    // Sensors that are smaller than the cells are many.
    for sensor in [Sensor::new(1, 1), Sensor::new(2, 3), Sensor::new(9, 4)] {
        assert_eq!(map_of(sensor, std::iter::empty).pattern, ResidualPattern::default());
    }
}

/// A displacement of a few pixels must not weigh as much as the displacement of a whole cell.
#[test]
fn cells_count_as_much_as_they_have_pixels() {
    let cell = |shift: f64| CellResiduals {
        count: 100_000,
        blocks: 100_000,
        rms: 0.3,
        displacement: Some(Displacement {
            shift: Vector2::new(shift, 0.0),
            covariance: Matrix2::identity() * 1e-8,
            outward: None,
        }),
    };
    let (odd, good) = (cell(0.2), cell(0.0));
    let found = pattern([(&odd, 20), (&good, 380)].into_iter());
    assert!((found.shift - 0.2 * 0.05_f64.sqrt()).abs() < 1e-3, "{found:?}");
    assert_eq!(found.cells, 2);
}
