//! Bundle refinement: camera and view poses together, by least squares on the reprojection.
//!
//! Levenberg-Marquardt with Huber's loss, and a weak prior on the distortion: coefficients of one model
//! can be impossible to tell apart on a sensor's field of view (`radtan8`, `inverse-radial`), and
//! without it they run away together to where the model folds over. The normal equations have an arrow
//! shape ([`arrow`](evcal_geometry::numerics::arrow)): a pose for each view, and a border of camera parameters. Views are linearised in parallel and summed in their order, so the result does not depend
//! on the number of threads.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, SMatrix, SVector};
use rayon::prelude::*;

use super::pose::{distance, residual};
use super::sighting::BoardPoint;
use evcal_geometry::lens::axial_focal::axial_focal_gradients;
use evcal_geometry::lens::distortion_prior::{DistortionPrior, PriorEquations, distortion_prior};
use evcal_geometry::numerics::arrow::{Eliminated, PoseEquations, unit_diagonal};
use evcal_geometry::numerics::huber::{huber_cost, huber_weight};
use evcal_geometry::numerics::levenberg_marquardt::{Costed, Schedule, minimise};
use evcal_geometry::numerics::rigid::step_pose;

/// Parameter block of the camera; unused rows and columns are held.
type Border = SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>;
type BorderVector = SVector<f64, MAX_PARAMETERS>;
/// Normal equations of one view.
type Equations = PoseEquations<MAX_PARAMETERS>;

/// How a refinement goes.
const SCHEDULE: Schedule = Schedule {
    first_damping: 1e-3,
    smallest_damping: 1e-10,
    largest_damping: 1e8,
    most_steps: 300,
    smallest_gain: 1e-10,
};

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
    /// Root mean square of the distances, each weighted as by Huber's loss, in pixels; tells which of two
    /// starts is the better one.
    pub rms: f64,
    /// Steps taken.
    pub steps: usize,
}

/// The damped border with the poses eliminated, its right side, and what was eliminated.
struct Reduced {
    border: Border,
    gradient: BorderVector,
    eliminated: Vec<Eliminated<MAX_PARAMETERS>>,
}

/// Eliminates the views' poses; `None` if one of them is not determined.
fn reduce(views: &[Equations], prior: &PriorEquations, damping: f64) -> Option<Reduced> {
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
    let eliminated: Vec<_> = views.iter().map(|view| view.eliminate(damping)).collect::<Option<_>>()?;
    for view in &eliminated {
        border -= view.border;
        gradient -= view.gradient;
    }
    Some(Reduced { border, gradient, eliminated })
}

/// What is refined: camera and `T_camera_world` of each view.
#[derive(Clone)]
struct Estimate {
    camera: Camera<f64>,
    poses: Vec<Isometry3<f64>>,
}

/// What stays the same while it is refined.
struct Target<'a> {
    views: &'a [BundleView<'a>],
    /// Which camera parameters move.
    free: &'a [bool],
    prior: DistortionPrior,
    /// Huber's bound in pixels.
    huber: f64,
}

impl Target<'_> {
    fn is_free(&self, parameter: usize) -> bool {
        self.free.get(parameter).copied().unwrap_or(false)
    }

    fn cost(&self, estimate: &Estimate) -> f64 {
        let camera = &estimate.camera;
        let of_view = |(view, pose): (&BundleView<'_>, &Isometry3<f64>)| -> f64 {
            let squared = |point: &BoardPoint| distance(camera, pose, point).powi(2);
            view.points.iter().map(|point| huber_cost(squared(point), self.huber)).sum()
        };
        let costs: Vec<f64> = self.views.par_iter().zip(&estimate.poses).map(of_view).collect();
        costs.iter().sum::<f64>() + self.prior.cost(camera)
    }

    fn equations(&self, camera: &Camera<f64>, pose: &Isometry3<f64>, points: &[BoardPoint]) -> Equations {
        let mut sum = Equations::new();
        for mut residual in points.iter().filter_map(|point| residual(camera, pose, point)) {
            for index in (0..MAX_PARAMETERS).filter(|&index| !self.is_free(index)) {
                residual.by_parameters.column_mut(index).fill(0.0);
            }
            let weight = huber_weight(residual.error.norm_squared(), self.huber);
            sum.add(residual.error, &residual.by_parameters, &residual.by_pose, weight);
        }
        sum
    }

    fn linearise(&self, estimate: &Estimate) -> Vec<Equations> {
        let views = self.views.par_iter().zip(&estimate.poses);
        views.map(|(view, pose)| self.equations(&estimate.camera, pose, view.points)).collect()
    }

    /// `estimate` after one damped step; `None` where the equations have no solution or the model
    /// refuses the parameters.
    fn step(&self, estimate: &Estimate, linear: &[Equations], damping: f64) -> Option<Costed<Estimate>> {
        let camera = &estimate.camera;
        let Reduced { border, gradient, eliminated } =
            reduce(linear, &self.prior.equations(camera, self.free), damping)?;
        let (border, scale) = unit_diagonal(&border);
        let step = -border.cholesky()?.solve(&gradient.component_mul(&scale)).component_mul(&scale);
        let parameters: Vec<f64> =
            camera.parameters().iter().zip(step.iter()).map(|(value, step)| value + step).collect();
        let camera = Camera::from_parameters(camera.kind(), &parameters)?;
        let moved = estimate.poses.iter().zip(linear.iter().zip(&eliminated));
        let poses = moved
            .map(|(pose, (equations, eliminated))| step_pose(pose, &equations.pose_step(eliminated, &step)))
            .collect();
        let estimate = Estimate { camera, poses };
        let cost = self.cost(&estimate);
        Some(Costed { estimate, cost })
    }
}

/// Refines the `free` parameters of `camera` and the poses of `views`.
///
/// `None` if a point starts outside the camera's domain, a view has too few points for a pose, or
/// there are fewer observations than unknowns.
///
/// `sensor` is (width, height) in pixels; `huber` in pixels.
pub fn bundle(
    camera: &Camera<f64>,
    views: &[BundleView<'_>],
    free: &[bool],
    sensor: Sensor,
    huber: f64,
) -> Option<Bundle> {
    let point_count: usize = views.iter().map(|view| view.points.len()).sum();
    let freedom = (2 * point_count).checked_sub(6 * views.len() + free.iter().filter(|free| **free).count())?;
    let target = Target { views, free, prior: distortion_prior(camera, sensor), huber };
    let start = Estimate { camera: *camera, poses: views.iter().map(|view| view.pose).collect() };
    let mut best = Costed { cost: target.cost(&start), estimate: start };
    if !best.cost.is_finite() || freedom == 0 {
        return None;
    }
    let steps = minimise(
        &mut best,
        &SCHEDULE,
        |estimate| target.linearise(estimate),
        |estimate, linear, damping| target.step(estimate, linear, damping),
    );
    let Estimate { camera, poses } = &best.estimate;
    let linear = target.linearise(&best.estimate);
    let squares: f64 = linear.iter().map(|view| view.squares).sum();
    let border = reduce(&linear, &target.prior.equations(camera, free), 0.0)?.border;
    let deviation = deviation_of(&border, squares / freedom as f64, &target);
    let unit = |index: usize| std::array::from_fn(|other| if other == index { 1.0 } else { 0.0 });
    Some(Bundle {
        camera: *camera,
        poses: poses.clone(),
        sigma: (0..camera.parameters().len()).map(|index| deviation(&unit(index))).collect(),
        axial_focal_sigma: axial_focal_gradients(camera)?.map(|gradient| deviation(&gradient)),
        rms: (squares / point_count as f64).sqrt(),
        steps,
    })
}

/// Standard deviation of a linear function of the camera's parameters with a given gradient, from the
/// undamped `border` and the `variance` of a residual.
fn deviation_of(border: &Border, variance: f64, target: &Target<'_>) -> impl Fn(&[f64; MAX_PARAMETERS]) -> f64 {
    let (border, scale) = unit_diagonal(border);
    let eigen = border.symmetric_eigen();
    // Directions that the data does not see have an eigenvalue of rounding size: their standard
    // deviation is large, not infinite or NaN.
    let smallest = f64::EPSILON * eigen.eigenvalues.max();
    let inverse = eigen.eigenvalues.map(|value| 1.0 / value.max(smallest));
    move |gradient| {
        let mut scaled = BorderVector::from(*gradient).component_mul(&scale);
        for (value, _) in scaled.iter_mut().zip(0..).filter(|(_, index)| !target.is_free(*index)) {
            *value = 0.0;
        }
        let along = eigen.eigenvectors.tr_mul(&scaled);
        let sum: f64 = along.iter().zip(inverse.iter()).map(|(along, inverse)| along * along * inverse).sum();
        (variance * sum).sqrt()
    }
}
