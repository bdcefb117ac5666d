//! Steps of the intrinsics that follow the bend of poorly determined directions.
//!
//! Observations depend on the intrinsics only through the bearings of pixels. If coefficients are strongly correlated, a curve in
//! the space of the intrinsics leads through cameras with almost the same bearings. A straight step along its tangent leaves the
//! curve, and the cost rises steeply although the linear model predicts a decrease. So the step is linear in the bearings instead:
//! the new intrinsics are those whose bearings come nearest to the bearings that the linear model predicts.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::{DMatrix, DVector, Vector2, Vector3};

use super::observation::SegmentObservations;

/// Columns and rows of the cells into which the sensor is divided.
const CELLS: [usize; 2] = [24, 18];
/// Largest number of Gauss-Newton steps to the nearest bearings.
const ROUNDS: usize = 8;
/// The steps end when the sum of squared differences falls by less than this share.
const SETTLED: f64 = 1e-3;
/// Weight of the straight step, relative to the information that the bearings contain about each parameter. It determines the
/// combinations of parameters that change the bearings by less than 1e-5 of what each parameter alone does.
const STRAIGHT: f64 = 1e-10;

/// A position on the image, with the number of observations around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedPixel {
    /// Mean of the observations (px).
    pub pixel: Vector2<f64>,
    /// Number of observations.
    pub count: f64,
}

/// Returns the mean and the number of the observations in each cell of the `sensor` that has any.
pub fn observed_pixels(segments: &[SegmentObservations], sensor: Sensor) -> Vec<ObservedPixel> {
    let [columns, rows] = CELLS;
    let mut cells = vec![(Vector2::zeros(), 0.0); columns * rows];
    let mut add = |x: f64, y: f64| {
        let place =
            |value: f64, size: u16, cells: usize| ((value * cells as f64 / f64::from(size)) as usize).min(cells - 1);
        let cell = place(y, sensor.height, rows) * columns + place(x, sensor.width, columns);
        if let Some((sum, count)) = cells.get_mut(cell) {
            *sum += Vector2::new(x, y);
            *count += 1.0;
        }
    };
    for segment in segments {
        segment.events.iter().for_each(|event| add(f64::from(event.x), f64::from(event.y)));
        segment.points.iter().for_each(|point| add(point.pixel[0], point.pixel[1]));
    }
    let observed = cells.into_iter().filter(|(_, count)| *count > 0.0);
    observed.map(|(sum, count)| ObservedPixel { pixel: sum / count, count }).collect()
}

/// Returns `camera` after a `step` that is linear in the bearings of the `observed` pixels. The first entries of `step` are those of
/// the camera's parameters; parameters without a step do not change. Returns `None` if the camera model rejects the parameters.
pub fn stepped(camera: &Camera<f64>, step: &[f64], observed: &[ObservedPixel]) -> Option<Camera<f64>> {
    let step = step.get(..camera.parameters().len())?;
    let straight = after(camera, step)?;
    let free: Vec<usize> = step.iter().enumerate().filter(|(_, step)| **step != 0.0).map(|(index, _)| index).collect();
    if free.is_empty() {
        return Some(straight);
    }
    let targets: Vec<Target> = observed.iter().filter_map(|observed| Target::new(camera, step, observed)).collect();
    let Some(mut best) = Fit::new(straight, &targets, &free) else { return Some(straight) };
    let scale = best.normal.diagonal().map(|entry| if entry > 0.0 { 1.0 / entry.sqrt() } else { 0.0 });
    // Change of the free parameters after the straight step, in scaled units.
    let mut change = DVector::zeros(free.len());
    for _ in 0..ROUNDS {
        let normal = DMatrix::from_fn(free.len(), free.len(), |row, column| {
            let straight = if row == column { STRAIGHT } else { 0.0 };
            best.normal[(row, column)] * scale[row] * scale[column] + straight
        });
        let right = best.right.component_mul(&scale) - &change * STRAIGHT;
        let Some(factor) = normal.cholesky() else { break };
        let next: DVector<f64> = &change + factor.solve(&right);
        let mut parameters = [0.0; MAX_PARAMETERS];
        free.iter().enumerate().for_each(|(place, &index)| parameters[index] = next[place] * scale[place]);
        let Some(fit) = after(&straight, &parameters).and_then(|camera| Fit::new(camera, &targets, &free)) else {
            break;
        };
        if fit.cost >= best.cost {
            break;
        }
        let is_settled = best.cost - fit.cost < SETTLED * best.cost;
        (best, change) = (fit, next);
        if is_settled {
            break;
        }
    }
    Some(best.camera)
}

/// Returns `camera` with its parameters moved by `step`; `None` if the model rejects them.
fn after(camera: &Camera<f64>, step: &[f64]) -> Option<Camera<f64>> {
    let mut parameters = camera.parameters();
    parameters.iter_mut().zip(step).for_each(|(parameter, step)| *parameter += step);
    Camera::from_parameters(camera.kind(), &parameters)
}

/// The bearing that a pixel should have after a step.
struct Target {
    pixel: Vector2<f64>,
    bearing: Vector3<f64>,
    weight: f64,
}

impl Target {
    /// Returns the bearing that the linear model predicts; `None` if the pixel has no bearing.
    fn new(camera: &Camera<f64>, step: &[f64], observed: &ObservedPixel) -> Option<Self> {
        let seen = camera.unproject_with_jacobians(&observed.pixel)?;
        let turn = step.iter().zip(seen.by_parameters.column_iter()).map(|(step, column)| column * *step);
        let bearing = turn.fold(seen.bearing, |sum, part| sum + part).normalize();
        Some(Self { pixel: observed.pixel, bearing, weight: observed.count })
    }
}

/// A camera with the equations of its distance from the targets.
struct Fit {
    camera: Camera<f64>,
    /// Half the weighted sum of the squared differences of bearings.
    cost: f64,
    normal: DMatrix<f64>,
    right: DVector<f64>,
}

impl Fit {
    /// Compares `camera` with `targets`; `free` are the parameters that may change. Returns `None` if a target lies outside the
    /// domain of the model.
    fn new(camera: Camera<f64>, targets: &[Target], free: &[usize]) -> Option<Self> {
        let (mut normal, mut right) = (DMatrix::zeros(free.len(), free.len()), DVector::zeros(free.len()));
        let mut cost = 0.0;
        for target in targets {
            let seen = camera.unproject_with_jacobians(&target.pixel)?;
            let difference = target.bearing - seen.bearing;
            cost += 0.5 * target.weight * difference.norm_squared();
            let by_free = seen.by_parameters.select_columns(free);
            right += by_free.tr_mul(&difference) * target.weight;
            normal += by_free.tr_mul(&by_free) * target.weight;
        }
        cost.is_finite().then_some(Self { camera, cost, normal, right })
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;
    use crate::solve::observation::EventObservation;

    const SENSOR: Sensor = Sensor::new(346, 260);

    /// A lens whose focal lengths, ξ and k1 are strongly correlated.
    fn omni() -> Camera<f64> {
        let parameters = [432.1, 431.2, 171.9, 130.3, 1.2, -0.12, 0.05, 0.0006, -0.0004];
        Camera::from_parameters(ModelKind::Omni, &parameters).unwrap()
    }

    /// One observation in each of 12 × 9 positions.
    fn everywhere() -> Vec<ObservedPixel> {
        let pixel = |x: u16, y: u16| Vector2::new(14.0 + 29.0 * f64::from(x), 14.0 + 29.0 * f64::from(y));
        (0..9).flat_map(|y| (0..12).map(move |x| ObservedPixel { pixel: pixel(x, y), count: 1.0 })).collect()
    }

    /// The step of all parameters that changes the bearings least, with this step of ξ.
    fn least_visible(camera: &Camera<f64>, observed: &[ObservedPixel], xi: f64) -> [f64; MAX_PARAMETERS] {
        const XI: usize = 4;
        let others: Vec<usize> = (0..9).filter(|&index| index != XI).collect();
        let mut step = [0.0; MAX_PARAMETERS];
        step[XI] = xi;
        let targets: Vec<Target> =
            observed.iter().map(|observed| Target::new(camera, &step, observed).unwrap()).collect();
        let Fit { normal, right, .. } = Fit::new(*camera, &targets, &others).unwrap();
        let back = normal.cholesky().unwrap().solve(&right);
        others.iter().zip(back.iter()).for_each(|(&index, value)| step[index] = -value);
        step
    }

    /// Root mean square distance of the bearings from the ones that the linear model predicts, as pixels of 200 px focal length.
    fn distance(camera: &Camera<f64>, step: &[f64; MAX_PARAMETERS], reached: Camera<f64>) -> f64 {
        let targets: Vec<Target> = everywhere().iter().map(|one| Target::new(camera, step, one).unwrap()).collect();
        200.0 * (2.0 * Fit::new(reached, &targets, &[]).unwrap().cost / targets.len() as f64).sqrt()
    }

    #[test]
    fn a_step_along_correlated_parameters_follows_their_bend() {
        let (camera, observed) = (omni(), everywhere());
        let step = least_visible(&camera, &observed, 0.4);
        let straight = distance(&camera, &step, after(&camera, &step).unwrap());
        let reached = stepped(&camera, &step, &observed).unwrap();
        let bent = distance(&camera, &step, reached);
        assert!(straight > 0.1 && bent < 0.02 * straight, "{straight} {bent}");
        // It still goes along the curve.
        assert!((reached.parameters()[4] - 1.6).abs() < 0.1, "{reached:?}");
    }

    #[test]
    fn parameters_without_a_step_do_not_change() {
        let camera = omni();
        let mut step = [0.0; MAX_PARAMETERS];
        (step[0], step[1], step[4]) = (30.0, 30.0, 0.2);
        let reached = stepped(&camera, &step, &everywhere()).unwrap().parameters();
        let before = camera.parameters();
        for index in [2, 3, 5, 6, 7, 8] {
            assert_eq!(reached[index], before[index]);
        }
    }

    #[test]
    fn without_observations_the_step_is_straight() {
        let camera = omni();
        let step = least_visible(&camera, &everywhere(), 0.1);
        assert_eq!(stepped(&camera, &step, &[]), after(&camera, &step));
        step.iter()
            .zip(stepped(&camera, &step, &[]).unwrap().parameters())
            .zip(camera.parameters())
            .for_each(|((step, reached), before)| assert_eq!(reached, before + step));
    }

    #[test]
    fn observations_are_counted_in_cells() {
        let event = |x, y| EventObservation { dt: 0.0, x, y, edge: 0, class: 0, speed_range: 0 };
        let events = vec![event(0, 0), event(10, 4), event(345, 259)];
        let segment = SegmentObservations { events, ..SegmentObservations::default() };
        let observed = observed_pixels(&[segment], SENSOR);
        let near = ObservedPixel { pixel: Vector2::new(5.0, 2.0), count: 2.0 };
        assert_eq!(observed, [near, ObservedPixel { pixel: Vector2::new(345.0, 259.0), count: 1.0 }]);
    }
}
