//! The first camera, from a diverse subset of the sightings.

use evcal_core::camera::refit::refit_where;
use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Vector2};
use rayon::prelude::*;

use super::bundle::{Bundle, BundleView, bundle};
use super::frame_pose::robust_pose;
use super::native_start::native_start;
use super::report::{InitialError, InitialReport, OpencvStart};
use super::settings::{HUBER, InitialSettings, MAX_START_RMS, START_VIEWS};
use super::sighting::{BoardPoint, Sighting};
use super::start::start_of;
use super::view_selection::select_views;
use evcal_geometry::board::Board;

/// Number of views in the bundle refinement after the first calibration.
const BUNDLE_VIEWS: usize = 80;

/// Largest standard deviation of the focal length, as a share of it, at which a camera counts as calibrated.
const MAX_FOCAL_DEVIATION: f64 = 0.05;

/// Smallest share of the points of views with a pose that agree with a good camera.
const MIN_AGREEING: f64 = 0.9;

/// A refined camera, and the part of the views that it explains.
struct Candidate {
    bundle: Bundle,
    /// Number of views with a pose.
    views: usize,
    /// Number of points that agree with the poses.
    agreeing: usize,
    /// Number of points of the views with a pose.
    points: usize,
}

/// Refines a camera by bundle adjustment on the views that get a pose with it.
fn refine_start(
    camera: &Camera<f64>,
    views: &[&[BoardPoint]],
    sensor: Sensor,
    settings: &InitialSettings,
) -> Option<Candidate> {
    let posed: Vec<(Vec<BoardPoint>, usize, Isometry3<f64>)> = views
        .par_iter()
        .map(|points| {
            let found = robust_pose(camera, points, settings).ok()?;
            let agreeing = points.iter().zip(&found.inliers).filter(|(_, inlier)| **inlier).map(|(point, _)| *point);
            Some((agreeing.collect(), points.len(), found.pose))
        })
        .collect::<Vec<_>>()
        .into_iter()
        .flatten()
        .collect();
    if posed.len() < settings.min_frames {
        return None;
    }
    let views: Vec<BundleView<'_>> =
        posed.iter().map(|(agreeing, _, pose)| BundleView { points: agreeing, pose: *pose, noise: 1.0 }).collect();
    let free = vec![true; camera.kind().parameter_names().len()];
    Some(Candidate {
        bundle: bundle(camera, &views, &free, sensor, HUBER)?,
        views: posed.len(),
        agreeing: posed.iter().map(|(agreeing, ..)| agreeing.len()).sum(),
        points: posed.iter().map(|(_, points, _)| points).sum(),
    })
}

/// Views from which the first camera is computed.
struct StartViews<'a> {
    /// Views of the refinement.
    all: Vec<&'a [BoardPoint]>,
    /// Number of views of the start, from the first on.
    first: usize,
}

impl StartViews<'_> {
    fn first(&self) -> &[&[BoardPoint]] {
        self.all.get(..self.first).unwrap_or(&self.all)
    }
}

/// Computes the camera from a diverse subset of the sightings, refined.
pub fn first_camera(
    sightings: &[Sighting],
    board: &Board,
    sensor: Sensor,
    kind: ModelKind,
    settings: &InitialSettings,
    report: &mut InitialReport,
) -> Result<Bundle, InitialError> {
    let all: Vec<&[BoardPoint]> = sightings.iter().map(|sighting| sighting.points.as_slice()).collect();
    let all = select_views(&all, board, sensor, BUNDLE_VIEWS)
        .into_iter()
        .filter_map(|position| all.get(position).copied())
        .collect();
    let views = StartViews { all, first: START_VIEWS };
    let started = start_of(settings).camera(kind, views.first(), sensor, settings);
    let mut best = started.camera.and_then(|camera| refine_start(&camera, &views.all, sensor, settings));
    let reason = reason(started.opencv.as_ref());
    report.native_start = started.opencv.is_none();
    report.opencv = started.opencv;
    if report.opencv.is_some() && !is_good(best.as_ref(), &views) {
        let native = native_start(kind, views.first(), sensor, settings)
            .and_then(|start| refine_start(&start.camera, &views.all, sensor, settings));
        if merit(native.as_ref()) > merit(best.as_ref()) {
            best = native;
            report.native_start = true;
        }
    }
    if !is_good(best.as_ref(), &views) {
        let fisheye = from_fisheye(kind, &views, sensor, settings);
        if merit(fisheye.as_ref()) > merit(best.as_ref()) {
            best = fisheye;
            report.native_start = report.opencv.is_none();
        }
    }
    let bundle = best.ok_or(InitialError::NoCamera { views: views.all.len(), reason })?.bundle;
    views_differ(&bundle)?;
    Ok(bundle)
}

/// Computes a fisheye camera, and from it a camera of model `kind`. A polynomial in the tangent of the angle to the axis has many
/// local minima for a lens with strong barrel distortion; a polynomial in the angle starts near the right one.
fn from_fisheye(
    kind: ModelKind,
    views: &StartViews<'_>,
    sensor: Sensor,
    settings: &InitialSettings,
) -> Option<Candidate> {
    const FISHEYE: ModelKind = ModelKind::KannalaBrandt;
    if kind == FISHEYE {
        return None;
    }
    let started = start_of(settings).camera(FISHEYE, views.first(), sensor, settings).camera?;
    let fisheye = refine_start(&started, &views.all, sensor, settings)?.bundle.camera;
    let &[_, _, cx, cy, ..] = fisheye.parameters().as_slice() else { return None };
    let center = Vector2::new(cx, cy);
    let points = views.all.iter().copied().flatten();
    let covered = points.map(|point| (point.image - center).norm()).fold(0.0, f64::max);
    let inside = |pixel: &Vector2<f64>| (pixel - center).norm() <= covered && fisheye.unproject(pixel).is_some();
    refine_start(&refit_where(kind, &fisheye, sensor, inside)?, &views.all, sensor, settings)
}

/// Returns the reason to report if no camera is found.
fn reason(opencv: Option<&OpencvStart>) -> String {
    let Some(opencv) = opencv else { return "no focal length fits".to_owned() };
    opencv.failure.clone().unwrap_or_else(|| match opencv.rms {
        Some(rms) => format!("OpenCV: rms {rms:.1} px on {} views", opencv.views.1),
        None => "no result from OpenCV".to_owned(),
    })
}

/// Returns `true` if a camera explains most of the views, and nearly all points of these.
fn is_good(candidate: Option<&Candidate>, views: &StartViews<'_>) -> bool {
    candidate.is_some_and(|Candidate { bundle, views: posed, agreeing, points }| {
        let agree = *agreeing as f64 >= MIN_AGREEING * *points as f64;
        2 * posed > views.all.len() && agree && bundle.rms <= MAX_START_RMS
    })
}

/// Returns a key by which candidates are compared: the number of points that the camera explains, then minus their root mean square
/// error.
fn merit(candidate: Option<&Candidate>) -> (usize, f64) {
    candidate.map_or((0, f64::NEG_INFINITY), |candidate| (candidate.agreeing, -candidate.bundle.rms))
}

/// Returns an error if the views do not determine the focal lengths.
pub fn views_differ(bundle: &Bundle) -> Result<(), InitialError> {
    let focal = bundle.camera.axial_focal_lengths().unwrap_or([f64::NAN; 2]);
    let relative = focal.iter().zip(&bundle.axial_focal_sigma).map(|(focal, sigma)| sigma / focal).fold(0.0, f64::max);
    if relative <= MAX_FOCAL_DEVIATION { Ok(()) } else { Err(InitialError::ViewsAlike { percent: 100.0 * relative }) }
}
