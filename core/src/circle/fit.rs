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

/// The circle that minimises Σ(‖p − c‖² − r²)² over the pixels of `moments`.
///
/// In coordinates centred on the mean the problem falls apart: a 2×2 system for the centre, and the
/// radius from the mean square. `None` if the pixels lie on a line (or there are fewer than three).
pub fn fit_circle<T: RealField + Copy>(moments: &CentralMoments<T>) -> Option<Circle<T>> {
    let CentralMoments { n, mean_x, mean_y, uu, uv, vv, uz, vz } = *moments;
    let determinant = uu * vv - uv * uv;
    let trace = uu + vv;
    // Smallest over largest eigenvalue of the scatter is about determinant / trace².
    let smallest = trace * trace * nalgebra::convert(1e-4);
    if determinant <= smallest {
        return None;
    }
    let scale = (determinant + determinant).recip();
    let offset = Vector2::new((uz * vv - vz * uv) * scale, (vz * uu - uz * uv) * scale);
    let radius = (offset.norm_squared() + trace / n).sqrt();
    Some(Circle { center: Vector2::new(mean_x, mean_y) + offset, radius })
}

/// The direction from the mean of the pixels to the centre of the circle through them, of any length.
pub(super) fn toward_center<T: RealField + Copy>(moments: &CentralMoments<T>) -> Vector2<T> {
    let CentralMoments { uu, uv, vv, uz, vz, .. } = *moments;
    Vector2::new(uz * vv - vz * uv, vz * uu - uz * uv)
}

/// Sum over the pixels of `runs` of their absolute distance from `circle`.
///
/// The distance of a pixel from the centre is taken by two Newton steps from the radius, since a
/// square root costs a hundred instructions on a microcontroller: at most 0.05 % of the radius too
/// large between 0.8 and 1.25 radii from the centre, more so further away.
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
        for _ in 0..run.length {
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
