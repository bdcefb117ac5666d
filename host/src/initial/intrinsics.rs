//! First estimate of the camera: OpenCV's calibration, or a native one where OpenCV fails.

use evcal_core::camera::{Camera, ModelKind, conversion::inverse_radial_from_radtan};
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::Serialize;

use super::bundle::{Bundle, BundleView, bundle};
use super::pose::homography_pose;
use super::settings::InitialSettings;
use super::sighting::BoardPoint;
use crate::opencv::{self, Calibration, PinholeDistortion, View};

/// How OpenCV's calibration went.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OpencvStart {
    /// Views it got and views it was left with after the worst had been taken away.
    pub views: (usize, usize),
    /// Its root mean square error in pixels; `None` if it failed.
    pub rms: Option<f64>,
    /// Why it failed, or why its result was not used.
    pub failure: Option<String>,
}

fn view_of(points: &[BoardPoint]) -> View {
    View {
        object: points.iter().map(|point| [point.object.x, point.object.y]).collect(),
        image: points.iter().map(|point| [point.image.x, point.image.y]).collect(),
    }
}

/// The camera of model `kind` that OpenCV's result stands for.
///
/// OpenCV has no inverse radial model: that one is converted from a radial one. The rational model
/// starts as the plain one with five coefficients, because its eight are hard to tell apart.
fn camera_of(kind: ModelKind, calibration: &Calibration, sensor: (u16, u16)) -> Option<Camera<f64>> {
    let intrinsics = &calibration.intrinsics;
    let mut parameters = [intrinsics.focal, intrinsics.center].concat();
    parameters.extend_from_slice(&intrinsics.distortion);
    match kind {
        ModelKind::InverseRadial => match Camera::from_parameters(ModelKind::Radtan, &parameters)? {
            Camera::Radtan(radtan) => {
                inverse_radial_from_radtan(&radtan, sensor.0, sensor.1).map(Camera::InverseRadial)
            }
            _ => None,
        },
        ModelKind::Radtan4 | ModelKind::Radtan | ModelKind::Radtan8 | ModelKind::KannalaBrandt => {
            parameters.resize(kind.parameter_names().len(), 0.0);
            Camera::from_parameters(kind, &parameters)
        }
    }
}

fn calibrate(kind: ModelKind, views: &[View], sensor: (u16, u16)) -> Result<Calibration, opencv::OpencvError> {
    let distortion = match kind {
        ModelKind::Radtan4 => PinholeDistortion::RadialTangential4,
        ModelKind::Radtan | ModelKind::Radtan8 => PinholeDistortion::RadialTangential5,
        ModelKind::InverseRadial => PinholeDistortion::Radial3,
        ModelKind::KannalaBrandt => return opencv::calibrate_fisheye(views, sensor),
    };
    opencv::calibrate_pinhole(views, sensor, distortion, None)
}

/// Focal lengths that are no camera's: fields of view below 6° and above 180° by far.
fn plausible(camera: &Camera<f64>, sensor: (u16, u16)) -> bool {
    let (width, height) = (f64::from(sensor.0), f64::from(sensor.1));
    let diagonal = width.hypot(height);
    match camera.parameters().as_slice() {
        &[fx, fy, cx, cy, ..] => {
            let focal = (0.15 * diagonal..=10.0 * diagonal).contains(&fx) && (0.8..=1.25).contains(&(fx / fy));
            focal && (0.0..=width).contains(&cx) && (0.0..=height).contains(&cy)
        }
        _ => false,
    }
}

/// OpenCV's calibration of `views` as a camera of model `kind`; while its error is above the
/// settings' bound, the worst views are left out and it is tried again.
pub fn opencv_start(
    kind: ModelKind,
    views: &[&[BoardPoint]],
    sensor: (u16, u16),
    settings: &InitialSettings,
) -> (Option<Camera<f64>>, OpencvStart) {
    let mut views: Vec<View> = views.iter().map(|points| view_of(points)).collect();
    let mut start = OpencvStart { views: (views.len(), views.len()), rms: None, failure: None };
    let mut best: Option<(Camera<f64>, f64)> = None;
    for _ in 0..=settings.start_retries {
        let calibration = match calibrate(kind, &views, sensor) {
            Ok(calibration) => calibration,
            Err(error) => {
                start.failure = Some(error.to_string());
                break;
            }
        };
        match camera_of(kind, &calibration, sensor).filter(|camera| plausible(camera, sensor)) {
            Some(camera) if best.is_none_or(|(_, rms)| calibration.rms < rms) => {
                best = Some((camera, calibration.rms));
                start.views.1 = calibration.views.len();
                start.rms = Some(calibration.rms);
                start.failure = None;
            }
            Some(_) => {}
            None => start.failure = Some(format!("implausible result: {:?}", calibration.intrinsics)),
        }
        if calibration.rms <= settings.max_start_rms {
            break;
        }
        let mut sorted = calibration.view_rms.clone();
        sorted.sort_by(f64::total_cmp);
        // Half of the views are always kept, or a wrong calibration would choose its own evidence.
        let bound = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0) * 1.5;
        let kept: Vec<View> = calibration
            .views
            .iter()
            .zip(&calibration.view_rms)
            .filter(|(_, rms)| **rms <= bound)
            .filter_map(|(&view, _)| views.get(view).cloned())
            .collect();
        if kept.len() < settings.min_frames || kept.len() == views.len() {
            break;
        }
        views = kept;
    }
    (best.map(|(camera, _)| camera), start)
}

/// Which parameters move in each pass of the native start: the focal lengths and the first
/// distortion coefficient, then everything.
fn passes(parameters: usize) -> [Vec<bool>; 3] {
    let first = |free: &[usize]| (0..parameters).map(|index| free.contains(&index)).collect();
    [first(&[0, 1, 4]), first(&[0, 1, 2, 3, 4, 5]), vec![true; parameters]]
}

/// Root mean square error that a bad view may add at most when focal lengths are compared, in px.
const VIEW_ERROR_CAP: f64 = 20.0;

/// Number of views that compare focal lengths.
const SCAN_VIEWS: usize = 16;

/// A camera of model `kind` without OpenCV: a scan over focal lengths, principal point in the middle
/// of the sensor, with and without the barrel distortion of ordinary lenses; then bundle refinement
/// with more and more free parameters.
pub fn native_start(
    kind: ModelKind,
    views: &[&[BoardPoint]],
    sensor: (u16, u16),
    settings: &InitialSettings,
) -> Option<Bundle> {
    let size = Vector2::new(f64::from(sensor.0), f64::from(sensor.1));
    let center = (size - Vector2::new(1.0, 1.0)) / 2.0;
    let count = kind.parameter_names().len();
    let barrel = match kind {
        ModelKind::InverseRadial => 0.3,
        ModelKind::KannalaBrandt => 0.0,
        ModelKind::Radtan4 | ModelKind::Radtan | ModelKind::Radtan8 => -0.3,
    };
    let scan: Vec<Camera<f64>> = (0..32)
        .flat_map(|step| {
            let focal = 0.2 * size.norm() * 1.12_f64.powi(step);
            [0.0, barrel].map(|k1| {
                let mut parameters = vec![focal, focal, center.x, center.y, k1];
                parameters.resize(count, 0.0);
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
    let fits: Vec<_> =
        views.par_iter().map(|points| homography_pose(start, points, settings.huber)).collect::<Vec<_>>();
    let mut bundle_views: Vec<BundleView<'_>> =
        views.iter().zip(fits).filter_map(|(points, fit)| Some(BundleView { points, pose: fit?.pose })).collect();
    if bundle_views.len() < settings.min_frames {
        return None;
    }
    let mut camera = *start;
    let mut result = None;
    for free in passes(count) {
        let refined = bundle(&camera, bundle_views.clone(), &free, sensor, settings.huber)?;
        camera = refined.camera;
        for (view, pose) in bundle_views.iter_mut().zip(&refined.poses) {
            view.pose = *pose;
        }
        result = Some(refined);
    }
    result
}
