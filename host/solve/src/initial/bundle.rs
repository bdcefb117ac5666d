//! Bundle refinement: camera and view poses together, by least squares on the reprojection of circle centres
//! ([`bundle_adjustment`](super::bundle_adjustment)), and the uncertainty of the camera.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;

use super::bundle_adjustment::{Border, BorderVector, Estimate, Target, View};
use super::sighting::BoardPoint;
use evcal_geometry::lens::axial_focal::axial_focal_gradients;
use evcal_geometry::lens::distortion_prior::distortion_prior;
use evcal_geometry::numerics::arrow::unit_diagonal;
use evcal_geometry::numerics::levenberg_marquardt::Costed;

/// Circles of one view and its pose.
pub type BundleView<'a> = View<'a, BoardPoint>;

/// A refined camera.
#[derive(Clone, Debug)]
pub struct Bundle {
    /// The camera.
    pub camera: Camera<f64>,
    /// `T_camera_world` of each view.
    pub poses: Vec<Isometry3<f64>>,
    /// Standard deviation of each camera parameter, from the residuals; zero for fixed ones.
    pub sigma: Vec<f64>,
    /// Standard deviations of the focal lengths on the optical axis, in pixels.
    ///
    /// The standard deviations of fx and fy can be much larger in models in which a coefficient scales the image, too.
    pub axial_focal_sigma: [f64; 2],
    /// Root mean square of the distances, each weighted as by Huber's loss, in pixels; used to compare two starts.
    pub rms: f64,
    /// Number of steps.
    pub steps: usize,
}

/// Refines the `free` parameters of `camera` and the poses of `views`.
///
/// Returns `None` if a point starts outside the camera's domain, a view has too few points for a pose, or there are fewer
/// observations than unknowns.
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
    let steps = target.refine(&mut best);
    let Estimate { camera, poses } = &best.estimate;
    let linear = target.linearise(&best.estimate);
    let squares: f64 = linear.iter().map(|view| view.squares).sum();
    let border = target.border(camera, &linear)?;
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

/// Returns the standard deviation of a linear function of the camera's parameters with a given gradient, from the undamped
/// `border` and the `variance` of a residual.
fn deviation_of(
    border: &Border,
    variance: f64,
    target: &Target<'_, BoardPoint>,
) -> impl Fn(&[f64; MAX_PARAMETERS]) -> f64 {
    let (border, scale) = unit_diagonal(border);
    let eigen = border.symmetric_eigen();
    // Directions that the data do not determine have an eigenvalue of the size of rounding errors: their standard deviation is
    // large, not infinite or NaN.
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
