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
/// recording contradicts. Without fixed parameters, or if the recording does not determine them, there are none: the bound of the
/// projection would not contain the error of a fixed value.
///
/// # Errors
/// [`CalibrateError`].
pub(in crate::calibrate) fn contradicted(
    task: &Task,
    input: &RefinementInput<CalibrateError>,
    state: State,
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
    let (refined, certainty) = match solve(task, &input, state, progress) {
        Err(CalibrateError::Solve(_)) => return Ok(Vec::new()),
        solved => solved?,
    };
    let of_board = findings(&BOARD_NAMES, board, &refined.state.board.parameters(), &certainty.board_sigma);
    let of_lens = of_lens(task, &refined.state.camera, &certainty.intrinsics.sigma());
    Ok([of_lens, of_board].concat())
}

/// Calibrates again from the points of the `frames` of a calibration from pictures, as [`contradicted`] does from events.
pub(in crate::calibrate) fn contradicted_by_pictures(
    task: &Task,
    calibration: &PictureCalibration,
    sensor: Sensor,
) -> Vec<Finding> {
    if task.parameters.fixed_intrinsics.iter().all(Option::is_none) {
        return Vec::new();
    }
    let PictureCalibration { frames, report, camera, .. } = calibration;
    let (initial, free) = (&task.settings.initial, [None; MAX_PARAMETERS]);
    let freed = calibrate_pictures(frames.clone(), report.clone(), task.board, sensor, camera.kind(), initial, &free);
    freed.map_or_else(|_| Vec::new(), |freed| of_lens(task, &freed.camera, &freed.sigma()))
}

/// Returns the findings on the parameters of the lens that the task fixes; `camera` has estimated values with this `sigma`.
fn of_lens(task: &Task, camera: &Camera<f64>, sigma: &[f64]) -> Vec<Finding> {
    findings(camera.kind().parameter_names(), &task.parameters.fixed_intrinsics, &camera.parameters(), sigma)
}

fn findings(names: &[&'static str], fixed: &[Option<f64>], shown: &[f64], sigma: &[f64]) -> Vec<Finding> {
    let values = names.iter().zip(fixed).zip(shown.iter().zip(sigma));
    let fixed_values = values.filter_map(|((name, fixed), (shown, sigma))| {
        fixed.map(|fixed| FixedValue { name, fixed, shown: *shown, sigma: *sigma })
    });
    fixed_values.filter_map(finding_on).collect()
}

fn finding_on(FixedValue { name, fixed, shown, sigma }: FixedValue) -> Option<Finding> {
    let deviation = (fixed - shown).abs() / sigma;
    // All parameters of the board but its print ratio are lengths.
    let (scale, unit) = if BOARD_NAMES.iter().skip(1).any(|length| *length == name) { (1e3, " mm") } else { (1.0, "") };
    (deviation > CONTRADICTED).then(|| {
        let value = with_sigma(scale * shown, scale * sigma);
        Finding::new(
            Cause::FixedValue,
            Severity::Failure,
            format!("{name} was fixed at {}{unit}, but the recording shows {value}{unit}", scale * fixed),
            Advice::Estimate { name, fixed: format!("{name}={}{}", scale * fixed, unit.trim()) },
        )
    })
}
