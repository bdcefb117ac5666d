//! Where a lattice point must lie, by its neighbours: a local quadratic surface through the points
//! of the 5×5 sites around it, itself left out.
//!
//! Perspective and lens distortion are smooth, so a quadratic follows both over a few lattice
//! steps, whatever the lens; no camera model is needed.

use nalgebra::{Matrix2, RealField, Vector2};

use super::lattice::Lattice;
use super::points::Points;

/// Half the width of the neighbourhood, in lattice steps.
const REACH: i32 = 2;
/// Fewest neighbours that a prediction may rest on.
const FEWEST_NEIGHBOURS: usize = 4;
/// Weight of the assumption that second-order terms are small.
const FLATNESS: f64 = 0.3;
/// Number of terms: u², uv, v², u, v, 1.
const TERMS: usize = 6;

/// The prediction of one site.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prediction<T> {
    pub position: Vector2<T>,
    /// Image steps per lattice step: the columns belong to u and v.
    pub steps: Matrix2<T>,
    /// Variance of the prediction in units of the variance of one point.
    pub variance: T,
}

impl<T: RealField + Copy> Prediction<T> {
    /// Distance to the nearest lattice neighbour, squared.
    pub fn spacing_squared(&self) -> T {
        let (u, v) = (self.steps.column(0), self.steps.column(1));
        u.norm_squared().min(v.norm_squared()).min((u + v).norm_squared()).min((u - v).norm_squared())
    }
}

/// Predicts the point of site (u, v) from the points around it; none if they are too few or in line.
pub(super) fn predict<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    u: i32,
    v: i32,
) -> Option<Prediction<T>> {
    let mut normal = [[T::zero(); TERMS]; TERMS];
    let mut right = [Vector2::<T>::zeros(); TERMS];
    let mut count = 0;
    let mut origin: Option<Vector2<T>> = None;
    for dv in -REACH..=REACH {
        for du in -REACH..=REACH {
            if du == 0 && dv == 0 {
                continue;
            }
            let Some(position) = lattice.at(u + du, v + dv).and_then(|point| points.position(point)) else { continue };
            // Coordinates relative to a point near by, so that f32 suffices.
            let base = *origin.get_or_insert(position);
            let value = position - base;
            let weight: T = nalgebra::convert(1.0 / (1.0 + 0.1 * f64::from(du * du + dv * dv)));
            let (x, y): (T, T) = (nalgebra::convert(f64::from(du)), nalgebra::convert(f64::from(dv)));
            let terms = [x * x, x * y, y * y, x, y, T::one()];
            for row in 0..TERMS {
                let weighted = terms[row] * weight;
                for column in 0..=row {
                    normal[row][column] += weighted * terms[column];
                }
                right[row] += value * weighted;
            }
            count += 1;
        }
    }
    if count < FEWEST_NEIGHBOURS {
        return None;
    }
    let flatness: T = nalgebra::convert(FLATNESS);
    for (index, row) in normal.iter_mut().enumerate().take(3) {
        row[index] += flatness;
    }
    let factor = cholesky(normal)?;
    let solution = solve(&factor, right);
    let last = factor[TERMS - 1][TERMS - 1];
    Some(Prediction {
        position: solution[5] + origin?,
        steps: Matrix2::from_columns(&[solution[3], solution[4]]),
        variance: T::one() / (last * last),
    })
}

/// Lower triangular factor; none if the matrix is not clearly positive definite.
fn cholesky<T: RealField + Copy>(mut matrix: [[T; TERMS]; TERMS]) -> Option<[[T; TERMS]; TERMS]> {
    let least_pivot: T = nalgebra::convert(0.02);
    for column in 0..TERMS {
        let mut pivot = matrix[column][column];
        for inner in 0..column {
            pivot -= matrix[column][inner] * matrix[column][inner];
        }
        if pivot < least_pivot {
            return None;
        }
        let root = pivot.sqrt();
        matrix[column][column] = root;
        for row in column + 1..TERMS {
            let mut value = matrix[row][column];
            for inner in 0..column {
                value -= matrix[row][inner] * matrix[column][inner];
            }
            matrix[row][column] = value / root;
        }
    }
    Some(matrix)
}

/// Solves L Lᵀ x = b.
fn solve<T: RealField + Copy>(factor: &[[T; TERMS]; TERMS], mut right: [Vector2<T>; TERMS]) -> [Vector2<T>; TERMS] {
    for row in 0..TERMS {
        let mut value = right[row];
        for inner in 0..row {
            value -= right[inner] * factor[row][inner];
        }
        right[row] = value / factor[row][row];
    }
    for row in (0..TERMS).rev() {
        let mut value = right[row];
        for inner in row + 1..TERMS {
            value -= right[inner] * factor[inner][row];
        }
        right[row] = value / factor[row][row];
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::GridCandidate;

    #[test]
    fn a_quadratic_surface_is_predicted_with_its_steps() {
        let surface = |u: f64, v: f64| {
            Vector2::new(40.0 + 12.0 * u + 2.0 * v + 0.1 * u * u, 50.0 - u + 11.0 * v - 0.2 * u * v + 0.05 * v * v)
        };
        let mut candidates = std::vec::Vec::new();
        for v in -2..=2 {
            for u in -2..=2 {
                candidates.push(GridCandidate { center: surface(f64::from(u), f64::from(v)), radius: 0.0 });
            }
        }
        let mut points = Points::<f64, 32>::new();
        assert!(points.load(&candidates));
        let mut lattice = Lattice::<32>::new();
        for v in -2..=2 {
            for u in -2..=2 {
                let position = surface(f64::from(u), f64::from(v));
                let point = points.nearest(&position, 1e-6).unwrap().point;
                if (u, v) != (0, 0) {
                    assert!(lattice.place(u, v, point));
                }
            }
        }
        let prediction = predict(&lattice, &points, 0, 0).unwrap();
        // The assumption of flatness shrinks the quadratic terms a little.
        assert!((prediction.position - surface(0.0, 0.0)).norm() < 0.01, "{prediction:?}");
        assert!((prediction.steps - Matrix2::new(12.0, 2.0, -1.0, 11.0)).norm() < 1e-9, "{prediction:?}");
        assert!(prediction.variance > 0.05 && prediction.variance < 0.5, "{prediction:?}");
    }
}
