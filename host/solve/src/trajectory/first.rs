//! Segments, and a spline through the initial poses of each (sections 6 and 7 of method.md).

use crate::initial::InitialModel;
use crate::trajectory::fit::{TrajectoryShape, fit, on_knots};
use crate::trajectory::knot_grid::KnotSettings;
use crate::trajectory::segment::{SegmentReport, SegmentSettings, fewest_frames, segment, typical_interval};
use crate::trajectory::settings::SplineSettings;
use crate::trajectory::{Trajectory, TrajectoryError};
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_geometry::timed_pose::TimedPose;

/// Largest time between a circle and the middle of its frame (s).
const LONGEST_FRAME: f64 = 0.5;
/// Knot spacing in the first round, if there are events (s).
const FIRST_SPACING: f64 = 0.00875;

/// Start of the joint solve, in addition to the camera.
pub struct FirstTrajectories {
    /// One trajectory per segment whose spline could be fitted.
    pub trajectories: Vec<Trajectory>,
    /// The points of each trajectory's reference frames, in order of time.
    pub points: Vec<Vec<PointObservation>>,
    /// Counts of the reference frames that were kept and dropped.
    pub segments: SegmentReport,
    /// Number of segments whose spline could not be fitted.
    pub without_spline: usize,
}

/// Reasons why there is no start trajectory.
#[derive(Debug, thiserror::Error)]
pub enum FirstTrajectoryError {
    /// No segment is long enough.
    #[error(
        "the board was found in {frames} windows, but never often enough in a row for a trajectory ({too_few} groups of fewer than {fewest}): keep the whole board in view and moving"
    )]
    NoSegment {
        /// Number of reference frames.
        frames: usize,
        /// Number of groups that were too short.
        too_few: usize,
        /// Number of required frames.
        fewest: usize,
    },
    /// The frames of circle tracks are too far apart.
    #[error(
        "the frames with the board are {interval:.1} s apart, and a trajectory needs one at least every {longest} s: are the times in seconds?"
    )]
    FarApart {
        /// Median time between frames (s).
        interval: f64,
        /// Longest permitted gap (s).
        longest: f64,
    },
    /// The circles of a frame were not observed at the same time.
    #[error(
        "the circles or the time window of the frame at {t:.2} s reach {reach:.2} s from it, and {} s is the most: are the times in seconds?",
        LONGEST_FRAME
    )]
    LongFrame {
        /// Time of the frame (s).
        t: f64,
        /// Largest time between a circle and the frame (s).
        reach: f64,
    },
    /// No segment has a spline.
    #[error("no trajectory could be fitted: {0}")]
    Trajectory(TrajectoryError),
}

/// All settings of [`first_trajectories`].
#[derive(Clone, Copy)]
pub struct FirstTrajectorySettings<'a> {
    /// Segments.
    pub segment: &'a SegmentSettings,
    /// Splines.
    pub spline: &'a SplineSettings,
    /// Knots.
    pub knots: &'a KnotSettings,
}

/// Divides `frames`, those with a pose in `initial`, into segments and fits a spline to each.
pub fn first_trajectories(
    initial: &InitialModel,
    frames: &[ReferenceFrame],
    settings: FirstTrajectorySettings,
) -> Result<FirstTrajectories, FirstTrajectoryError> {
    let FirstTrajectorySettings { segment: segment_settings, spline, knots } = settings;
    let posed = || initial.frames.iter().filter_map(|posed| frames.get(posed.frame));
    let from_circles = || posed().filter(|frame| !frame.is_from_events());
    // The segment of a frame covers all its circles and its window, so a long frame would make a long segment.
    if let Some(frame) = from_circles().find(|frame| reach(frame) > LONGEST_FRAME) {
        return Err(FirstTrajectoryError::LongFrame { t: frame.t(), reach: reach(frame) });
    }
    let times: Vec<(usize, f64)> = posed().map(|frame| (frame.recording, frame.t())).collect();
    let interval = typical_interval(&times);
    let longest_gap = segment_settings.longest_gap_at(interval);
    let (ranges, segments) = segment(&times, spline.degree, longest_gap);
    if ranges.is_empty() {
        if interval > longest_gap && from_circles().next().is_some() {
            return Err(FirstTrajectoryError::FarApart { interval, longest: longest_gap });
        }
        let fewest = fewest_frames(spline.degree);
        let too_few = segments.too_few_frames + segments.too_short;
        return Err(FirstTrajectoryError::NoSegment { frames: segments.frames_in, too_few, fewest });
    }
    let shape = TrajectoryShape { degree: spline.degree, rotation: spline.rotation, knot_spacing: spline.knot_spacing };
    let mut trajectories: Vec<Trajectory> = Vec::new();
    let mut points: Vec<Vec<PointObservation>> = Vec::new();
    let mut failure = None;
    for range in &ranges {
        match fit_segment(initial, frames, range.clone(), &shape, knots) {
            Ok((trajectory, observations)) => {
                trajectories.push(trajectory);
                points.push(observations);
            }
            Err(error) => failure = Some(error),
        }
    }
    let without_spline = ranges.len() - trajectories.len();
    if let (true, Some(error)) = (trajectories.is_empty(), failure) {
        return Err(FirstTrajectoryError::Trajectory(error));
    }
    Ok(FirstTrajectories { trajectories, points, segments, without_spline })
}

/// Returns the largest time between the middle of a frame and its circles or the ends of its window (s).
fn reach(frame: &ReferenceFrame) -> f64 {
    let times = frame.circles.iter().map(|circle| circle.t).chain([frame.start, frame.end]);
    times.fold(0.0, |reach, t| (t - frame.t()).abs().max(reach))
}

/// Fits the spline of one segment, and returns the points of its reference frames.
fn fit_segment(
    initial: &InitialModel,
    frames: &[ReferenceFrame],
    range: std::ops::Range<usize>,
    shape: &TrajectoryShape,
    spacings: &KnotSettings,
) -> Result<(Trajectory, Vec<PointObservation>), TrajectoryError> {
    let posed = initial.frames.get(range).unwrap_or_default();
    let in_frames = |index: usize| frames.get(index);
    let poses: Vec<TimedPose> = posed
        .iter()
        .filter_map(|posed| in_frames(posed.frame).map(|frame| TimedPose { t: frame.t(), pose: posed.pose }))
        .collect();
    let spans: Vec<(f64, f64)> =
        posed.iter().filter_map(|posed| in_frames(posed.frame)).map(|frame| (frame.start, frame.end)).collect();
    let from_circles = posed.iter().filter_map(|posed| in_frames(posed.frame)).all(|frame| !frame.is_from_events());
    let mut points: Vec<PointObservation> = posed
        .iter()
        .flat_map(|posed| &posed.circles)
        .map(|circle| PointObservation { t: circle.t, pixel: circle.center, circle: circle.index })
        .collect();
    points.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.circle.cmp(&b.circle)));
    let first = points.first().map_or(f64::INFINITY, |point| point.t);
    let last = points.last().map_or(f64::NEG_INFINITY, |point| point.t);
    let start = spans.iter().fold(first, |start, span| start.min(span.0));
    let end = spans.iter().fold(last, |end, span| end.max(span.1));
    let recording = posed.first().and_then(|posed| in_frames(posed.frame)).map_or(0, |frame| frame.recording);
    let trajectory = fit(recording, &poses, start, end, shape)?;
    if from_circles {
        return Ok((trajectory, points));
    }
    // With events, the knots are even at FIRST_SPACING, because the events determine the curve between sparse frames
    // too.
    let grid = spacings.grid(&trajectory);
    let knots = grid.even(grid.level_of(FIRST_SPACING), shape.degree);
    Ok((on_knots(&trajectory, knots, shape.rotation)?, points))
}
