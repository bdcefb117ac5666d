//! Fits the camera of one model to a camera of another model.
//!
//! Output formats support only some models, and a solve with one model may start from the result of another. Truncating
//! or renaming coefficients would be wrong; [`refit`] fits all parameters of the new model to the old camera over the
//! whole sensor, and [`difference`] measures the remaining error.
//!
//! Both compare on a grid of 33 × 33 pixels that spans the sensor, corners included: a pixel is unprojected by the old
//! camera and projected by the new one. No rotation is removed, so that poses estimated with the old camera remain
//! valid.
//!
//! The fit uses the Levenberg-Marquardt method, with columns scaled to unit length. It needs about 52 KB of stack in double
//! precision for the bearings of the grid.

use nalgebra::{RealField, SMatrix, SVector, Vector2, Vector3};

use super::{Camera, MAX_PARAMETERS, ModelKind};
use crate::sensor::Sensor;

/// Columns and rows of the grid of pixels.
const GRID: u16 = 33;

/// Number of pixels of the grid.
const GRID_PIXELS: usize = GRID as usize * GRID as usize;

/// Largest number of steps of a fit, including rejected ones.
const MAX_STEPS: usize = 300;

/// Distance between two cameras on a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference<T> {
    /// Root mean square distance, in pixels.
    pub root_mean_square: T,
    /// Largest distance, in pixels.
    pub largest: T,
    /// Grid points that were compared.
    pub compared: usize,
    /// Grid points outside the domain of one of the cameras.
    pub outside: usize,
}

/// Compares two cameras on `sensor`, in pixels of `other`.
pub fn difference<T: RealField + Copy>(reference: &Camera<T>, other: &Camera<T>, sensor: Sensor) -> Difference<T> {
    difference_where(reference, other, sensor, |_| true)
}

/// Compares two cameras like [`difference`], on the pixels that are `inside`.
pub fn difference_where<T: RealField + Copy>(
    reference: &Camera<T>,
    other: &Camera<T>,
    sensor: Sensor,
    inside: impl Fn(&Vector2<T>) -> bool,
) -> Difference<T> {
    let mut sum = T::zero();
    let mut largest = T::zero();
    let (mut compared, mut outside) = (0, 0);
    for pixel in grid(sensor).filter(inside) {
        let seen = reference.unproject(&pixel).and_then(|bearing| other.project(&bearing));
        if let Some(seen) = seen {
            let square = (seen - pixel).norm_squared();
            sum += square;
            largest = largest.max(square);
            compared += 1;
        } else {
            outside += 1;
        }
    }
    let mean = if compared > 0 { sum / nalgebra::convert(compared as f64) } else { T::zero() };
    Difference { root_mean_square: mean.sqrt(), largest: largest.sqrt(), compared, outside }
}

/// Returns the camera of model `kind` nearest to `reference` on `sensor`.
///
/// Minimises the sum of squared [`difference`]s over all parameters. Pixels are ignored if `reference` does not define
/// them, or if the start camera of the new model cannot see them (more than 89° off the axis for pinhole models).
/// Returns `None` if fewer than half of the grid's pixels remain.
pub fn refit<T: RealField + Copy>(kind: ModelKind, reference: &Camera<T>, sensor: Sensor) -> Option<Camera<T>> {
    refit_where(kind, reference, sensor, |_| true)
}

/// Fits like [`refit`], on the pixels that are `inside`: beyond the region covered by a calibration, a polynomial is
/// arbitrary and should not count. Returns `None` if fewer than half of these pixels remain.
pub fn refit_where<T: RealField + Copy>(
    kind: ModelKind,
    reference: &Camera<T>,
    sensor: Sensor,
    inside: impl Fn(&Vector2<T>) -> bool,
) -> Option<Camera<T>> {
    let mut best: Option<(Camera<T>, NormalEquations<T>)> = None;
    for (camera, equations) in fits(kind, reference, sensor, &inside) {
        let better = best.as_ref().is_none_or(|(_, best)| {
            equations.compared > best.compared || equations.compared == best.compared && equations.cost < best.cost
        });
        if better {
            best = Some((camera, equations));
        }
    }
    Some(best?.0)
}

/// Returns the cameras of model `kind` nearest to `reference` on `sensor`, one per local minimum: one for each of the
/// model's [`fit_starts`](super::expectation::Expectation::fit_starts) that leads to a camera.
pub fn refits<T: RealField + Copy>(
    kind: ModelKind,
    reference: &Camera<T>,
    sensor: Sensor,
) -> impl Iterator<Item = Camera<T>> {
    fits(kind, reference, sensor, &|_: &Vector2<T>| true).map(|(camera, _)| camera)
}

/// Returns a fit from each start of model `kind`.
fn fits<T: RealField + Copy, F: Fn(&Vector2<T>) -> bool>(
    kind: ModelKind,
    reference: &Camera<T>,
    sensor: Sensor,
    inside: &F,
) -> impl Iterator<Item = (Camera<T>, NormalEquations<T>)> {
    let targets = Targets::new(reference, grid(sensor).filter(inside));
    kind.expectation().fit_starts.iter().filter_map(move |coefficients| {
        let start = start(kind, reference, coefficients)?;
        fit(kind, start, &targets)
    })
}

/// Pixels of a camera and their bearings, which every step of a fit uses.
struct Targets<T> {
    /// `None` for a pixel that the camera does not define.
    places: [Option<(Vector2<T>, Vector3<T>)>; GRID_PIXELS],
    /// Number of pixels, including those that the camera does not define.
    pixels: usize,
}

impl<T: RealField + Copy> Targets<T> {
    /// Unprojects the first [`GRID_PIXELS`] of `pixels`.
    fn new(reference: &Camera<T>, pixels: impl Iterator<Item = Vector2<T>>) -> Self {
        let mut targets = Self { places: [None; GRID_PIXELS], pixels: 0 };
        for (place, pixel) in targets.places.iter_mut().zip(pixels) {
            *place = reference.unproject(&pixel).map(|bearing| (pixel, bearing));
            targets.pixels += 1;
        }
        targets
    }
}

/// Moves `parameters` of model `kind` to the camera nearest to `targets`.
fn fit<T: RealField + Copy>(
    kind: ModelKind,
    mut parameters: SVector<T, MAX_PARAMETERS>,
    targets: &Targets<T>,
) -> Option<(Camera<T>, NormalEquations<T>)> {
    let count = kind.parameter_names().len();
    let camera_of =
        |parameters: &SVector<T, MAX_PARAMETERS>| Camera::from_parameters(kind, parameters.as_slice().get(..count)?);
    let mut camera = camera_of(&parameters)?;
    let mut equations = normal_equations(&camera, targets);
    let needed = targets.pixels / 2;
    if equations.compared < needed.max(1) {
        return None;
    }
    let ten = nalgebra::convert::<f64, T>(10.0);
    let stop = T::default_epsilon() * ten;
    let mut damping = nalgebra::convert::<f64, T>(1e-4);
    for _ in 0..MAX_STEPS {
        let trial = equations.step(damping).map(|step| parameters + step);
        let better = trial.and_then(|trial| {
            let camera = camera_of(&trial)?;
            let next = normal_equations(&camera, targets);
            (next.compared >= equations.compared && next.cost < equations.cost).then_some((trial, camera, next))
        });
        match better {
            Some((trial, next_camera, next)) => {
                let gain = equations.cost - next.cost;
                let finished = gain <= stop * equations.cost;
                (parameters, camera, equations) = (trial, next_camera, next);
                damping /= ten;
                if finished {
                    break;
                }
            }
            None if damping > ten * ten * ten => break,
            None => damping *= ten,
        }
    }
    Some((camera, equations))
}

/// Returns parameters of model `kind` with the principal point of `reference`, its focal lengths on the axis and these
/// first coefficients.
fn start<T: RealField + Copy>(
    kind: ModelKind,
    reference: &Camera<T>,
    coefficients: &[f64],
) -> Option<SVector<T, MAX_PARAMETERS>> {
    let mut parameters = SVector::<T, MAX_PARAMETERS>::zeros();
    for (slot, &coefficient) in parameters.iter_mut().skip(4).zip(coefficients) {
        *slot = nalgebra::convert(coefficient);
    }
    let [fx, fy] = reference.axial_focal_lengths()?;
    if let [focal_x, focal_y, center_x, center_y, ..] = parameters.as_mut_slice() {
        let &[_, _, cx, cy] = reference.parameters().first_chunk()?;
        (*focal_x, *focal_y, *center_x, *center_y) = (fx, fy, cx, cy);
    }
    let straight = Camera::from_parameters(kind, parameters.as_slice().get(..kind.parameter_names().len())?)?;
    let [too_long_x, too_long_y] = straight.axial_focal_lengths()?;
    if let [focal_x, focal_y, ..] = parameters.as_mut_slice() {
        *focal_x *= fx / too_long_x;
        *focal_y *= fy / too_long_y;
    }
    Some(parameters)
}

/// Returns pixels that span the sensor.
fn grid<T: RealField + Copy>(sensor: Sensor) -> impl Iterator<Item = Vector2<T>> {
    let coordinate = |index: u16, size: u16| {
        let part = f64::from(index) / f64::from(GRID - 1);
        nalgebra::convert::<f64, T>(part * f64::from(size.saturating_sub(1)))
    };
    (0..GRID).flat_map(move |row| {
        (0..GRID).map(move |column| Vector2::new(coordinate(column, sensor.width), coordinate(row, sensor.height)))
    })
}

/// Gauss-Newton equations of a fit; rows and columns of absent parameters are zero.
struct NormalEquations<T> {
    matrix: SMatrix<T, MAX_PARAMETERS, MAX_PARAMETERS>,
    right: SVector<T, MAX_PARAMETERS>,
    cost: T,
    compared: usize,
}

fn normal_equations<T: RealField + Copy>(camera: &Camera<T>, targets: &Targets<T>) -> NormalEquations<T> {
    let mut equations =
        NormalEquations { matrix: SMatrix::zeros(), right: SVector::zeros(), cost: T::zero(), compared: 0 };
    for (pixel, bearing) in targets.places.iter().flatten() {
        let Some(projection) = camera.project_with_jacobians(bearing) else { continue };
        let error = pixel - projection.pixel;
        equations.matrix += projection.by_parameters.transpose() * projection.by_parameters;
        equations.right += projection.by_parameters.transpose() * error;
        equations.cost += error.norm_squared();
        equations.compared += 1;
    }
    equations
}

impl<T: RealField + Copy> NormalEquations<T> {
    /// Returns the step for this damping, relative to columns of unit length.
    fn step(&self, damping: T) -> Option<SVector<T, MAX_PARAMETERS>> {
        let scale =
            self.matrix.diagonal().map(|value| if value > T::zero() { T::one() / value.sqrt() } else { T::zero() });
        let mut scaled = self.matrix.component_mul(&(scale * scale.transpose()));
        for index in 0..MAX_PARAMETERS {
            if let Some(value) = scaled.get_mut((index, index)) {
                *value = T::one() + damping;
            }
        }
        let step = scaled.cholesky()?.solve(&self.right.component_mul(&scale));
        Some(step.component_mul(&scale))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const SENSOR: Sensor = Sensor::new(346, 260);

    fn camera(kind: ModelKind, coefficients: &[f64]) -> Camera<f64> {
        let parameters: Vec<f64> = [345.0, 343.0, 171.3, 127.8].iter().chain(coefficients).copied().collect();
        Camera::from_parameters(kind, &parameters).unwrap()
    }

    #[test]
    fn a_camera_of_the_same_model_is_recovered() {
        for reference in [
            camera(ModelKind::Radtan4, &[-0.3, 0.1, 0.001, -0.0005]),
            camera(ModelKind::Radtan, &[-0.25, 0.1, 0.001, -0.0005, 0.05]),
            camera(ModelKind::KannalaBrandt, &[-0.02, 0.01, -0.05, 0.01]),
            camera(ModelKind::InverseRadial, &[0.3, 0.1, 0.1, 0.05, 0.02]),
            camera(ModelKind::Ucm, &[0.62]),
            camera(ModelKind::Eucm, &[0.58, 1.13]),
            camera(ModelKind::DoubleSphere, &[-0.2, 0.57]),
            camera(ModelKind::Fov, &[0.93]),
            camera(ModelKind::Omni, &[1.4, -0.2, 0.05, 0.001, -0.0005]),
        ] {
            let found = refit(reference.kind(), &reference, SENSOR).unwrap();
            let between = difference(&reference, &found, SENSOR);
            assert!(between.largest < 1e-9, "{between:?}");
            for (found, expected) in found.parameters().iter().zip(&reference.parameters()) {
                assert!((found - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{found} {expected}");
            }
        }
    }

    #[test]
    fn five_coefficients_are_refitted_to_four_better_than_truncated() {
        let reference = camera(ModelKind::Radtan, &[-0.25, 0.1, 0.001, -0.0005, -0.1]);
        let refitted = difference(&reference, &refit(ModelKind::Radtan4, &reference, SENSOR).unwrap(), SENSOR);
        let truncated = difference(&reference, &camera(ModelKind::Radtan4, &[-0.25, 0.1, 0.001, -0.0005]), SENSOR);
        assert!(refitted.root_mean_square < 0.1 * truncated.root_mean_square, "{refitted:?} {truncated:?}");
    }

    #[test]
    fn every_model_approximates_a_mild_lens() {
        let reference = camera(ModelKind::Radtan4, &[-0.2, 0.05, 0.0, 0.0]);
        for &kind in ModelKind::ALL {
            let found = refit(kind, &reference, SENSOR).unwrap();
            assert_eq!(found.kind(), kind);
            let between = difference(&reference, &found, SENSOR);
            // Models with one or two coefficients have little freedom in the shape of the distortion.
            let near = match kind {
                ModelKind::Ucm | ModelKind::Fov | ModelKind::DoubleSphere => 0.5,
                ModelKind::Eucm => 0.05,
                _ => 0.01,
            };
            assert!(between.outside == 0 && between.largest < near, "{kind}: {between:?}");
        }
    }

    /// A polynomial that folds back in the corners, which were not seen.
    #[test]
    fn unseen_corners_do_not_distort_the_fit() {
        let reference = camera(ModelKind::InverseRadial, &[0.3, 0.1, 0.1, 2.0, -6.0]);
        let seen = |pixel: &Vector2<f64>| (pixel - Vector2::new(171.3, 127.8)).norm() < 150.0;
        let inside = |camera: &Camera<f64>| difference_where(&reference, camera, SENSOR, seen);
        let everywhere = refit(ModelKind::Radtan, &reference, SENSOR).unwrap();
        let here = refit_where(ModelKind::Radtan, &reference, SENSOR, seen).unwrap();
        let (everywhere, here) = (inside(&everywhere), inside(&here));
        assert_eq!(here.compared, grid(SENSOR).filter(seen).count());
        assert!(here.root_mean_square < 0.3 * everywhere.root_mean_square, "{here:?} {everywhere:?}");
        assert!(refit_where(ModelKind::Radtan, &reference, SENSOR, |_| false).is_none());
    }

    #[test]
    fn a_fisheye_that_sees_behind_the_image_plane_has_no_pinhole_equivalent() {
        let parameters = [60.0, 60.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0];
        let fisheye: Camera<f64> = Camera::from_parameters(ModelKind::KannalaBrandt, &parameters).unwrap();
        assert_eq!(refit(ModelKind::Radtan4, &fisheye, SENSOR), None);
        assert!(refit(ModelKind::KannalaBrandt, &fisheye, SENSOR).is_some());
    }

    #[test]
    fn cameras_that_differ_by_their_centre_differ_by_as_many_pixels() {
        let reference = camera(ModelKind::Radtan4, &[0.0; 4]);
        let mut parameters = reference.parameters();
        parameters[2] += 3.0;
        parameters[3] -= 4.0;
        let moved = Camera::from_parameters(ModelKind::Radtan4, &parameters).unwrap();
        let between = difference(&reference, &moved, SENSOR);
        assert!((between.root_mean_square - 5.0).abs() < 1e-12 && (between.largest - 5.0).abs() < 1e-12);
        assert_eq!((between.compared, between.outside), (33 * 33, 0));
    }
}
