//! First estimate of the camera without OpenCV.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;
use rayon::prelude::*;

use super::bundle::{Bundle, BundleView, bundle};
use super::pose::homography_pose;
use super::settings::{HUBER, InitialSettings};
use super::sighting::BoardPoint;

/// Returns the parameters that are estimated in each pass of the native start: first the focal lengths and the first
/// distortion coefficient, then also the principal point and the second coefficient, then everything.
fn passes(parameters: usize) -> [Vec<bool>; 3] {
    let first = |free: &[usize]| (0..parameters).map(|index| free.contains(&index)).collect();
    [first(&[0, 1, 4]), first(&[0, 1, 2, 3, 4, 5]), vec![true; parameters]]
}

/// Largest contribution of a bad view to the root mean square error when focal lengths are compared, in px.
const VIEW_ERROR_CAP: f64 = 20.0;

/// Number of views on which focal lengths are compared.
const SCAN_VIEWS: usize = 16;

/// Computes a camera of model `kind` without OpenCV: a scan over focal lengths, with the principal point in the middle of the
/// sensor, with and without the barrel distortion of ordinary lenses; then bundle refinement with more and more estimated
/// parameters.
pub fn native_start(
    kind: ModelKind,
    views: &[&[BoardPoint]],
    sensor: Sensor,
    settings: &InitialSettings,
) -> Option<Bundle> {
    let size = Vector2::new(f64::from(sensor.width), f64::from(sensor.height));
    let center = (size - Vector2::new(1.0, 1.0)) / 2.0;
    let count = kind.parameter_names().len();
    let scan: Vec<Camera<f64>> = (0..32)
        .flat_map(|step| {
            let focal = 0.2 * size.norm() * 1.12_f64.powi(step);
            kind.expectation().usual.map(|coefficients| {
                let mut parameters = vec![focal, focal, center.x, center.y];
                parameters.extend_from_slice(coefficients);
                parameters.resize(count, 0.0);
                let [too_long, _] = Camera::from_parameters(kind, &parameters)?.axial_focal_lengths()?;
                parameters.iter_mut().take(2).for_each(|length| *length *= focal / too_long);
                Camera::from_parameters(kind, &parameters)
            })
        })
        .flatten()
        .collect();
    let score = |camera: &Camera<f64>| -> f64 {
        views
            .iter()
            .take(SCAN_VIEWS)
            .map(|points| {
                homography_pose(camera, points, VIEW_ERROR_CAP)
                    .map_or(VIEW_ERROR_CAP, |fit| (fit.cost / points.len() as f64).sqrt().min(VIEW_ERROR_CAP))
            })
            .sum()
    };
    let scores: Vec<f64> = scan.par_iter().map(score).collect();
    let (start, _) = scan.iter().zip(&scores).min_by(|a, b| a.1.total_cmp(b.1))?;
    let fits: Vec<_> = views.par_iter().map(|points| homography_pose(start, points, HUBER)).collect::<Vec<_>>();
    let mut bundle_views: Vec<BundleView<'_>> = views
        .iter()
        .zip(fits)
        .filter_map(|(points, fit)| Some(BundleView { points, pose: fit?.pose, noise: 1.0 }))
        .collect();
    if bundle_views.len() < settings.min_frames {
        return None;
    }
    let mut camera = *start;
    let mut result = None;
    for free in passes(count) {
        let refined = bundle(&camera, &bundle_views, &free, sensor, HUBER)?;
        camera = refined.camera;
        for (view, pose) in bundle_views.iter_mut().zip(&refined.poses) {
            view.pose = *pose;
        }
        result = Some(refined);
    }
    result
}
