//! Bundle refinement: camera and view poses together, by least squares on the reprojection.
//!
//! Levenberg-Marquardt with Huber's loss, and a weak prior on the distortion: coefficients of one model
//! can be impossible to tell apart on a sensor's field of view (`radtan8`, `inverse-radial`), and
//! without it they run away together to where the model folds over. The normal equations have an arrow shape, one 6 × 6 block
//! per view and a border of camera parameters, and are solved by the Schur complement onto the
//! border. Views are linearised in parallel and summed in their order, so the result does not depend
//! on the number of threads.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::{Cholesky, Isometry3, Matrix6, SMatrix, SVector, U6, Vector6};
use rayon::prelude::*;

use super::pose::{distance, residual};
use super::sighting::BoardPoint;
use crate::lens::axial_focal::axial_focal_gradients;
use crate::lens::distortion_prior::{PriorEquations, distortion_prior};
use crate::numerics::huber::huber_cost;
use crate::numerics::huber::huber_weight;
use crate::numerics::rigid::step_pose;

/// Parameter block of the camera; unused rows and columns are held.
type Border = SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>;
type BorderVector = SVector<f64, MAX_PARAMETERS>;

/// Steps that a refinement may take.
const MAX_STEPS: usize = 300;

/// A step that lowers the cost by less than this part of it is the last one.
const SMALLEST_GAIN: f64 = 1e-10;

/// Points of one view and its pose.
#[derive(Clone, Debug)]
pub struct BundleView<'a> {
    /// The circles.
    pub points: &'a [BoardPoint],
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
}

/// A refined camera.
#[derive(Clone, Debug)]
pub struct Bundle {
    /// The camera.
    pub camera: Camera<f64>,
    /// `T_camera_world` of each view.
    pub poses: Vec<Isometry3<f64>>,
    /// Standard deviation of each camera parameter, from the residuals; zero for those held.
    pub sigma: Vec<f64>,
    /// Standard deviations of the focal lengths on the optical axis, in pixels.
    ///
    /// Those of fx and fy can be much larger in models in which a coefficient scales the image, too.
    pub axial_focal_sigma: [f64; 2],
    /// Root mean square of the distances, each weighted as by Huber's loss, in pixels.
    pub rms: f64,
    /// Steps taken.
    pub steps: usize,
}

/// Normal equations of one view, or the sum of many where the view's own block is left out.
struct ViewEquations {
    border: Border,
    border_gradient: BorderVector,
    mixed: SMatrix<f64, MAX_PARAMETERS, 6>,
    block: Matrix6<f64>,
    block_gradient: Vector6<f64>,
    weighted_squares: f64,
}

fn equations(camera: &Camera<f64>, view: &BundleView<'_>, free: &[bool], huber: f64) -> ViewEquations {
    let mut sum = ViewEquations {
        border: Border::zeros(),
        border_gradient: BorderVector::zeros(),
        mixed: SMatrix::zeros(),
        block: Matrix6::zeros(),
        block_gradient: Vector6::zeros(),
        weighted_squares: 0.0,
    };
    for mut residual in view.points.iter().filter_map(|point| residual(camera, &view.pose, point)) {
        let held = |index: &usize| !free.get(*index).copied().unwrap_or(false);
        for index in (0..MAX_PARAMETERS).filter(held) {
            residual.by_parameters.column_mut(index).fill(0.0);
        }
        let squared = residual.error.norm_squared();
        let weight = huber_weight(squared, huber);
        let by_camera = residual.by_parameters.transpose() * weight;
        let by_pose = residual.by_pose.transpose() * weight;
        sum.border += by_camera * residual.by_parameters;
        sum.border_gradient += by_camera * residual.error;
        sum.mixed += by_camera * residual.by_pose;
        sum.block += by_pose * residual.by_pose;
        sum.block_gradient += by_pose * residual.error;
        sum.weighted_squares += weight * squared;
    }
    sum
}

/// Schur complement onto the border and its right side.
struct Reduced {
    border: Border,
    gradient: BorderVector,
    /// The views' damped blocks, factored, for the steps of the poses.
    factors: Vec<Cholesky<f64, U6>>,
}

/// Eliminates the views' poses; `None` if one of them is not determined.
fn reduce(views: &[ViewEquations], prior: &PriorEquations, damping: f64) -> Option<Reduced> {
    let mut border = Border::zeros();
    let mut gradient = BorderVector::zeros();
    for view in views {
        border += view.border;
        gradient += view.border_gradient;
    }
    border.set_diagonal(&(border.diagonal() + prior.weights));
    gradient += prior.gradient;
    for index in 0..MAX_PARAMETERS {
        let diagonal = &mut border[(index, index)];
        // A parameter that is held, or that nothing depends on, keeps its value.
        *diagonal = if *diagonal > 0.0 { *diagonal * (1.0 + damping) } else { 1.0 };
    }
    let mut factors = Vec::with_capacity(views.len());
    for view in views {
        let mut block = view.block;
        for index in 0..6 {
            block[(index, index)] *= 1.0 + damping;
        }
        let factor = block.cholesky()?;
        border -= view.mixed * factor.solve(&view.mixed.transpose());
        gradient -= view.mixed * factor.solve(&view.block_gradient);
        factors.push(factor);
    }
    Some(Reduced { border, gradient, factors })
}

/// `matrix` scaled to a unit diagonal, and the scale of its rows and columns.
fn scaled(matrix: &Border) -> (Border, BorderVector) {
    let scale = matrix.diagonal().map(|value| if value > 0.0 { 1.0 / value.sqrt() } else { 1.0 });
    (Border::from_fn(|row, column| matrix[(row, column)] * scale[row] * scale[column]), scale)
}

fn total_cost(camera: &Camera<f64>, views: &[BundleView<'_>], huber: f64) -> f64 {
    let costs: Vec<f64> = views
        .par_iter()
        .map(|view| {
            view.points.iter().map(|point| huber_cost(distance(camera, &view.pose, point).powi(2), huber)).sum()
        })
        .collect();
    costs.iter().sum()
}

/// Refines the `free` parameters of `camera` and the poses of `views`.
///
/// `None` if a point starts outside the camera's domain, a view has too few points for a pose, or
/// there are fewer observations than unknowns.
///
/// `sensor` is (width, height) in pixels; `huber` in pixels.
pub fn bundle(
    camera: &Camera<f64>,
    views: Vec<BundleView<'_>>,
    free: &[bool],
    sensor: Sensor,
    huber: f64,
) -> Option<Bundle> {
    let mut camera = *camera;
    let mut views = views;
    let kind = camera.kind();
    let point_count: usize = views.iter().map(|view| view.points.len()).sum();
    let freedom = (2 * point_count).checked_sub(6 * views.len() + free.iter().filter(|free| **free).count())?;
    let prior = distortion_prior(&camera, sensor);
    let mut best = total_cost(&camera, &views, huber) + prior.cost(&camera);
    if !best.is_finite() || freedom == 0 {
        return None;
    }
    let linearise = |camera: &Camera<f64>, views: &[BundleView<'_>]| -> Vec<ViewEquations> {
        views.par_iter().map(|view| equations(camera, view, free, huber)).collect()
    };
    let mut damping = 1e-3;
    let mut steps = 0;
    let mut linear = linearise(&camera, &views);
    while steps < MAX_STEPS {
        let mut gain = None;
        while damping < 1e8 {
            let trial = reduce(&linear, &prior.equations(&camera, free), damping).and_then(
                |Reduced { border, gradient, factors }| {
                    let (border, scale) = scaled(&border);
                    let step = -border.cholesky()?.solve(&gradient.component_mul(&scale)).component_mul(&scale);
                    let parameters: Vec<f64> =
                        camera.parameters().iter().zip(step.iter()).map(|(value, step)| value + step).collect();
                    let camera = Camera::from_parameters(kind, &parameters)?;
                    let views: Vec<BundleView<'_>> = views
                        .iter()
                        .zip(&linear)
                        .zip(&factors)
                        .map(|((view, equations), factor)| {
                            let right = equations.block_gradient + equations.mixed.transpose() * step;
                            BundleView { points: view.points, pose: step_pose(&view.pose, &-factor.solve(&right)) }
                        })
                        .collect();
                    let cost = total_cost(&camera, &views, huber) + prior.cost(&camera);
                    (cost < best).then_some((camera, views, cost))
                },
            );
            if let Some((better_camera, better_views, cost)) = trial {
                gain = Some((best - cost) / best);
                (camera, views, best) = (better_camera, better_views, cost);
                damping = (damping * 0.1).max(1e-10);
                break;
            }
            damping *= 10.0;
        }
        let Some(gain) = gain else { break };
        steps += 1;
        linear = linearise(&camera, &views);
        if gain < SMALLEST_GAIN {
            break;
        }
    }
    let squares: f64 = linear.iter().map(|view| view.weighted_squares).sum();
    let schur = reduce(&linear, &prior.equations(&camera, free), 0.0)?.border;
    let (schur, scale) = scaled(&schur);
    let eigen = schur.symmetric_eigen();
    // Directions that the data does not see have an eigenvalue of rounding size: their standard
    // deviation is large, not infinite or NaN.
    let smallest = f64::EPSILON * eigen.eigenvalues.max();
    let inverse = eigen.eigenvalues.map(|value| 1.0 / value.max(smallest));
    let variance = squares / freedom as f64;
    // Standard deviation of a linear function of the parameters with this gradient.
    let deviation = |gradient: &[f64; MAX_PARAMETERS]| -> f64 {
        let mut scaled = BorderVector::from(*gradient).component_mul(&scale);
        for (value, index) in scaled.iter_mut().zip(0..) {
            if !free.get(index).copied().unwrap_or(false) {
                *value = 0.0;
            }
        }
        let along = eigen.eigenvectors.tr_mul(&scaled);
        let sum: f64 = along.iter().zip(inverse.iter()).map(|(along, inverse)| along * along * inverse).sum();
        (variance * sum).sqrt()
    };
    let sigma = (0..camera.parameters().len())
        .map(|index| deviation(&std::array::from_fn(|other| if other == index { 1.0 } else { 0.0 })))
        .collect();
    let axial_focal_sigma = axial_focal_gradients(&camera)?.map(|gradient| deviation(&gradient));
    Some(Bundle {
        camera,
        poses: views.iter().map(|view| view.pose).collect(),
        sigma,
        axial_focal_sigma,
        rms: (squares / point_count as f64).sqrt(),
        steps,
    })
}
