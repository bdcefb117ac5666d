//! The calibration from events, or from circles that a detector found in them: the stages in their order.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;

use super::calibrated::{Calibrated, EventCalibration, Evidence, SAMPLE};
use super::detected::detect;
use super::findings::{Seen, examine_calibration};
use super::first_model::first_model;
use super::frames::{Frames, keep_examples, take_frames};
use super::interval_choice::choose_intervals;
use super::other_intervals::follow_others;
use super::pictures::{Files, calibrate_pictures_with_events, cross_check};
use super::saturated::Saturated;
use crate::calibrate::solves::joint_solve::trajectory_settings;
use crate::calibrate::solves::model_solve::solve_with_model;
use crate::calibrate::solves::picture_solve::{WithPictures, join_pictures};
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::progress::Progress;
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_geometry::board::shape::BoardShape;
use evcal_solve::initial::InitialModel;
use evcal_solve::solve::left_out::LeftOut;
use evcal_solve::solve::refinement::{EventInput, FIRST_SIGMA, RefinementInput, SMALLEST_POINT_SIGMA};
use evcal_solve::solve::residual_statistics::Measured;
use evcal_solve::solve::rows::event_bias::unknown;
use evcal_solve::solve::{BOARD_PARAMETERS, State};
use evcal_solve::trajectory::Trajectory;
use evcal_solve::trajectory::first::first_trajectories;

/// Calibrates as `task` describes, with pictures as a cross-check or as additional observations.
///
/// # Errors
/// [`CalibrateError`].
pub(super) fn calibrate(task: &Task, progress: &Progress) -> Result<Calibrated, CalibrateError> {
    let detected = detect(task, progress)?;
    let sensor = detected.sensor;
    let choice = choose_intervals(&detected.windows, task, sensor);
    let Frames { taken: mut frames, others } = take_frames(detected.windows, detected.frames, choice.as_ref());
    let saturated = Saturated::new(detected.saturated, &detected.recordings);

    let first = first_model(task, &frames, sensor, progress)?;
    let files = Files {
        starts: Some(&detected.starts),
        without_pictures: &detected.without_pictures,
        duration: detected.recordings.iter().map(|recording| recording.duration).sum(),
    };
    let pictures = calibrate_pictures_with_events(task, files, &frames, sensor, first.initial.camera.kind(), progress)?;
    keep_examples(&mut frames, &first.initial);
    let events = detected.events.of_choice(choice.as_ref(), task, sensor, progress)?;

    progress.report("trajectory")?;
    let start = first_trajectories(&first.initial, &frames, trajectory_settings(task.settings))?;

    let read = events.reader(task, sensor, progress);
    let input = first_input(task, &first.initial, sensor, events.input(&*read), &start.points, &saturated.left_out);
    let state = first_state(task, first.initial.camera, start.trajectories);
    let (solve, model_choice) = solve_with_model(task, &input, state, first.choice, progress)?;
    let cross_check = pictures.as_ref().map(|pictures| cross_check(&solve, sensor, pictures));
    let WithPictures { mut solve, joint, own } =
        join_pictures(task, input, solve, pictures.as_ref().map(|pictures| &pictures.calibrated), progress)?;
    drop(read);
    let measured = if events.counts.is_some() { Measured::EventEdges } else { Measured::CircleCentres };
    let sample = events.sample.thinned(SAMPLE);
    let followed = follow_others(task, &mut solve, &others, &detected.recordings, progress)?;

    progress.report("examination")?;
    let seen = Seen {
        sensor,
        health: &detected.health,
        unplaced: &detected.unplaced,
        frames: &frames,
        initial: &first.initial,
    };
    let examined = examine_calibration(task, &seen, solve, &saturated.kept, cross_check)?;

    let calibration = EventCalibration {
        detection: detected.detection,
        frames,
        other_windows: others,
        choice,
        followed,
        initial: first.initial,
        segments: start.segments,
        sample,
        segments_without_spline: start.without_spline,
        measured,
        refined: examined.refined,
        quality: examined.event_quality,
        cross_check: examined.cross_check,
        joint,
        second_cameras: Vec::new(),
        own_pictures: own,
    };
    Ok(Calibrated {
        sensor,
        starts: detected.starts,
        recordings: detected.recordings,
        model_choice,
        quality: examined.quality,
        verdict: examined.verdict,
        evidence: Evidence::Events(Box::new(calibration)),
        inertial: None,
    })
}

/// Returns the observations of the first joint solve: `events`, held by the `points` of the reference frames at first, or these
/// points alone without events. The board is fixed, and all intrinsics are estimated.
fn first_input<'a>(
    task: &Task<'a>,
    initial: &InitialModel,
    sensor: Sensor,
    events: Option<EventInput<'a, CalibrateError>>,
    points: &'a [Vec<PointObservation>],
    left_out: &'a [LeftOut],
) -> RefinementInput<'a, CalibrateError> {
    RefinementInput {
        board: task.board,
        sensor,
        points: if events.is_some() { Vec::new() } else { points.to_vec() },
        anchors: points,
        events,
        point_sigma: initial.report.rms.max(SMALLEST_POINT_SIGMA),
        left_out,
        free_board: [false; BOARD_PARAMETERS],
        fixed: [false; MAX_PARAMETERS],
    }
}

/// Returns the start of the joint solve: the nominal board, and unknown biases of the events.
pub(super) fn first_state(task: &Task, camera: Camera<f64>, trajectories: Vec<Trajectory>) -> State {
    State { camera, board: BoardShape::nominal(task.board), bias: unknown(FIRST_SIGMA), trajectories }
}
