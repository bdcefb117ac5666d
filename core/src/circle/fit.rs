//! Circle fit by Kåsa (IEEE Trans. Instrum. Meas. 25(1), 1976) from moments, and the mean deviation from a circle.

use crate::cluster::{CentralMoments, PixelRun};
use nalgebra::{RealField, Vector2};

/// A circle in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle<T> {
    /// Centre in pixels.
    pub center: Vector2<T>,
    /// Radius in pixels.
    pub radius: T,
}

/// Returns the circle that minimises Σ(‖p − c‖² − r²)² over the pixels of `moments`.
///
/// In coordinates centred on the mean the problem separates into a 2×2 system for the centre, and the radius from the
/// mean square. Returns `None` if the pixels lie on a line or there are fewer than three.
pub fn fit_circle<T: RealField + Copy>(moments: &CentralMoments<T>) -> Option<Circle<T>> {
    let CentralMoments { n, mean_x, mean_y, uu, uv, vv, uz, vz } = *moments;
    let determinant = uu * vv - uv * uv;
    let trace = uu + vv;
    // The ratio of the smallest to the largest eigenvalue of the scatter is about determinant / trace².
    let smallest = trace * trace * nalgebra::convert(1e-4);
    if determinant <= smallest {
        return None;
    }
    let scale = (determinant + determinant).recip();
    let offset = Vector2::new((uz * vv - vz * uv) * scale, (vz * uu - uz * uv) * scale);
    let radius = (offset.norm_squared() + trace / n).sqrt();
    Some(Circle { center: Vector2::new(mean_x, mean_y) + offset, radius })
}

/// Returns the direction from the mean of the pixels to the centre of the circle through them, not normalised.
pub(super) fn toward_center<T: RealField + Copy>(moments: &CentralMoments<T>) -> Vector2<T> {
    let CentralMoments { uu, uv, vv, uz, vz, .. } = *moments;
    Vector2::new(uz * vv - vz * uv, vz * uu - uz * uv)
}

/// Returns the sum of the absolute distances of the pixels of `runs` from `circle`.
///
/// The distance of a pixel from the centre is computed by two Newton steps that start at the radius, because a square
/// root costs a hundred instructions on a microcontroller. It is at most 0.05 % of the radius too large between 0.8 and
/// 1.25 radii from the centre, and more further away.
pub(super) fn total_deviation<T: RealField + Copy>(circle: &Circle<T>, runs: impl Iterator<Item = PixelRun>) -> T {
    let Circle { center, radius } = *circle;
    let half: T = nalgebra::convert(0.5);
    let half_over_radius = half / radius;
    let half_radius = half * radius;
    let mut total = T::zero();
    for run in runs {
        let dy = from_u16::<T>(run.y) - center.y;
        let dy_squared = dy * dy;
        let mut dx = from_u16::<T>(run.x) - center.x;
        for _ in 0..run.length() {
            let square = dx * dx + dy_squared;
            let near = square * half_over_radius + half_radius;
            let distance = (near + square / near) * half;
            total += (distance - radius).abs();
            dx += T::one();
        }
    }
    total
}

fn from_u16<T: RealField>(value: u16) -> T {
    T::from_u16(value).unwrap_or_else(T::zero)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::PixelSums;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn arc(circle: &Circle<f64>, from: f64, to: f64) -> impl Iterator<Item = (f64, f64)> {
        let circle = *circle;
        (0..40).map(move |index| {
            let angle = from + (to - from) * f64::from(index) / 39.0;
            (circle.center.x + circle.radius * angle.cos(), circle.center.y + circle.radius * angle.sin())
        })
    }

    proptest! {
        #[test]
        fn points_on_a_circle_give_that_circle(
            x in -500.0..500.0_f64,
            y in -500.0..500.0_f64,
            radius in 2.0..60.0_f64,
            from in 0.0..6.3_f64,
            length in 0.7..6.3_f64,
        ) {
            let circle = Circle { center: Vector2::new(x, y), radius };
            let points: Vec<(f64, f64)> = arc(&circle, from, from + length).collect();
            let fit = fit_circle(&CentralMoments::by_definition(&points)).unwrap();
            prop_assert!((fit.center - circle.center).norm() < 1e-6 * radius, "{:?}", fit);
            prop_assert!((fit.radius - radius).abs() < 1e-6 * radius, "{:?}", fit);
        }

        /// The gradient of Σ(‖p − c‖² − r²)² vanishes at the fit, whatever the points.
        #[test]
        fn the_fit_is_stationary(points in prop::collection::vec((0_i32..60, 0_i32..60), 5..80)) {
            let mut sums = PixelSums::default();
            for &(x, y) in &points {
                sums.add_run(x, y, 1);
            }
            let moments = CentralMoments::<f64>::new(&sums, 0, 0).unwrap();
            if let Some(Circle { center, radius }) = fit_circle(&moments) {
                let mut gradient = [0.0; 3];
                let mut scale = 0.0;
                for &(x, y) in &points {
                    let offset = Vector2::new(f64::from(x), f64::from(y)) - center;
                    let residual = offset.norm_squared() - radius * radius;
                    gradient[0] += residual;
                    gradient[1] += residual * offset.x;
                    gradient[2] += residual * offset.y;
                    scale += offset.norm_squared() + residual.abs() * offset.norm();
                }
                prop_assert!(gradient.iter().all(|value| value.abs() < 1e-7 * scale), "{:?} of {}", gradient, scale);
            }
        }

        #[test]
        fn the_direction_to_the_centre_follows_from_the_arc(
            radius in 4.0..40.0_f64, middle in 0.0..6.3_f64, half_angle in 0.4..1.6_f64,
        ) {
            let circle = Circle { center: Vector2::new(0.0, 0.0), radius };
            let points: Vec<(f64, f64)> = arc(&circle, middle - half_angle, middle + half_angle).collect();
            let inward = toward_center(&CentralMoments::by_definition(&points)).normalize();
            let expected = -Vector2::new(middle.cos(), middle.sin());
            prop_assert!((inward - expected).norm() < 1e-6);
        }

        #[test]
        fn deviation_equals_the_distances(x in 80.0..90.0_f64, y in 80.0..90.0_f64, radius in 5.0..30.0_f64) {
            let circle = Circle { center: Vector2::new(x, y), radius };
            let pixels: Vec<(u16, u16)> =
                arc(&circle, 0.0, 4.0).map(|(x, y)| ((x * 1.02).round() as u16, y.round() as u16)).collect();
            let runs = pixels.iter().map(|&(x, y)| PixelRun { x, last: x, y });
            let total = total_deviation(&circle, runs);
            let exact: f64 = pixels
                .iter()
                .map(|&(px, py)| ((f64::from(px) - x).hypot(f64::from(py) - y) - radius).abs())
                .sum();
            // Pixels of small circles may lie further than 0.2 radii from the circle.
            prop_assert!((total - exact).abs() < 0.002 * radius * pixels.len() as f64, "{} {}", total, exact);
        }
    }

    #[test]
    fn a_line_has_no_circle() {
        let line: Vec<(f64, f64)> = (0..20).map(|x| (f64::from(x), 2.0 * f64::from(x) + 1.0)).collect();
        assert_eq!(fit_circle(&CentralMoments::by_definition(&line)), None);
        assert_eq!(fit_circle(&CentralMoments::by_definition(&[(3.0, 4.0)])), None);
    }

    #[test]
    fn a_run_counts_as_its_pixels() {
        let circle = Circle::<f64> { center: Vector2::new(20.3, 17.8), radius: 9.0 };
        let run = PixelRun { x: 12, last: 26, y: 14 };
        let pixels = run.pixels().map(|(x, y)| PixelRun { x, last: x, y });
        let (whole, parts) = (total_deviation(&circle, [run].into_iter()), total_deviation(&circle, pixels));
        assert!((whole - parts).abs() < 1e-9);
    }
}
