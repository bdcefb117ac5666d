//! Fits a lens to another one with some parameters fixed.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::{DMatrix, DVector, Vector2, Vector3};

use super::projection_difference::grid;

/// Largest number of Newton steps; each step nearly reaches the solution if the remaining problem is linear.
const STEPS: usize = 20;
/// The fit ends when no parameter changes by more than this fraction.
const SETTLED: f64 = 1e-10;

/// Sets the parameters of `camera` that have a value in `fixed` to that value, and fits the others. The fit brings the
/// pixels of bearings on `sensor` as close as possible to their pixels in `camera`. Returns `None` if the model rejects
/// the values.
pub fn with_fixed(camera: &Camera<f64>, fixed: &[Option<f64>; MAX_PARAMETERS], sensor: Sensor) -> Option<Camera<f64>> {
    let mut parameters = camera.parameters();
    let free: Vec<usize> = (0..parameters.len()).filter(|&index| fixed[index].is_none()).collect();
    if free.len() == parameters.len() {
        return Some(*camera);
    }
    let seen: Vec<(Vector2<f64>, Vector3<f64>)> =
        grid(sensor).into_iter().filter_map(|pixel| Some((pixel, camera.unproject(&pixel)?))).collect();
    for (parameter, fixed) in parameters.iter_mut().zip(fixed) {
        *parameter = fixed.unwrap_or(*parameter);
    }
    let mut nearest = Camera::from_parameters(camera.kind(), &parameters)?;
    for _ in 0..STEPS {
        let Some(step) = step(&nearest, &seen, &free) else { break };
        let mut moved = nearest.parameters();
        free.iter().zip(step.iter()).for_each(|(&index, step)| moved[index] -= step);
        let Some(next) = Camera::from_parameters(camera.kind(), &moved) else { break };
        nearest = next;
        if free.iter().zip(step.iter()).all(|(&index, step)| step.abs() <= SETTLED * (1.0 + moved[index].abs())) {
            break;
        }
    }
    Some(nearest)
}

/// Returns the step of the `free` parameters that brings the projections closer to the pixels in `seen`.
fn step(camera: &Camera<f64>, seen: &[(Vector2<f64>, Vector3<f64>)], free: &[usize]) -> Option<DVector<f64>> {
    let mut information = DMatrix::zeros(free.len(), free.len());
    let mut gradient = DVector::zeros(free.len());
    for (pixel, bearing) in seen {
        let Some(projection) = camera.project_with_jacobians(bearing) else { continue };
        let residual = projection.pixel - pixel;
        let by_free = DMatrix::from_fn(2, free.len(), |axis, index| projection.by_parameters[(axis, free[index])]);
        gradient += by_free.tr_mul(&residual);
        information += by_free.tr_mul(&by_free);
    }
    Some(information.cholesky()?.solve(&gradient))
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;
    use crate::lens::projection_difference::projection_difference;

    #[test]
    fn other_parameters_compensate_for_a_fixed_coefficient() {
        let sensor = Sensor::new(346, 260);
        let parameters = [331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03];
        let camera = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        let mut fixed = [None; MAX_PARAMETERS];
        assert_eq!(with_fixed(&camera, &fixed, sensor), Some(camera));
        fixed[8] = Some(0.0);
        let nearest = with_fixed(&camera, &fixed, sensor).unwrap();
        assert_eq!(nearest.parameters()[8], 0.0);
        let mut cut = camera.parameters();
        cut[8] = 0.0;
        let cut = Camera::from_parameters(ModelKind::Radtan, &cut).unwrap();
        let difference = |other: &Camera<f64>| projection_difference(&camera, other, sensor).unwrap().rms;
        assert!(difference(&nearest) < 0.3 * difference(&cut), "{} {}", difference(&nearest), difference(&cut));
    }
}
