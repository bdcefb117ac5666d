//! The first camera, from a diverse subset of the sightings.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
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

/// Refines a camera by bundle adjustment on the views that get a pose with it.
pub fn refine_start(
    camera: &Camera<f64>,
    views: &[&[BoardPoint]],
    sensor: Sensor,
    settings: &InitialSettings,
) -> Option<(usize, Bundle)> {
    let posed: Vec<(Vec<BoardPoint>, Isometry3<f64>)> = views
        .par_iter()
        .map(|points| {
            let found = robust_pose(camera, points, settings).ok()?;
            let agreeing = points.iter().zip(&found.inliers).filter(|(_, inlier)| **inlier).map(|(point, _)| *point);
            Some((agreeing.collect(), found.pose))
        })
        .collect::<Vec<_>>()
        .into_iter()
        .flatten()
        .collect();
    if posed.len() < settings.min_frames {
        return None;
    }
    let views: Vec<BundleView<'_>> = posed.iter().map(|(points, pose)| BundleView { points, pose: *pose }).collect();
    let free = vec![true; camera.kind().parameter_names().len()];
    Some((posed.len(), bundle(camera, &views, &free, sensor, HUBER)?))
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

/// A refined camera and the number of views that got a pose with it.
type Candidate = Option<(usize, Bundle)>;

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
    if report.opencv.is_some() && !is_good(&best, &views) {
        let native = native_start(kind, views.first(), sensor, settings)
            .and_then(|start| refine_start(&start.camera, &views.all, sensor, settings));
        if merit(&native) > merit(&best) {
            best = native;
            report.native_start = true;
        }
    }
    let (_, bundle) = best.ok_or(InitialError::NoCamera { views: views.all.len(), reason })?;
    views_differ(&bundle)?;
    Ok(bundle)
}

/// Returns the reason to report if no camera is found.
fn reason(opencv: Option<&OpencvStart>) -> String {
    let Some(opencv) = opencv else { return "no focal length fits".to_owned() };
    opencv.failure.clone().unwrap_or_else(|| match opencv.rms {
        Some(rms) => format!("OpenCV: rms {rms:.1} px on {} views", opencv.views.1),
        None => "no result from OpenCV".to_owned(),
    })
}

/// Returns `true` if a camera explains most of the views.
fn is_good(candidate: &Candidate, views: &StartViews<'_>) -> bool {
    candidate.as_ref().is_some_and(|(posed, bundle)| 2 * posed > views.all.len() && bundle.rms <= MAX_START_RMS)
}

/// Returns a key by which candidates are compared: the number of views that the camera explains, then minus their root mean square
/// error.
fn merit(candidate: &Candidate) -> (usize, f64) {
    candidate.as_ref().map_or((0, f64::NEG_INFINITY), |(posed, bundle)| (*posed, -bundle.rms))
}

/// Returns an error if the views do not determine the focal lengths.
pub fn views_differ(bundle: &Bundle) -> Result<(), InitialError> {
    let focal = bundle.camera.axial_focal_lengths().unwrap_or([f64::NAN; 2]);
    let relative = focal.iter().zip(&bundle.axial_focal_sigma).map(|(focal, sigma)| sigma / focal).fold(0.0, f64::max);
    if relative <= MAX_FOCAL_DEVIATION { Ok(()) } else { Err(InitialError::ViewsAlike { percent: 100.0 * relative }) }
}
