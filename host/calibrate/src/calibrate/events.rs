//! The calibration from events, or from circles that a detector found in them.

use evcal_core::camera::MAX_PARAMETERS;
use evcal_core::camera::refit::refit;
use evcal_core::sensor::Sensor;

use super::board_choice::larger_board;
use super::board_solve::{BoardSolve, solve_with_board};
use super::calibrated::{Calibrated, EventCalibration, Evidence, Measured, OwnPictures, SAMPLE};
use super::detected::{Detected, detect_all};
use super::error::CalibrateError;
use super::health::findings_on;
use super::joint_solve::solve;
use super::kept_events::{events_of, read_share};
use super::other_stretches::follow_others;
use super::progress::Progress;
use super::stretch_choice::{ChosenSeconds, StretchChoice, choose_stretches, second_of};
use super::{PictureUse, Task, other_camera, pictures, unseen_rows, unstated_rows};
use crate::circles::compact_frame::CompactFrame;
use crate::circles::reference_frame::{ReferenceFrame, SeenIn};
use crate::detection::larger_pattern::larger_pattern;
use crate::detection::radius::other_radius;
use crate::detection::unplaced::UnplacedWindows;
use crate::initial::model_choice::{CANDIDATES, ModelChoice, ModelRequest, choose_model};
use crate::initial::{InitialModel, initial_model};
use crate::picture_calibration::joint::JointPoints;
use crate::solve::event_bias::unknown;
use crate::solve::event_sample::RankedEvent;
use crate::solve::left_out::LeftOut;
use crate::solve::refinement::{EventInput, FIRST_SIGMA, RefinementInput, SMALLEST_POINT_SIGMA};
use crate::solve::{BOARD_PARAMETERS, FreeParameters, State};
use crate::trajectory::first::{FirstTrajectories, first_trajectories};
use crate::trust::board_evidence::BoardEstimate;
use crate::trust::verdict::{Finding, verdict};
use crate::trust::witness::WitnessOutcome;
use crate::trust::{better_model, examine};
use evcal_geometry::board::shape::BoardShape;

/// Stretches with a saturated readout are left out unless they are a larger part of the recordings than this.
const MOST_LEFT_OUT: f64 = 0.5;

/// Calibrates as `task` says, with pictures as a witness or a partner.
///
/// # Errors
/// [`CalibrateError`].
pub(super) fn calibrate(task: &Task, progress: &Progress) -> Result<Calibrated, CalibrateError> {
    let settings = task.settings;
    let Detected {
        sensor,
        windows,
        frames,
        starts,
        recordings,
        detection,
        unplaced,
        events,
        sample,
        without_pictures,
        saturated,
        health,
    } = match task.readers {
        Some(readers) => readers.install(|| detect_all(task, progress)),
        None => detect_all(task, progress),
    }?;
    let choice = choose_stretches(&windows, task, sensor);
    let (mut frames, other_windows) = taken(windows, frames, choice.as_ref());
    let duration = recordings.iter().map(|recording| recording.duration).sum::<f64>();
    let (left_out, saturated) = left_out_or_kept(saturated, duration);
    let (initial, model_choice) =
        first_model(task, &frames, sensor, progress).map_err(|error| explained(error, task, &frames))?;

    let from_pictures = match task.pictures {
        PictureUse::Ignore | PictureUse::Only => None,
        PictureUse::Witness | PictureUse::Joint | PictureUse::SecondCamera => {
            let seen = pictures::see_pictures(task, Some(&starts), &without_pictures, progress)?;
            pictures::picture_calibration(task, seen, sensor, initial.camera.kind(), progress)
        }
    };
    let to_join = match task.pictures {
        PictureUse::Joint | PictureUse::SecondCamera => Some(pictures::require(task, from_pictures.as_ref())?),
        PictureUse::Ignore | PictureUse::Witness | PictureUse::Only => None,
    };

    keep_examples(&mut frames, &initial);
    // Of a long recording there are few events of each second in the sample: too few for the camera.
    let (sample, events) = match &choice {
        Some(choice) => {
            drop(sample);
            let (chosen, counts) = events_of(task, &ChosenSeconds::new(choice), sensor, progress)?;
            (chosen, Some(counts))
        }
        None => (sample, events),
    };

    progress.tell("trajectory")?;
    let FirstTrajectories { trajectories, points, segments, without_spline } =
        first_trajectories(&initial, &frames, &settings.segment, (&settings.spline, &settings.knots))?;

    let read = |index: usize, share: f64, visit: &mut dyn FnMut(&[RankedEvent])| {
        progress.go_on()?;
        if sample.read(index, share, visit) {
            return Ok(());
        }
        read_share(task, (index, share), sensor, progress, visit)
    };
    let input = RefinementInput {
        board: task.board,
        sensor,
        events: events.as_deref().map(|counts| EventInput { counts, read: &read }),
        points,
        point_sigma: initial.report.rms.max(SMALLEST_POINT_SIGMA),
        left_out: &left_out,
        free_board: [false; BOARD_PARAMETERS],
        held: [false; MAX_PARAMETERS],
    };
    let board = BoardShape::stated(task.board);
    let state = State { camera: initial.camera, board, bias: unknown(FIRST_SIGMA), trajectories };
    let (mut solved, model_choice) = solve_with_model(task, &input, state, model_choice, progress)?;
    // The pictures are calibrated with the board as it is stated: so is what they are compared with.
    let (compared, compared_certainty) = match &solved.as_stated {
        Some((camera, certainty)) => (camera, &certainty.intrinsics),
        None => (&solved.refined.state.camera, &solved.certainty.intrinsics),
    };
    let witness = from_pictures.as_ref().map(|found| pictures::witness(compared, compared_certainty, sensor, found));
    let (mut joint, mut own_pictures) = (None, None);
    if let Some(calibration) = to_join {
        let JointPoints { points, report } =
            pictures::observations(task, &solved.refined, &solved.certainty.intrinsics, calibration)?;
        if task.pictures == PictureUse::SecondCamera {
            own_pictures = Some(OwnPictures { camera: calibration.camera, sigma: calibration.sigma(), points, report });
        } else {
            let input = RefinementInput { points, point_sigma: report.sigma, ..input };
            solved = solve_with_pictures(task, input, solved, progress)?;
            joint = Some(report);
        }
    }
    let BoardSolve { mut refined, certainty, board, undetermined, .. } = solved;

    let sample = sample.thinned(SAMPLE);
    let mut left_out_beside = Vec::new();
    let others = (other_windows.as_slice(), recordings.as_slice());
    let followed = follow_others(task, (&refined, &certainty), others, &mut left_out_beside, progress)?;
    refined.left_out.extend(left_out_beside);

    progress.tell("examination")?;
    let (trust, event_trust) =
        examine(&refined, (certainty, board, undetermined), task.board, &saturated).map_err(CalibrateError::Solve)?;
    let mut findings = findings_on(&health);
    findings.extend(findings_on_frames(task, &frames, &initial));
    let whole_board = finding_on_board(task, &unplaced, sensor, &refined.state);
    let witness = if whole_board.is_some() { witness.map(WitnessOutcome::with_larger_board) } else { witness };
    findings.extend(whole_board);
    findings.extend(witness.as_ref().and_then(WitnessOutcome::finding));
    let camera = &refined.state.camera;
    let verdict = verdict(camera, &trust, Some(&event_trust), task.board, sensor, findings, &settings.verdict);
    let calibration = EventCalibration {
        detection,
        frames,
        other_windows,
        choice,
        followed,
        initial,
        segments,
        sample,
        segments_without_spline: without_spline,
        measured: if events.is_some() { Measured::EventEdges } else { Measured::CircleCentres },
        refined,
        trust: event_trust,
        witness,
        joint,
        inertial: None,
        second_cameras: Vec::new(),
        own_pictures,
    };
    let evidence = Evidence::Events(Box::new(calibration));
    Ok(Calibrated { sensor, starts, recordings, model_choice, trust, verdict, evidence })
}

/// Solves from `state` on, and once more with the model that the events ask for, where the model was chosen and they ask for another one.
fn solve_with_model(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    choice: Option<ModelChoice>,
    progress: &Progress,
) -> Result<(BoardSolve, Option<ModelChoice>), CalibrateError> {
    let board = state.board;
    let solved = solve_with_board(task, input, state, progress)?;
    let Some(choice) = choice else { return Ok((solved, None)) };
    let better = better_model(&solved.refined, solved.certainty.intrinsics.inflation);
    let camera = better.and_then(|kind| refit(kind, &solved.refined.state.camera, input.sensor));
    let Some((kind, camera)) = better.zip(camera) else { return Ok((solved, Some(choice))) };
    progress.tell(format!("joint solve with {kind}"))?;
    let state = State { camera, board, ..solved.refined.state };
    let solved = solve_with_board(task, input, state, progress)?;
    Ok((solved, Some(choice.instead(kind))))
}

/// Solves once more from `solved` on, with the centres of dots in pictures that `input` has beside the events; free is what was free.
fn solve_with_pictures(
    task: &Task,
    input: RefinementInput<CalibrateError>,
    solved: BoardSolve,
    progress: &Progress,
) -> Result<BoardSolve, CalibrateError> {
    let BoardSolve { refined, board, as_stated, undetermined, .. } = solved;
    let FreeParameters { board: free_board, intrinsics, .. } = refined.problem.free;
    let held = std::array::from_fn(|index| !intrinsics[index] || undetermined.contains(&index));
    let input = RefinementInput { free_board, held, ..input };
    let (refined, certainty) = solve(task, &input, refined.state, progress)?;
    let board = BoardEstimate { shape: refined.state.board, sigma: certainty.board_sigma, ..board };
    Ok(BoardSolve { refined, certainty, board, as_stated, undetermined })
}

/// What the frames tell of mistakes: of another camera, of rows of the board that are never seen.
fn findings_on_frames(task: &Task, frames: &[ReferenceFrame], initial: &InitialModel) -> Vec<Finding> {
    let mut findings = other_camera::findings_on(task.inputs, frames, initial);
    findings.extend(unseen_rows::finding_on(task.board.pattern, frames));
    findings
}

/// What the circles beside the board tell of its size.
fn finding_on_board(task: &Task, unplaced: &[UnplacedWindows], sensor: Sensor, state: &State) -> Option<Finding> {
    let larger = larger_pattern(unplaced, task.board.pattern, sensor)?;
    Some(unstated_rows::finding_on(&larger, task.board, &state.camera, &state.trajectories))
}

/// Stretches with a saturated readout: those that are left out, and those that stay, for they are too large a part of `duration`
/// seconds.
fn left_out_or_kept(saturated: Vec<LeftOut>, duration: f64) -> (Vec<LeftOut>, Vec<LeftOut>) {
    let of_saturated: f64 = saturated.iter().map(|stretch| stretch.end - stretch.start).sum();
    if of_saturated <= MOST_LEFT_OUT * duration { (saturated, Vec::new()) } else { (Vec::new(), saturated) }
}

/// Why there is no first camera, where the frames tell more than `error` does.
fn explained(error: CalibrateError, task: &Task, frames: &[ReferenceFrame]) -> CalibrateError {
    if !matches!(error, CalibrateError::Initial(_)) {
        return error;
    }
    // A wrong radius keeps circles from being confirmed, whatever else is told of them.
    match other_radius(frames, task.board) {
        Some(other) => CalibrateError::OtherRadius(other),
        None => larger_board(task.inputs, task.board, &task.settings.detection)
            .map_or(error, |larger| CalibrateError::LargerBoard(Box::new(larger))),
    }
}

/// The frames that the joint solve takes, and those of the `windows` that it has no room for.
fn taken(
    windows: Vec<CompactFrame>,
    of_circles: Vec<ReferenceFrame>,
    choice: Option<&StretchChoice>,
) -> (Vec<ReferenceFrame>, Vec<CompactFrame>) {
    let chosen = choice.map(ChosenSeconds::new);
    let (mut frames, mut others) = (of_circles, Vec::new());
    for mut window in windows {
        if chosen.as_ref().is_none_or(|chosen| chosen.has(window.recording, second_of(window.t()))) {
            frames.push(window.into());
        } else {
            window.seen_in = SeenIn::PassedEvents;
            others.push(window);
        }
    }
    frames.sort_by_key(|frame| frame.recording);
    (frames, others)
}

/// Drops the events of all frames but those with the smallest, the middle and the largest error, which are shown: after the first
/// camera nothing else needs them.
fn keep_examples(frames: &mut [ReferenceFrame], initial: &InitialModel) {
    let with_events = |frame: usize| frames.get(frame).is_some_and(|frame| frame.events().is_some());
    let mut ranked: Vec<(f64, usize)> =
        initial.frames.iter().map(|posed| (posed.rms, posed.frame)).filter(|(_, frame)| with_events(*frame)).collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let last = ranked.len().saturating_sub(1);
    let shown = [0, last.div_ceil(2), last].map(|place| ranked.get(place).map(|(_, frame)| *frame));
    for (index, frame) in frames.iter_mut().enumerate() {
        if matches!(frame.seen_in, SeenIn::Events(_)) && !shown.contains(&Some(index)) {
            frame.seen_in = SeenIn::PassedEvents;
        }
    }
}

/// The first camera, of the model that was asked for or that suits the recording best.
fn first_model(
    task: &Task,
    frames: &[ReferenceFrame],
    sensor: Sensor,
    progress: &Progress,
) -> Result<(InitialModel, Option<ModelChoice>), CalibrateError> {
    let settings = task.settings;
    progress.tell(format!("initial model from {} reference frames", frames.len()))?;
    match task.model {
        ModelRequest::Given(model) => Ok((initial_model(frames, task.board, sensor, model, &settings.initial)?, None)),
        ModelRequest::Auto => {
            // It cannot be ended there, and is afterwards.
            let tell = |model| {
                let _ = progress.tell(format!("initial model {model} from {} reference frames", frames.len()));
            };
            let (initial, choice) = choose_model(frames, task.board, sensor, &CANDIDATES, &settings.initial, tell)?;
            progress.go_on()?;
            Ok((initial, Some(choice)))
        }
    }
}
