//! The trajectory along stretches that the joint solve had no room for, stretch by stretch with its camera.

use evcal_core::camera::MAX_PARAMETERS;
use evcal_core::sensor::Sensor;

use super::Task;
use super::error::CalibrateError;
use super::joint_solve::stage_settings;
use super::progress::Progress;
use crate::circles::compact_frame::CompactFrame;
use crate::circles::reference_frame::ReferenceFrame;
use crate::initial::{InitialModel, posed_frames};
use crate::solve::event_sample::{EventSample, RankedEvent};
use crate::solve::held_camera::{Followed, follow};
use crate::solve::left_out::LeftOut;
use crate::solve::pose_covariance::PoseCovariance;
use crate::solve::refinement::{EventInput, Refined, RefinementError, RefinementInput};
use crate::solve::{BOARD_PARAMETERS, State};
use crate::trajectory::first::first_trajectories;
use crate::trust::poses::{UncertainPose, sampled_poses};
use crate::trust::uncertainty::SolveUncertainty;

/// Stretches are solved together in lengths of this (s).
const LENGTH: f64 = 10.0;

/// The poses along one stretch that is not in the joint solve.
#[derive(Clone, Debug, PartialEq)]
pub struct FollowedStretch {
    /// Number of the recording.
    pub recording: usize,
    /// Its poses, in order of time; times count from the start of the recording.
    pub poses: Vec<UncertainPose>,
}

/// Follows the camera of `refined` along `frames`, which are in order of recording and time. What no curve explains is added to
/// `left_out`.
///
/// # Errors
/// [`CalibrateError`] when the caller wants the end.
pub(super) fn follow_others(
    task: &Task,
    (refined, certainty): (&Refined, &SolveUncertainty),
    (frames, sample): (&[CompactFrame], &EventSample),
    left_out: &mut Vec<LeftOut>,
    progress: &Progress,
) -> Result<Vec<FollowedStretch>, CalibrateError> {
    let part = |frame: &CompactFrame| (frame.recording, (frame.t() / LENGTH).floor() as i64);
    let (mut followed, mut seen) = (Vec::new(), 0);
    let all = frames.len() as f64;
    for frames in frames.chunk_by(|a, b| part(a) == part(b)) {
        progress.tell_part("trajectory of the other stretches", seen as f64 / all)?;
        seen += frames.len();
        let frames: Vec<ReferenceFrame> = frames.iter().map(CompactFrame::without_events).collect();
        // Where nothing can be followed no pose is written.
        let Some(stretch) = follow_stretch(task, (refined, certainty), (&frames, sample), &refined.left_out)? else {
            continue;
        };
        left_out.extend(stretch.1);
        followed.push(stretch.0);
    }
    Ok(followed)
}

fn follow_stretch(
    task: &Task,
    (refined, certainty): (&Refined, &SolveUncertainty),
    (frames, sample): (&[ReferenceFrame], &EventSample),
    left_out: &[LeftOut],
) -> Result<Option<(FollowedStretch, Vec<LeftOut>)>, CalibrateError> {
    let settings = task.settings;
    let (problem, solution) = (&refined.problem, &refined.state);
    let sensor: Sensor = problem.sensor;
    let Some(recording) = frames.first().map(|frame| frame.recording) else { return Ok(None) };
    let initial =
        InitialModel::of_frames(solution.camera, posed_frames(frames, task.board, &solution.camera, &settings.initial));
    let curves = (&settings.spline, &settings.knots);
    let Ok(first) = first_trajectories(&initial, frames, &settings.segment, curves) else { return Ok(None) };
    let start = first.trajectories.iter().map(|one| one.start()).fold(f64::INFINITY, f64::min);
    let end = first.trajectories.iter().map(|one| one.end()).fold(f64::NEG_INFINITY, f64::max);
    let span = ((start - 0.1) * 1e6) as i64..((end + 0.1) * 1e6) as i64;
    let events = sample.within(recording, span);
    let counts: Vec<u64> = (0..=recording).map(|one| if one == recording { events.len() as u64 } else { 0 }).collect();
    let read = |index: usize, _: f64, visit: &mut dyn FnMut(&[RankedEvent])| {
        if index == recording {
            visit(&events);
        }
        Ok::<(), CalibrateError>(())
    };
    let input = RefinementInput {
        board: task.board,
        sensor,
        events: Some(EventInput { counts: &counts, read: &read }),
        points: Vec::new(),
        point_sigma: problem.point_sigma,
        left_out,
        free_board: [false; BOARD_PARAMETERS],
        held: [true; MAX_PARAMETERS],
    };
    let state = State { trajectories: first.trajectories, ..solution.clone() };
    let Followed { state, system, left_out: unexplained, .. } =
        match follow(&input, state, problem, stage_settings(settings)) {
            Ok(followed) => followed,
            Err(RefinementError::Read(error)) => return Err(error),
            // Too few events, say.
            Err(RefinementError::Solve(_)) => return Ok(None),
        };
    let Ok(reduced) = system.into_reduced(0.0, &problem.free.mask()) else { return Ok(None) };
    let places: Vec<usize> = reduced.places(&problem.free.mask());
    let Some(controls) = reduced.into_follows().control_covariances(&places, &certainty.formal) else {
        return Ok(None);
    };
    let covariance = PoseCovariance::new(controls, certainty.intrinsics.inflation);
    let all_left_out: Vec<LeftOut> = left_out.iter().chain(&unexplained).copied().collect();
    let poses = sampled_poses(&state, (&covariance, &all_left_out), recording, &settings.poses);
    Ok(Some((FollowedStretch { recording, poses }, unexplained)))
}
