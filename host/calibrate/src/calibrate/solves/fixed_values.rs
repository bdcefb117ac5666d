//! Values that the user fixed, compared with what the recording shows.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;

use super::joint_solve::{solve, with};
use crate::advice::Advice;
use crate::picture_calibration::calibration::{PictureCalibration, calibrate_pictures};
use crate::quality::verdict::board_statement::with_sigma;
use crate::quality::verdict::{Cause, Finding, Severity};
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::parameter_request::BOARD_NAMES;
use crate::task::progress::Progress;
use evcal_geometry::lens::projection_difference::projection_difference;
use evcal_solve::solve::State;
use evcal_solve::solve::refinement::RefinementInput;

/// Number of σ from which a recording contradicts a fixed value.
const CONTRADICTED: f64 = 4.0;

/// A fixed parameter: its name, the fixed value, and the value that the recording shows with its standard deviation.
struct FixedValue {
    name: &'static str,
    fixed: f64,
    shown: f64,
    sigma: f64,
}

/// Solves again from `state` on with the parameters estimated that the task fixes, and returns a finding on each whose value the
/// recording contradicts. Without fixed parameters, or if the recording does not determine them, there are none. The findings are
/// failures if the projection changes by more than `bound` (px), which does not contain the errors of fixed values.
///
/// # Errors
/// [`CalibrateError`].
pub(in crate::calibrate) fn contradicted(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
    bound: f64,
    progress: &Progress,
) -> Result<Vec<Finding>, CalibrateError> {
    let requests = &task.parameters;
    let (lens, board) = (&requests.fixed_intrinsics, &requests.fixed_board);
    if lens.iter().chain(board).all(Option::is_none) {
        return Ok(Vec::new());
    }
    progress.report("joint solve with the fixed values estimated")?;
    let free_board = std::array::from_fn(|index| input.free_board[index] || board[index].is_some());
    let input = with(input, free_board, [false; MAX_PARAMETERS]);
    let before = state.camera;
    let (refined, certainty) = match solve(task, &input, state, progress) {
        Err(CalibrateError::Solve(_)) => return Ok(Vec::new()),
        solved => solved?,
    };
    let state = &refined.state;
    let of_board = fixed_values(&BOARD_NAMES, board, &state.board.parameters(), &certainty.board_sigma);
    let of_lens = of_lens(task, &state.camera, &certainty.intrinsics.sigma());
    let severity = severity([&before, &state.camera], input.sensor, bound);
    Ok(of_lens.chain(of_board).filter_map(|value| finding_on(value, severity)).collect())
}

/// Calibrates again from the points of the `frames` of a calibration from pictures, as [`contradicted`] does from events.
pub(in crate::calibrate) fn contradicted_by_pictures(
    task: &Task,
    calibration: &PictureCalibration,
    sensor: Sensor,
    bound: f64,
) -> Vec<Finding> {
    if task.parameters.fixed_intrinsics.iter().all(Option::is_none) {
        return Vec::new();
    }
    let PictureCalibration { frames, report, camera, .. } = calibration;
    let (initial, free) = (&task.settings.initial, [None; MAX_PARAMETERS]);
    let freed = calibrate_pictures(frames.clone(), report.clone(), task.board, sensor, camera.kind(), initial, &free);
    let Ok(freed) = freed else { return Vec::new() };
    let severity = severity([camera, &freed.camera], sensor, bound);
    of_lens(task, &freed.camera, &freed.sigma()).filter_map(|value| finding_on(value, severity)).collect()
}

/// Returns the severity of wrong values with which the camera is the first one, and without which it is the second one.
fn severity([fixed, freed]: [&Camera<f64>; 2], sensor: Sensor, bound: f64) -> Severity {
    match projection_difference(fixed, freed, sensor) {
        Ok(difference) if difference.rms <= bound => Severity::Note,
        _ => Severity::Failure,
    }
}

/// Returns the parameters of the lens that the task fixes; `camera` has estimated values with this `sigma`.
fn of_lens(task: &Task, camera: &Camera<f64>, sigma: &[f64]) -> impl Iterator<Item = FixedValue> + use<> {
    fixed_values(camera.kind().parameter_names(), &task.parameters.fixed_intrinsics, &camera.parameters(), sigma)
}

fn fixed_values(
    names: &[&'static str],
    fixed: &[Option<f64>],
    shown: &[f64],
    sigma: &[f64],
) -> impl Iterator<Item = FixedValue> + use<> {
    let values = names.iter().zip(fixed).zip(shown.iter().zip(sigma));
    let fixed_values = values.filter_map(|((name, fixed), (shown, sigma))| {
        fixed.map(|fixed| FixedValue { name, fixed, shown: *shown, sigma: *sigma })
    });
    fixed_values.collect::<Vec<_>>().into_iter()
}

fn finding_on(FixedValue { name, fixed, shown, sigma }: FixedValue, severity: Severity) -> Option<Finding> {
    let deviation = (fixed - shown).abs() / sigma;
    // All parameters of the board but its print ratio are lengths.
    let (scale, unit) = if BOARD_NAMES.iter().skip(1).any(|length| *length == name) { (1e3, " mm") } else { (1.0, "") };
    (deviation > CONTRADICTED).then(|| {
        let value = with_sigma(scale * shown, scale * sigma);
        Finding::new(
            Cause::FixedValue,
            severity,
            format!("{name} was fixed at {}{unit}, but the recording shows {value}{unit}", scale * fixed),
            Advice::Estimate { name, fixed: format!("{name}={}{}", scale * fixed, unit.trim()) },
        )
    })
}
