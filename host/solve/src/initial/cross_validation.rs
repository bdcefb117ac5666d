//! Feature cross-validation (paper III): circles are searched again at the positions that the model predicts.
//!
//! Every circle of the board is projected into every frame. Circles whose rim leaves the sensor and circles whose events disagree
//! with the projection are dropped; the others get the centre and radius that fit their events; circles that the grid stage had
//! missed are added if their events are there. Frames with too few confirmed circles are dropped.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use rayon::prelude::*;

use super::Posed;
use super::drop_frame;
use super::frame_pose::{FramePose, PoseError, settle_pose};
use super::refit::{Frame, PixelRows, ProjectedCircle, Rejection, refit_circle};
use super::report::{DropReason, InitialReport, ValidationCounts};
use super::settings::{InitialSettings, MAX_MOTION_GAP};
use super::settled;
use super::sighting::{BoardPoint, Sighting};
use evcal_detection::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use evcal_geometry::board::{Board, CircleBoard};

/// Result of the cross-validation of one frame.
struct Validated {
    sighting: Sighting,
    counts: ValidationCounts,
    confirmed: bool,
}

/// Searches the circles again in the events of their frames, and refines the poses on them.
pub fn cross_validate(
    frames: &[ReferenceFrame],
    posed: Vec<Posed>,
    camera: &Camera<f64>,
    board: &Board,
    sensor: Sensor,
    settings: &InitialSettings,
    report: &mut InitialReport,
) -> Vec<Posed> {
    let validated: Vec<(Validated, Result<FramePose, PoseError>)> = posed
        .par_iter()
        .enumerate()
        .map(|(position, here)| {
            let frame = frames.get(here.sighting.frame);
            let events = frame.and_then(|frame| Some((frame, frame.events()?, board.circles()?)));
            let validated = match events {
                Some((frame, events, board)) => {
                    let motion = motion(&posed, position, frame.end - frame.start);
                    let pixels = PixelRows::new(events);
                    let view = Frame { camera, pose: here.pose, motion, sensor, pixels: &pixels };
                    confirm(&view, &here.sighting, board, settings)
                }
                None => perspective_corrected(camera, here, board),
            };
            let pose = settle_pose(camera, &validated.sighting.points, &here.pose, settings);
            (validated, pose)
        })
        .collect();
    let mut results = Vec::with_capacity(validated.len());
    for (Validated { sighting, counts, confirmed }, pose) in validated {
        report.circles.seen += counts.seen;
        report.circles.outside_sensor += counts.outside_sensor;
        report.circles.too_few_events += counts.too_few_events;
        report.circles.disagree += counts.disagree;
        report.circles.added += counts.added;
        if confirmed {
            results.push((sighting, pose));
        } else {
            drop_frame(report, sighting.frame, DropReason::Unconfirmed);
        }
    }
    settled(results.into_iter(), report)
}

/// Returns the poses of the neighbours of a frame and the fraction of the time between them that `duration` spans.
fn motion(posed: &[Posed], position: usize, duration: f64) -> Option<(Isometry3<f64>, Isometry3<f64>, f64)> {
    let here = posed.get(position)?;
    let near = |position: Option<usize>| {
        position.and_then(|position| posed.get(position)).filter(|other| {
            other.sighting.recording == here.sighting.recording
                && (other.sighting.t - here.sighting.t).abs() <= MAX_MOTION_GAP
        })
    };
    let before = near(position.checked_sub(1)).unwrap_or(here);
    let after = near(Some(position + 1)).unwrap_or(here);
    let elapsed = after.sighting.t - before.sighting.t;
    (elapsed > 0.0).then_some((before.pose, after.pose, duration / elapsed))
}

/// Returns the circles of a frame that its events confirm.
fn confirm(view: &Frame<'_>, sighting: &Sighting, board: &CircleBoard, settings: &InitialSettings) -> Validated {
    let mut counts = ValidationCounts { seen: sighting.circles.len(), ..ValidationCounts::default() };
    let mut inside = 0_u32;
    let mut circles = Vec::with_capacity(board.circle_count());
    for index in 0..board.circle_count() {
        let seen = sighting.circles.iter().any(|circle| circle.index == index);
        let refit = refit_circle(view, board, index, &settings.cross_validation);
        inside += u32::from(refit != Err(Rejection::OutsideSensor));
        match refit {
            Ok(refit) => {
                counts.added += usize::from(!seen);
                circles.push(ObservedCircle {
                    index,
                    t: sighting.t,
                    center: refit.center,
                    radius: Some(refit.radius),
                    velocity: None,
                });
            }
            Err(_) if !seen => {}
            Err(Rejection::OutsideSensor) => counts.outside_sensor += 1,
            Err(Rejection::TooFewEvents) => counts.too_few_events += 1,
            Err(Rejection::Disagrees) => counts.disagree += 1,
        }
    }
    let enough = settings.cross_validation.min_fraction * f64::from(inside);
    let confirmed = circles.len() >= settings.min_circles && circles.len() as f64 >= enough;
    let points = circles
        .iter()
        .map(|circle| BoardPoint { object: board.circle_center(circle.index), image: circle.center })
        .collect();
    Validated { sighting: Sighting { circles, points, ..*sighting }, counts, confirmed }
}

/// Corrects a frame without events: its circles are centres of ellipses and become images of the centres.
fn perspective_corrected(camera: &Camera<f64>, posed: &Posed, board: &Board) -> Validated {
    let mut sighting = posed.sighting.clone();
    for (circle, point) in sighting.circles.iter_mut().zip(&mut sighting.points) {
        if let Some(projected) = ProjectedCircle::new(camera, &posed.pose, point.object, board.dot_radius()) {
            let offset = projected.center - projected.middle;
            circle.center += offset;
            point.image += offset;
        }
    }
    let counts = ValidationCounts { seen: sighting.circles.len(), ..ValidationCounts::default() };
    Validated { sighting, counts, confirmed: true }
}
