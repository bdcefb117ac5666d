//! The trajectory along intervals outside the joint solve. Each interval is solved with the camera of the joint solve
//! fixed.

use std::convert::Infallible;
use std::ops::Range;

use evcal_core::camera::MAX_PARAMETERS;

use super::kept_events::read_share;
use crate::calibrate::solves::board_solve::BoardSolve;
use crate::calibrate::solves::joint_solve::{stage_settings, trajectory_settings};
use crate::quality::poses::{UncertainPose, sampled_poses};
use crate::quality::uncertainty::POSE_MODEL_ERROR;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::progress::Progress;
use evcal_detection::circles::compact_frame::CompactFrame;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_solve::initial::{InitialModel, posed_frames};
use evcal_solve::solve::equations::pose_covariance::PoseCovariance;
use evcal_solve::solve::event_sample::RankedEvent;
use evcal_solve::solve::fixed_camera::{Followed, follow};
use evcal_solve::solve::left_out::LeftOut;
use evcal_solve::solve::refinement::{EventInput, RefinementInput};
use evcal_solve::solve::{BOARD_PARAMETERS, State};
use evcal_solve::trajectory::first::first_trajectories;
use event_recordings::pass::RecordingReport;

/// Length of the intervals that are solved together (s).
const LENGTH: f64 = 10.0;
/// Number of events per second, on average over a recording. With 20,000 the error of the trajectory was 0.37 mm, with 100,000 and
/// 200,000 it was 0.26 and 0.25 mm (20 s of fast motion, seed 21).
const EVENTS_PER_SECOND: f64 = 50_000.0;
/// Time before the first and after the last window of an interval within which events may belong to it (s).
const MARGIN: f64 = 0.5;

/// The poses along one interval outside the joint solve.
#[derive(Clone, Debug, PartialEq)]
pub struct FollowedInterval {
    /// Number of the recording.
    pub recording: usize,
    /// Its poses, in order of time; times count from the start of the recording.
    pub poses: Vec<UncertainPose>,
}

/// Reads the recordings again, and solves the trajectory along `frames`, which are in order of recording and time, with the
/// camera of `solve` fixed. Intervals whose events do not fit any curve are added to the intervals that `solve`
/// excludes.
///
/// # Errors
/// [`CalibrateError`] if a recording cannot be read, or the caller cancels.
pub(super) fn follow_others(
    task: &Task,
    solve: &mut BoardSolve,
    frames: &[CompactFrame],
    reports: &[RecordingReport],
    progress: &Progress,
) -> Result<Vec<FollowedInterval>, CalibrateError> {
    if frames.is_empty() {
        return Ok(Vec::new());
    }
    let mut left_out = Vec::new();
    progress.report("trajectory of the other intervals")?;
    let sensor = solve.refined.problem.sensor;
    let part = |frame: &CompactFrame| (frame.t() / LENGTH).floor() as i64;
    let mut followed = Vec::new();
    for frames in frames.chunk_by(|a, b| a.recording == b.recording) {
        let Some(recording) = frames.first().map(|frame| frame.recording) else { continue };
        let share = reports.get(recording).map_or(1.0, share);
        let mut intervals = frames.chunk_by(|a, b| part(a) == part(b)).peekable();
        // Solves the intervals that end before `t` (µs), and drops the events that no later interval needs.
        let mut follow_until = |events: &mut Vec<RankedEvent>, t: i64| {
            while let Some(frames) = intervals.next_if(|frames| span(frames).end <= t) {
                let frames: Vec<ReferenceFrame> = frames.iter().map(CompactFrame::without_events).collect();
                // If an interval cannot be solved, no poses are written for it.
                if let Some((interval, unexplained)) = follow_interval(task, solve, &frames, events) {
                    left_out.extend(unexplained);
                    followed.push(interval);
                }
            }
            let next = intervals.peek().map_or(i64::MAX, |frames| span(frames).start);
            events.drain(..events.partition_point(|event| event.t < next));
        };
        let mut kept: Vec<RankedEvent> = Vec::new();
        read_share(task, recording, share, sensor, progress, &mut |events| {
            kept.extend_from_slice(events);
            let t = kept.last().map_or(i64::MIN, |event| event.t);
            follow_until(&mut kept, t);
        })?;
        follow_until(&mut kept, i64::MAX);
    }
    solve.refined.left_out.extend(left_out);
    Ok(followed)
}

/// Returns the share of a recording's events that is used.
fn share(report: &RecordingReport) -> f64 {
    (EVENTS_PER_SECOND * report.duration / report.count as f64).min(1.0)
}

/// Returns the times (µs) of the events that belong to an interval.
fn span(frames: &[CompactFrame]) -> Range<i64> {
    let start = frames.first().map_or(0.0, |first| first.start);
    let end = frames.last().map_or(0.0, |last| last.end);
    ((start - MARGIN) * 1e6) as i64..((end + MARGIN) * 1e6) as i64
}

fn follow_interval(
    task: &Task,
    solve: &BoardSolve,
    frames: &[ReferenceFrame],
    events: &[RankedEvent],
) -> Option<(FollowedInterval, Vec<LeftOut>)> {
    let settings = task.settings;
    let BoardSolve { refined, certainty, .. } = solve;
    let (problem, solution) = (&refined.problem, &refined.state);
    let recording = frames.first()?.recording;
    let initial =
        InitialModel::of_frames(solution.camera, posed_frames(frames, task.board, &solution.camera, &settings.initial));
    let first = first_trajectories(&initial, frames, trajectory_settings(settings)).ok()?;
    let start = first.trajectories.iter().map(|one| one.start()).fold(f64::INFINITY, f64::min);
    let end = first.trajectories.iter().map(|one| one.end()).fold(f64::NEG_INFINITY, f64::max);
    // Events up to 0.1 s before and after the trajectory are included, because events are later than their edges, by
    // the latency of their class.
    let place = |t: f64| events.partition_point(|event| event.t < (t * 1e6) as i64);
    let events = events.get(place(start - 0.1)..place(end + 0.1)).unwrap_or_default();
    let counts: Vec<u64> = (0..=recording).map(|one| if one == recording { events.len() as u64 } else { 0 }).collect();
    let read = |index: usize, _: f64, visit: &mut dyn FnMut(&[RankedEvent])| {
        if index == recording {
            visit(events);
        }
        Ok::<(), Infallible>(())
    };
    let input = RefinementInput {
        board: task.board,
        sensor: problem.sensor,
        events: Some(EventInput { counts: &counts, read: &read }),
        points: Vec::new(),
        anchors: &first.points,
        point_sigma: problem.point_sigma,
        left_out: &refined.left_out,
        free_board: [false; BOARD_PARAMETERS],
        fixed: [true; MAX_PARAMETERS],
    };
    let state = State { trajectories: first.trajectories, ..solution.clone() };
    // The solve fails, for example, if there are too few events.
    let followed = follow(&input, state, problem, stage_settings(settings)).ok()?;
    let Followed { state, system, left_out: unexplained, .. } = followed;
    let columns: Vec<usize> = (0..certainty.formal.nrows()).collect();
    let controls = system.into_reduced().ok()?.into_follows().control_covariances(&columns, &certainty.formal)?;
    // The usual σ (median) is computed from this interval's own poses, because there are fewer events than in the joint
    // solve.
    let covariance =
        PoseCovariance::new(controls, certainty.intrinsics.inflation, &state.trajectories, POSE_MODEL_ERROR);
    let all_left_out: Vec<LeftOut> = refined.left_out.iter().chain(&unexplained).copied().collect();
    let poses = sampled_poses(&state, &covariance, &all_left_out, recording, &settings.poses);
    Some((FollowedInterval { recording, poses }, unexplained))
}
