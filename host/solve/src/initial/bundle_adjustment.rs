//! Bundle adjustment: camera and poses of views together, by least squares on the distances between observed and predicted image
//! points.
//!
//! Levenberg-Marquardt with Huber's loss, and a weak prior on the distortion: coefficients of one model can be indistinguishable
//! on a sensor's field of view (`radtan8`, `inverse-radial`), and without the prior they diverge together until the model folds
//! over. The normal equations have an arrow shape ([`arrow`](evcal_geometry::numerics::arrow)): a pose for each view, and a
//! border of camera parameters. Views are linearised in parallel and summed in their order, so the result does not depend on the
//! number of threads.

use evcal_core::camera::{Camera, MAX_PARAMETERS, ProjectionParameterJacobian};
use nalgebra::{Isometry3, SMatrix, SVector, Vector2};
use rayon::prelude::*;

use evcal_geometry::lens::distortion_prior::{DistortionPrior, PriorEquations};
use evcal_geometry::numerics::arrow::{Eliminated, PoseEquations, unit_diagonal};
use evcal_geometry::numerics::huber::{huber_cost, huber_weight};
use evcal_geometry::numerics::levenberg_marquardt::{Costed, Schedule, minimise};
use evcal_geometry::numerics::rigid::step_pose;

/// Parameter block of the camera; unused rows and columns are fixed.
pub type Border = SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>;
/// One number for each parameter of the camera, such as a gradient or a step; unused entries are 0.
pub type BorderVector = SVector<f64, MAX_PARAMETERS>;
/// Normal equations of one view.
pub type Equations = PoseEquations<MAX_PARAMETERS>;

/// Schedule of the optimiser.
const SCHEDULE: Schedule = Schedule {
    first_damping: 1e-3,
    smallest_damping: 1e-10,
    largest_damping: 1e8,
    most_steps: 300,
    smallest_gain: 1e-10,
};

/// A reprojection error and its derivatives.
pub struct ReprojectionResidual {
    /// Projected minus observed image point, in pixels.
    pub error: Vector2<f64>,
    /// Derivative by the step of [`step_pose`].
    pub by_pose: SMatrix<f64, 2, 6>,
    /// Derivative by the camera's parameters.
    pub by_parameters: ProjectionParameterJacobian<f64>,
}

/// A feature that is observed at a point of the image; `pose` is `T_camera_world`.
pub trait ImagePoint: Sync {
    /// Returns the distance in pixels from the predicted point; infinite outside the camera's domain.
    fn distance(&self, camera: &Camera<f64>, pose: &Isometry3<f64>) -> f64;

    /// Returns the residual; `None` outside the camera's domain.
    fn residual(&self, camera: &Camera<f64>, pose: &Isometry3<f64>) -> Option<ReprojectionResidual>;
}

/// Points of one view and its pose.
#[derive(Clone, Debug)]
pub struct View<'a, P> {
    /// Its observed points.
    pub points: &'a [P],
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
    /// Standard deviation of its points relative to those of other views.
    pub noise: f64,
}

/// The estimated quantities: camera and `T_camera_world` of each view.
#[derive(Clone)]
pub struct Estimate {
    /// The camera of all views.
    pub camera: Camera<f64>,
    /// `T_camera_world` of each view, in the order of [`Target::views`].
    pub poses: Vec<Isometry3<f64>>,
}

/// The constant input of a refinement.
pub struct Target<'a, P> {
    /// The views with their observed points.
    pub views: &'a [View<'a, P>],
    /// Flags of the estimated camera parameters.
    pub free: &'a [bool],
    /// Prior on the coefficients of the distortion.
    pub prior: DistortionPrior,
    /// Huber's bound in pixels, for a view whose relative noise is 1.
    pub huber: f64,
}

/// The damped border with the poses eliminated, its right side, and the eliminated blocks.
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
        // A parameter that is fixed, or that has no effect, keeps its value.
        *diagonal = if *diagonal > 0.0 { *diagonal * (1.0 + damping) } else { 1.0 };
    }
    let eliminated: Vec<_> = views.iter().map(|view| view.eliminate(damping)).collect::<Option<_>>()?;
    for view in &eliminated {
        border -= view.border;
        gradient -= view.gradient;
    }
    Some(Reduced { border, gradient, eliminated })
}

impl<P: ImagePoint> Target<'_, P> {
    /// Returns `true` if the camera parameter of this index is estimated.
    pub fn is_free(&self, parameter: usize) -> bool {
        self.free.get(parameter).copied().unwrap_or(false)
    }

    /// Returns the cost: the sum of Huber's loss over all points, in squared pixels over the relative noise of their view, and the cost of the prior. It is infinite if a
    /// point is outside the camera's domain.
    pub fn cost(&self, estimate: &Estimate) -> f64 {
        let camera = &estimate.camera;
        let of_view = |(view, pose): (&View<'_, P>, &Isometry3<f64>)| -> f64 {
            let squared = |point: &P| (point.distance(camera, pose) / view.noise).powi(2);
            view.points.iter().map(|point| huber_cost(squared(point), self.huber)).sum()
        };
        let costs: Vec<f64> = self.views.par_iter().zip(&estimate.poses).map(of_view).collect();
        costs.iter().sum::<f64>() + self.prior.cost(camera)
    }

    fn equations(&self, camera: &Camera<f64>, pose: &Isometry3<f64>, view: &View<'_, P>) -> Equations {
        let mut sum = Equations::new();
        for mut residual in view.points.iter().filter_map(|point| point.residual(camera, pose)) {
            residual.error /= view.noise;
            residual.by_pose /= view.noise;
            residual.by_parameters /= view.noise;
            for index in (0..MAX_PARAMETERS).filter(|&index| !self.is_free(index)) {
                residual.by_parameters.column_mut(index).fill(0.0);
            }
            let weight = huber_weight(residual.error.norm_squared(), self.huber);
            sum.add(residual.error, &residual.by_parameters, &residual.by_pose, weight);
        }
        sum
    }

    /// Computes the normal equations of each view.
    pub fn linearise(&self, estimate: &Estimate) -> Vec<Equations> {
        let views = self.views.par_iter().zip(&estimate.poses);
        views.map(|(view, pose)| self.equations(&estimate.camera, pose, view)).collect()
    }

    /// Returns the information about the camera after elimination of the poses; `None` if one of them is not determined.
    pub fn border(&self, camera: &Camera<f64>, linear: &[Equations]) -> Option<Border> {
        Some(reduce(linear, &self.prior.equations(camera, self.free), 0.0)?.border)
    }

    /// Returns `estimate` after one damped step; `None` if the equations have no solution or the model rejects the parameters.
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

    /// Refines `best`, and returns the number of steps.
    pub fn refine(&self, best: &mut Costed<Estimate>) -> usize {
        minimise(
            best,
            &SCHEDULE,
            |estimate| self.linearise(estimate),
            |estimate, linear, damping| self.step(estimate, linear, damping),
        )
    }
}
