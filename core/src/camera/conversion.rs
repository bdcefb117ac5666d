//! Conversion between ordinary (forward) radial distortion and inverse radial distortion.
//!
//! Drap and Lefèvre give the inverse as a power series, which is accurate for small radii only: with k1 = -0.3 the
//! error is several pixels in the corners of a DAVIS346. Here the coefficients are a weighted least-squares fit over
//! all radii of the sensor, up to its farthest corner, with errors measured in pixels. The camera matrix is kept.
//! Tangential distortion is lost because the inverse radial model has none; [`super::refit::difference`] measures the
//! resulting error, and [`super::refit::refit`] adjusts the camera matrix as well.
//!
//! The fit is linear: with a = √τ a_max, Σ w² (a + Σ c_i a τ^i - value)² is minimised over c by orthogonalisation
//! (modified Gram-Schmidt on the matrix extended by its right side, which is as stable as Householder's method; Björck
//! 1967).

use nalgebra::RealField;

use super::CameraModel;
use super::inverse_radial::InverseRadial;
use super::radtan::{Radtan, Radtan5};
use crate::sensor::Sensor;

/// Number of radii in a fit.
const SAMPLES: usize = 128;

/// One radius of a fit.
#[derive(Clone, Copy)]
struct Sample<T> {
    argument: T,
    value: T,
    /// Pixels per unit of `value`, up to a common factor.
    weight: T,
}

/// Returns the inverse radial camera nearest to the radial part of `camera` on `sensor`.
///
/// Returns `None` if `camera` is not defined on enough of the sensor.
pub fn inverse_radial_from_radtan<T: RealField + Copy, const N: usize>(
    camera: &Radtan<T, N>,
    sensor: Sensor,
) -> Option<InverseRadial<T>> {
    let radial = camera.radial_part();
    let corner = radial.matrix().corner_radius(sensor);
    let samples = samples(corner, |distorted| {
        let (ideal, distorted_by_ideal) = radial.undistort_radius(distorted)?;
        Some(Sample { argument: distorted, value: ideal, weight: distorted_by_ideal })
    });
    let coefficients: [T; 5] = fit(&samples)?;
    InverseRadial::from_parameters(&radial.matrix().parameters(&coefficients))
}

/// Returns the radial-tangential camera (k1 k2 0 0 k3) nearest to `camera` on `sensor`.
///
/// Returns `None` if `camera` is not defined on enough of the sensor.
pub fn radtan_from_inverse_radial<T: RealField + Copy>(
    camera: &InverseRadial<T>,
    sensor: Sensor,
) -> Option<Radtan5<T>> {
    let corner = camera.matrix().corner_radius(sensor);
    let samples = samples(corner, |distorted| {
        let ideal = (distorted < camera.radius().limit()).then(|| camera.radius().value_and_slope(distorted).0)?;
        Some(Sample { argument: ideal, value: distorted, weight: T::one() })
    });
    let [k1, k2, k3] = fit(&samples)?;
    let zero = T::zero();
    Radtan5::from_parameters(&camera.matrix().parameters(&[k1, k2, zero, zero, k3]))
}

/// Returns samples at distorted radii from near 0 to `corner`, as many as are in the domain.
fn samples<T: RealField + Copy>(
    corner: T,
    sample: impl Fn(T) -> Option<Sample<T>>,
) -> heapless::Vec<Sample<T>, SAMPLES> {
    let mut samples = heapless::Vec::new();
    for index in 1..=SAMPLES {
        let part = nalgebra::convert::<f64, T>(index as f64 / SAMPLES as f64);
        if let Some(sample) = sample(corner * part) {
            // Cannot be full: one push for each of SAMPLES.
            let _ = samples.push(sample);
        }
    }
    samples
}

/// Returns the coefficients c of `value ≈ argument (1 + Σ c_i argument^2i)`; `None` if there are too few samples.
fn fit<T: RealField + Copy, const N: usize>(samples: &heapless::Vec<Sample<T>, SAMPLES>) -> Option<[T; N]> {
    if samples.len() < 4 * N {
        return None;
    }
    let largest = samples.iter().fold(T::zero(), |largest, sample| largest.max(sample.argument));
    let scale = T::one() / (largest * largest);
    let mut columns = [[T::zero(); SAMPLES]; N];
    let mut right = [T::zero(); SAMPLES];
    for (row, sample) in samples.iter().enumerate() {
        let square = sample.argument * sample.argument * scale;
        let mut entry = sample.weight * sample.argument;
        for column in &mut columns {
            entry *= square;
            if let Some(slot) = column.get_mut(row) {
                *slot = entry;
            }
        }
        if let Some(slot) = right.get_mut(row) {
            *slot = sample.weight * (sample.value - sample.argument);
        }
    }
    let mut solution = orthogonal_solution(columns, right)?;
    let mut power = T::one();
    for coefficient in &mut solution {
        power *= scale;
        *coefficient *= power;
    }
    Some(solution)
}

/// Returns the coefficients c that minimise |Σ c_i columns_i - right|; `None` if the columns are dependent.
fn orthogonal_solution<T: RealField + Copy, const N: usize>(
    mut columns: [[T; SAMPLES]; N],
    mut right: [T; SAMPLES],
) -> Option<[T; N]> {
    let dot = |left: &[T; SAMPLES], right: &[T; SAMPLES]| {
        left.iter().zip(right).fold(T::zero(), |sum, (&left, &right)| sum + left * right)
    };
    let subtract = |from: &mut [T; SAMPLES], factor: T, column: &[T; SAMPLES]| {
        for (from, &column) in from.iter_mut().zip(column) {
            *from -= factor * column;
        }
    };
    // Row i of the triangle: its entries to the right of the diagonal, from the last one backwards.
    let mut triangle = [[T::zero(); N]; N];
    let mut projected = [T::zero(); N];
    let mut remaining = columns.as_mut_slice();
    let rows = triangle.iter_mut().zip(projected.iter_mut());
    for (row, projected) in rows {
        let (column, later) = remaining.split_first_mut()?;
        let square = dot(column, column);
        if !(square > T::zero() && square.is_finite()) {
            return None;
        }
        for (other, factor) in later.iter_mut().rev().zip(row.iter_mut()) {
            *factor = dot(column, other) / square;
            subtract(other, *factor, column);
        }
        *projected = dot(column, &right) / square;
        subtract(&mut right, *projected, column);
        remaining = later;
    }
    // Back substitution from the last unknown. `solved` contains the unknowns found so far, and `row` their factors, in
    // the same order.
    let mut solved: heapless::Vec<T, N> = heapless::Vec::new();
    for (row, &projected) in triangle.iter().zip(&projected).rev() {
        let value = row.iter().zip(&solved).fold(projected, |sum, (&factor, &known)| sum - factor * known);
        solved.push(value).ok()?;
    }
    solved.reverse();
    solved.into_array().ok()
}

#[cfg(test)]
mod tests {
    use super::super::Camera;
    use super::super::refit::difference;
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    const SENSOR: Sensor = Sensor::new(346, 260);

    fn radtan(coefficients: [f64; 5]) -> Radtan5<f64> {
        let [k1, k2, p1, p2, k3] = coefficients;
        Radtan5::from_parameters(&[345.0, 343.0, 170.0, 127.0, k1, k2, p1, p2, k3]).unwrap()
    }

    /// Returns the power series of Drap and Lefèvre with k4 = 0.
    fn series([k1, k2, k3]: [f64; 3]) -> [f64; 5] {
        [
            -k1,
            3.0 * k1.powi(2) - k2,
            -12.0 * k1.powi(3) + 8.0 * k1 * k2 - k3,
            55.0 * k1.powi(4) - 55.0 * k1.powi(2) * k2 + 5.0 * k2.powi(2) + 10.0 * k1 * k3,
            -273.0 * k1.powi(5) + 364.0 * k1.powi(3) * k2 - 78.0 * k1 * k2.powi(2) - 78.0 * k1.powi(2) * k3
                + 12.0 * k2 * k3,
        ]
    }

    #[test]
    fn fit_approaches_the_power_series_for_weak_distortion() {
        let (k1, k2, k3) = (-0.001, 0.0004, -0.0002);
        let camera = inverse_radial_from_radtan(&radtan([k1, k2, 0.0, 0.0, k3]), SENSOR).unwrap();
        let fitted = camera.parameters();
        for (power, (fitted, expected)) in fitted[4..].iter().zip(series([k1, k2, k3])).enumerate() {
            // At the corner (radius 0.64) a coefficient is multiplied by 0.64^(2 i + 1).
            let effect = (fitted - expected) * 0.64_f64.powi(2 * power as i32 + 3);
            assert!(effect.abs() < 1e-8, "k{}: {fitted} {expected}", power + 1);
        }
    }

    #[test]
    fn strong_barrel_distortion_converts_where_the_series_fails() {
        let forward = radtan([-0.3, 0.08, 0.0, 0.0, 0.0]);
        let fitted = inverse_radial_from_radtan(&forward, SENSOR).unwrap();
        let forward_camera = Camera::Radtan(forward);
        let fitted_difference = difference(&forward_camera, &Camera::InverseRadial(fitted), SENSOR);
        assert_eq!(fitted_difference.outside, 0);
        assert!(fitted_difference.largest < 0.01, "{fitted_difference:?}");
        let with_series = forward.matrix().parameters(&series([-0.3, 0.08, 0.0]));
        let series_camera = Camera::InverseRadial(InverseRadial::from_parameters(&with_series).unwrap());
        let series_difference = difference(&forward_camera, &series_camera, SENSOR);
        assert!(series_difference.largest > 10.0 * fitted_difference.largest, "{series_difference:?}");
    }

    #[test]
    fn the_conversion_loses_only_tangential_distortion() {
        let p1 = 1e-3;
        let forward = radtan([-0.2, 0.05, p1, 0.0, 0.0]);
        let fitted = inverse_radial_from_radtan(&forward, SENSOR).unwrap();
        let lost = difference(&Camera::Radtan(forward), &Camera::InverseRadial(fitted), SENSOR);
        let ideal_corner = (176.0_f64 / 345.0).hypot(133.0 / 343.0) * 1.2;
        assert!(lost.largest > 0.1 && lost.largest < 3.0 * p1 * ideal_corner.powi(2) * 345.0, "{lost:?}");
    }

    #[test]
    fn a_camera_without_distortion_converts_to_one_without() {
        let fitted = inverse_radial_from_radtan(&radtan([0.0; 5]), SENSOR).unwrap();
        assert_eq!(fitted.parameters()[4..], [0.0; 5]);
        let back = radtan_from_inverse_radial(&fitted, SENSOR).unwrap();
        assert_eq!(back, radtan([0.0; 5]));
    }

    #[test]
    fn single_precision_converts_too() {
        let parameters = [345.0_f32, 343.0, 170.0, 127.0, -0.3, 0.08, 0.0, 0.0];
        let forward = super::super::Radtan4::from_parameters(&parameters).unwrap();
        let fitted = inverse_radial_from_radtan(&forward, SENSOR).unwrap();
        let lost = difference(&Camera::Radtan4(forward), &Camera::InverseRadial(fitted), SENSOR);
        assert!(lost.largest < 0.01 && lost.outside == 0, "{lost:?}");
    }

    proptest! {
        #[test]
        fn conversion_there_and_back_stays_within_a_hundredth_of_a_pixel(
            k1 in -0.25..0.2_f64,
            k2 in -0.05..0.1_f64,
        ) {
            let forward = radtan([k1, k2, 0.0, 0.0, 0.0]);
            let inverse = inverse_radial_from_radtan(&forward, SENSOR);
            prop_assume!(forward.unproject(&Vector2::new(345.0, 259.0)).is_some());
            let back = radtan_from_inverse_radial(&inverse.unwrap(), SENSOR).unwrap();
            let lost = difference(&Camera::Radtan(forward), &Camera::Radtan(back), SENSOR);
            prop_assert!(lost.largest < 0.01, "{lost:?}");
        }
    }
}
